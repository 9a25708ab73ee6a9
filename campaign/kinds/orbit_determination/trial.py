"""The orbit-determination experiment: weeks of crater sightings and radiometric data, an orbit, its error."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Self

import numpy as np

from boresight.campaign.handles import own_copy
from boresight.campaign.kinds.orbit_determination.score import (
    check_orbit,
    drawable,
    orbit_errors,
    orbit_summary,
    residual_records,
)
from boresight.campaign.pool.guard import Call
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.trial.image_trials import PerDatabase
from boresight.campaign.trial.kind import Record, Records, Witness, WorkerContext, each_trial
from boresight.campaign.trial.methods import Unbuilt, methods, require_built
from boresight.campaign.trial.work import Work
from boresight.estimators.orbit.contract import OrbitEstimate, OrbitEstimator
from boresight.estimators.orbit.registry import orbit_estimator_class
from boresight.scenarios.bodies import body_digest, load_body
from boresight.scenarios.dynamics.propagation import OrbitLostError
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.orbits.data import OrbitData
from boresight.scenarios.orbits.draw import OrbitTruth, draw_orbit
from boresight.scenarios.orbits.world import Asteroid, OnboardShape, OrbitWorld
from boresight.scenarios.spec.orbit import OrbitSpec

_STATE = 6


@dataclass(frozen=True, slots=True, eq=False)
class DeterminedOrbit:
    """A trial of one estimator as a witness is shown it; ``estimate`` is None where the estimator raised."""

    world: OrbitWorld
    truth: OrbitTruth
    data: OrbitData
    estimate: OrbitEstimate | None

    @property
    def image(self) -> None:
        """None: a method sees data."""

    @property
    def observation(self) -> OrbitData:
        """Input of the method."""
        return self.data


@dataclass(frozen=True, eq=False)
class OrbitTrials:
    """Trials of one scenario with a set of labelled estimators of orbits; all see the same data.

    ``witness`` is shown the `DeterminedOrbit` of every trial and estimator; or None. ``database`` is the number of the
    draw of craters; None where there is one.
    """

    name: str
    world: OrbitWorld
    estimators: Mapping[str, OrbitEstimator | Unbuilt]
    seed: int
    witness: Witness | None = None
    database: int | None = None

    @classmethod
    def method_version(cls, name: str) -> int:
        """Return the version of an estimator of orbits."""
        return orbit_estimator_class(name).version

    @classmethod
    def check_scenario(cls, scenario: LoadedScenario) -> None:
        """Refuse a missing section, and an orbit that begins in the body."""
        checked_orbit_section(scenario)

    @classmethod
    def methods(cls, campaign: ResolvedCampaign, scenario: LoadedScenario) -> dict[str, OrbitEstimator | Unbuilt]:
        """Build the estimators; refuse wrong options."""
        return methods(campaign, scenario, lambda entry: orbit_estimator_class(entry.name).from_options(entry.options))

    @classmethod
    def open(
        cls, campaign: ResolvedCampaign, scenario: LoadedScenario, context: WorkerContext
    ) -> PerDatabase[OrbitTrials]:
        """Lay the craters, work the gravity out and build the estimators."""
        del context
        estimators, count = cls.methods(campaign, scenario), campaign.spec.databases
        worlds = [open_orbit_world(scenario, campaign.seed, number) for number in range(count)]
        return PerDatabase(
            tuple(
                cls(scenario.spec.name, world, estimators, campaign.seed, database=number if count > 1 else None)
                for number, world in enumerate(worlds)
            )
        )

    def watched(self, label: str, witness: Witness) -> Self:
        """Return the same trials of one estimator, shown to a witness."""
        return replace(self, estimators={label: self.estimators[label]}, witness=witness)

    def trial(self, trial: int) -> Records:
        """Run one trial, in the order of estimators."""
        return each_trial((trial,), self.name, self._run)

    def flush(self) -> None:
        """Keep nothing: no image is rendered."""

    def _run(self, trial: int) -> dict[str, Records]:
        """Run a trial: the records of each estimator; where chance leads the orbit into the body, none has data."""
        try:
            truth, data = draw_orbit(self.world, self.seed, trial)
        except OrbitLostError as error:
            row = {**self._row(), "status": "failed", "reason": f"there is no such trial: {error}"}
            return {label: {"rows": [row]} for label in self.estimators}
        return {
            label: self._judged(Call(self.name, trial, label), estimator, truth, data)
            for label, estimator in self.estimators.items()
        }

    def _judged(self, call: Call, estimator: OrbitEstimator | Unbuilt, truth: OrbitTruth, data: OrbitData) -> Records:
        """Let an estimator solve and score what it returns: records without their key, whatever goes wrong."""
        row = {**self._row(), "range_m": float(np.linalg.norm(truth.states[0, :3]))}

        def score(estimate: OrbitEstimate) -> Records:
            timings: Records = {"timings": [{"stage": "orbit", "seconds": float(estimate.seconds)}]}
            return scored_orbit(estimate, truth, data, row, with_residuals=call.trial == 0) | timings

        def show(estimate: OrbitEstimate | None) -> None:
            if self.witness is not None:
                self.witness(DeterminedOrbit(self.world, truth, data, drawable(estimate, data)))

        return Work(call, "estimator", row).run(
            lambda: require_built(estimator).determine(own_copy(data)),
            lambda estimate: check_orbit(estimate, data),
            score,
            show,
        )

    def _row(self) -> Record:
        return {**empty_row(), "database": self.database}


def checked_orbit_section(scenario: LoadedScenario) -> OrbitSpec:
    """Return the orbit section of a scenario; refuse a missing one, and an orbit that begins in the body."""
    section = _section(scenario)
    reach = load_body(scenario.spec.body, scenario.search_dirs).mesh.radius_m
    nearest = section.arc.semi_major_axis_m * (1.0 - section.arc.eccentricity)
    if nearest <= reach:
        raise BoresightError(
            f"{scenario.path}: orbit.arc: its pericentre at {nearest:g} m is not above the body, which reaches"
            f" {reach:.6g} m from its origin: choose a larger semi_major_axis_m"
        )
    return section


def open_orbit_world(scenario: LoadedScenario, seed: int, number: int = 0) -> OrbitWorld:
    """Make the orbit section of a scenario real, with a draw of the craters; scenarios of one body share it."""
    section = _section(scenario)
    part = _body_part(section)
    asteroid = _asteroid(_Body(scenario), part, seed)
    believed = _believed(asteroid, section.knowledge.shape_degree, part)
    cratered = _other_craters(asteroid, part, seed, number) if number else asteroid
    return OrbitWorld(section, scenario.spec.camera.camera().pinhole, cratered, believed)


def scored_orbit(
    estimate: OrbitEstimate, truth: OrbitTruth, data: OrbitData, row: Record, with_residuals: bool
) -> Records:
    """Score an estimate that keeps the contract: records without their key; ``row`` is what its row says already."""
    orbit = estimate.orbit
    diagnostics: list[Record] = [{"name": str(n), "value": float(v)} for n, v in estimate.diagnostics.items()]
    if estimate.status == "failed" or orbit is None:
        return {"rows": [{**row, "status": "failed", "reason": estimate.reason}], "diagnostics": diagnostics}
    summary = orbit_summary(estimate, orbit, truth, data)
    filled = {
        **row,
        "status": "ok",
        "position_error_m": summary["epoch_error_m"],
        "nees": _STATE * float(str(summary["epoch_nees"])),
        "position_sigma_m": float(np.sqrt(np.trace(orbit.covariance[:3, :3]))),
        "n_landmarks": len(orbit.numbers),
    }
    return {
        "rows": [filled],
        "orbits": [summary],
        "orbit_errors": list(orbit_errors(orbit, truth, data)),
        "residuals": list(residual_records(orbit, data)) if with_residuals else [],
        "diagnostics": diagnostics,
    }


def empty_row() -> Record:
    """Fill the columns of a row that no estimator can change."""
    return {"n_landmarks": 0, "reason": "", "image": ""}


class _Body:
    """A scenario as a key of its body: two that have the same one are equal."""

    def __init__(self, scenario: LoadedScenario) -> None:
        self.scenario = scenario
        self.digest = body_digest(scenario.spec.body, scenario.search_dirs)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Body) and self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)


def _body_part(section: OrbitSpec) -> OrbitSpec:
    """Leave only what the body and its craters depend on, so that scenarios share them."""
    return OrbitSpec(asteroid=section.asteroid, sightings={"craters": section.sightings.craters})


@lru_cache(maxsize=2)
def _asteroid(body: _Body, spec: OrbitSpec, seed: int) -> Asteroid:
    mesh = load_body(body.scenario.spec.body, body.scenario.search_dirs).mesh
    return Asteroid.of(mesh, spec, seed)


@lru_cache(maxsize=16)
def _other_craters(asteroid: Asteroid, spec: OrbitSpec, seed: int, number: int) -> Asteroid:
    return asteroid.with_craters(spec, seed, number)


@lru_cache(maxsize=16)
def _believed(asteroid: Asteroid, degree: int, spec: OrbitSpec) -> OnboardShape:
    return OnboardShape.of(asteroid, spec, degree)


def _section(scenario: LoadedScenario) -> OrbitSpec:
    if scenario.spec.orbit is None:
        raise BoresightError(f"{scenario.path}: orbit: missing, but orbits cannot be determined without it")
    return scenario.spec.orbit

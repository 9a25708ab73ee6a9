"""Kind of trial: an orbit from weeks of crater sightings and radiometric data."""

from __future__ import annotations

from dataclasses import dataclass
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
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.trial.kind import InspectedTrial, Record, Records, WorkerContext
from boresight.campaign.trial.runner import MethodRunner
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
class OrbitDraw:
    """The number of a trial, its truth, and the data that estimators get."""

    trial: int
    truth: OrbitTruth
    data: OrbitData


DeterminedOrbit = InspectedTrial[OrbitTruth, OrbitData, OrbitEstimate]
"""A trial of one estimator, for inspection."""


@dataclass(frozen=True, eq=False)
class OrbitTrials(MethodRunner[OrbitEstimator, OrbitDraw, OrbitEstimate]):
    """Trials of estimators of orbits in one ``world``; all see the same data."""

    name = "orbit-determination"
    version = 3
    block_trials = 2
    databases = True
    undrawable = (OrbitLostError,)

    world: OrbitWorld

    @classmethod
    def method_class(cls, name: str) -> type[OrbitEstimator]:
        return orbit_estimator_class(name)

    @classmethod
    def check_scenario(cls, scenario: LoadedScenario) -> None:
        """Refuse a missing section, and an orbit that begins in the body."""
        checked_orbit_section(scenario)

    @classmethod
    def open(
        cls, campaign: ResolvedCampaign, scenario: LoadedScenario, context: WorkerContext, number: int = 0
    ) -> Self:
        """Lay the craters, compute the gravity and build the estimators."""
        return cls.made(campaign, scenario, number, world=open_orbit_world(scenario, campaign.seed, number))

    def draw(self, trial: int) -> OrbitDraw:
        """Draw an orbit and its data; chance may lead it into the body."""
        return OrbitDraw(trial, *draw_orbit(self.world, self.seed, trial))

    def row(self, drawn: OrbitDraw) -> Record:
        return {"n_landmarks": 0, "range_m": float(np.linalg.norm(drawn.truth.states[0, :3]))}

    def ask(self, method: OrbitEstimator, drawn: OrbitDraw) -> OrbitEstimate:
        """Let an estimator solve for the orbit."""
        return method.determine(own_copy(drawn.data))

    def check(self, answer: OrbitEstimate, drawn: OrbitDraw) -> None:
        check_orbit(answer, drawn.data)

    def score(self, answer: OrbitEstimate, drawn: OrbitDraw) -> Records:
        """Score the orbit, with the residuals of the first trial."""
        timings: Records = {"timings": [{"stage": "orbit", "seconds": float(answer.seconds)}]}
        return scored_orbit(answer, drawn.truth, drawn.data, with_residuals=drawn.trial == 0) | timings

    def shown(self, answer: OrbitEstimate | None, drawn: OrbitDraw) -> DeterminedOrbit:
        return InspectedTrial(drawn.truth, drawn.data, drawable(answer, drawn.data))


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
    # Only what the body and its craters depend on, so that scenarios share them.
    part = OrbitSpec(asteroid=section.asteroid, sightings={"craters": section.sightings.craters})
    asteroid = _asteroid(_Body(scenario), part, seed)
    believed = _believed(asteroid, part, section.knowledge.shape_degree)
    cratered = _other_craters(asteroid, part, seed, number) if number else asteroid
    return OrbitWorld(section, scenario.spec.camera.camera().pinhole, cratered, believed)


def scored_orbit(estimate: OrbitEstimate, truth: OrbitTruth, data: OrbitData, with_residuals: bool) -> Records:
    """Score an estimate that keeps the contract: records without their key."""
    orbit = estimate.orbit
    diagnostics: list[Record] = [{"name": str(n), "value": float(v)} for n, v in estimate.diagnostics.items()]
    if estimate.status == "failed" or orbit is None:
        return {"rows": [{"status": "failed", "reason": estimate.reason}], "diagnostics": diagnostics}
    summary = orbit_summary(estimate, orbit, truth, data)
    row: Record = {
        "status": "ok",
        "reason": "",
        "position_error_m": summary["epoch_error_m"],
        "nees": _STATE * float(str(summary["epoch_nees"])),
        "position_sigma_m": float(np.sqrt(np.trace(orbit.covariance[:3, :3]))),
        "n_landmarks": len(orbit.numbers),
    }
    return {
        "rows": [row],
        "orbits": [summary],
        "orbit_errors": list(orbit_errors(orbit, truth, data)),
        "residuals": list(residual_records(orbit, data)) if with_residuals else [],
        "diagnostics": diagnostics,
    }


class _Body:
    """A scenario as a key of its body: two that have the same one are equal."""

    def __init__(self, scenario: LoadedScenario) -> None:
        self.scenario = scenario
        self.digest = body_digest(scenario.spec.body, scenario.search_dirs)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Body) and self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)


@lru_cache(maxsize=2)
def _asteroid(body: _Body, spec: OrbitSpec, seed: int) -> Asteroid:
    mesh = load_body(body.scenario.spec.body, body.scenario.search_dirs).mesh
    return Asteroid.of(mesh, spec, seed)


_other_craters = lru_cache(maxsize=16)(Asteroid.with_craters)
_believed = lru_cache(maxsize=16)(OnboardShape.of)


def _section(scenario: LoadedScenario) -> OrbitSpec:
    if scenario.spec.orbit is None:
        raise BoresightError(f"{scenario.path}: orbit: missing, but orbits cannot be determined without it")
    return scenario.spec.orbit


KIND = OrbitTrials

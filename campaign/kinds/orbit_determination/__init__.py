"""Kind of trial: an orbit from weeks of crater sightings and radiometric data.

Errors are scored in inertial space, at the epoch, over the arc and predicted: the phase of the body's rotation and the
landmarks' longitudes are one unknown by two names, and inertial positions do not depend on which of them is wrong.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from boresight.campaign.handles import own_copy
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.trial.checks import (
    MOST,
    check_array,
    check_covariance,
    check_indices,
    check_numbers,
    check_seconds,
    check_status,
    check_type,
)
from boresight.campaign.trial.kind import InspectedTrial, Prediction, Record, Records, WorkerContext
from boresight.campaign.trial.runner import MethodRunner
from boresight.campaign.trial.score import nees
from boresight.campaign.trial.unused import LENS, OF_IMAGES, OF_OBSERVATIONS
from boresight.estimators.orbit.contract import Orbit, OrbitEstimate, OrbitEstimator
from boresight.estimators.registry import orbit_estimator_class
from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.bodies import body_digest, load_body
from boresight.scenarios.dynamics.propagation import OrbitLostError
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.orbits.data import OrbitData
from boresight.scenarios.orbits.draw import OrbitTruth, draw_orbit
from boresight.scenarios.orbits.true_orbit import DAY_S
from boresight.scenarios.orbits.world import Asteroid, OnboardShape, OrbitWorld
from boresight.scenarios.spec.orbit import OrbitSpec
from boresight.scenarios.spec.scenario import ScenarioSpec

_STATE = 6
_AXES = 3


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

    world: OrbitWorld

    @classmethod
    def method_class(cls, name: str) -> type[OrbitEstimator]:
        return orbit_estimator_class(name)

    @classmethod
    def check_scenario(cls, scenario: LoadedScenario) -> None:
        """Refuse a missing section, and an orbit that begins in the body."""
        checked_orbit_section(scenario)

    @classmethod
    def unused(cls, spec: ScenarioSpec) -> tuple[str, ...]:
        return (*OF_IMAGES, *OF_OBSERVATIONS, *LENS, "orbit.imaging")

    @classmethod
    def open(
        cls, campaign: ResolvedCampaign, scenario: LoadedScenario, context: WorkerContext, number: int = 0
    ) -> Self:
        """Lay the craters, compute the gravity and build the estimators."""
        return cls.made(campaign, scenario, number, world=open_orbit_world(scenario, campaign.seed, number))

    def draw(self, trial: int) -> OrbitDraw:
        """Draw an orbit and its data; chance may lead it into the body."""
        return OrbitDraw(trial, *draw_orbit(self.world, self.seed, trial))

    def predictors(self, trial: int) -> Mapping[str, Prediction]:
        """Draw the data of a trial; none if chance leads the orbit into the body."""
        try:
            data = self.draw(trial).data
        except OrbitLostError:
            return {}

        def predict(method: Any) -> Mapping[str, float] | None:
            covariance = method.predict(data)
            return None if covariance is None else {"position_m": float(np.sqrt(np.trace(covariance[:3, :3])))}

        return {label: partial(predict, one) for label, one in self.methods.items() if hasattr(one, "predict")}

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
    nearest = section.arc.ranges_m[0]
    if nearest <= reach:
        place, change = "pericentre", "choose a larger semi_major_axis_m"
        if section.arc.approach is not None:
            place, change = "end", "choose fewer days, or a larger approach.miss_m"
        raise BoresightError(
            f"{scenario.path}: orbit.arc: its {place} at {nearest:g} m is not above the body, which reaches"
            f" {reach:.6g} m from its origin: {change}"
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


def check_orbit(estimate: OrbitEstimate, data: OrbitData) -> None:
    """Refuse an estimate that does not keep the contract.

    Raise `ValueError` if it is none, status or reason is none, an orbit is missing, or an array has another shape, is
    not finite or of an impossible size.
    """
    check_type(estimate, OrbitEstimate)
    check_status(estimate.status, estimate.reason)
    check_numbers(estimate.diagnostics, "diagnostics")
    check_seconds({"seconds": estimate.seconds}, "an estimate")
    if estimate.status == "failed":
        return
    if estimate.orbit is None:
        raise ValueError("an estimate that is ok has no orbit")
    _check_solution(estimate.orbit, len(data.wanted_s), len(data.pictures.image))


def drawable(estimate: OrbitEstimate | None, data: OrbitData) -> OrbitEstimate | None:
    """Remove the orbit of a failure if it cannot be drawn; that of a successful estimate is valid."""
    if estimate is None or estimate.status == "ok" or estimate.orbit is None:
        return estimate
    try:
        _check_solution(estimate.orbit, len(data.wanted_s), len(data.pictures.image))
    except (ValueError, TypeError, AttributeError):
        return replace(estimate, orbit=None)
    return estimate


def _check_solution(orbit: Orbit, wanted: int, sightings: int) -> None:
    check_type(orbit, Orbit)
    landmarks = len(orbit.numbers)
    for name, array, shape, most in (
        ("state", orbit.state, (_STATE,), MOST),
        ("positions_m", orbit.positions_m, (wanted, 3), MOST),
        ("velocities_m_s", orbit.velocities_m_s, (wanted, 3), MOST),
        ("position_covariances_m2", orbit.position_covariances_m2, (wanted, _AXES, _AXES), MOST**2),
    ):
        check_array(name, array, shape, most)
    check_indices("numbers", orbit.numbers, (landmarks,))
    check_array("points_body_m", orbit.points_body_m, (landmarks, 3))
    check_type(orbit.used, np.ndarray)
    check_type(orbit.residuals_px, np.ndarray)
    if orbit.used.shape != (sightings,) or orbit.used.dtype != np.bool_:
        raise ValueError(f"used of shape {orbit.used.shape} and type {orbit.used.dtype} is not ({sightings},) of bool")
    if orbit.residuals_px.shape != (sightings, 2) or orbit.residuals_px.dtype.kind != "f":
        raise ValueError(f"residuals_px of shape {orbit.residuals_px.shape} is not {(sightings, 2)} of numbers")
    check_array("residuals_px of used sightings", orbit.residuals_px[orbit.used], (int(orbit.used.sum()), 2))
    # By these, errors are weighed.
    for covariance, size in [(orbit.covariance, _STATE), *((one, _AXES) for one in orbit.position_covariances_m2)]:
        check_covariance("a covariance", covariance, size)
        if nees(np.ones(len(covariance)), covariance) is None:
            raise ValueError("a covariance is not positive definite")


def orbit_errors(orbit: Orbit, truth: OrbitTruth, data: OrbitData) -> list[Record]:
    """Score every wanted time: the columns of the table ``orbit_errors`` without its key."""
    offset = orbit.positions_m - truth.states[:, :3]
    radial = truth.states[:, :3] / np.linalg.norm(truth.states[:, :3], axis=1, keepdims=True)
    cross = np.cross(radial, truth.states[:, 3:])
    cross /= np.linalg.norm(cross, axis=1, keepdims=True)
    parts = [np.einsum("ei,ei->e", offset, axis) for axis in (radial, np.cross(cross, radial), cross)]
    sigma = np.sqrt(np.maximum(np.trace(orbit.position_covariances_m2, axis1=1, axis2=2), 0.0))
    later = data.wanted_s > _end_of_arc(data)
    return [
        {
            "time_days": float(time / DAY_S),
            "predicted": bool(predicted),
            "position_error_m": float(np.linalg.norm(off)),
            "radial_m": float(r),
            "along_m": float(a),
            "cross_m": float(c),
            "position_sigma_m": float(s),
        }
        for time, predicted, off, r, a, c, s in zip(data.wanted_s, later, offset, *parts, sigma, strict=True)
    ]


def orbit_summary(estimate: OrbitEstimate, orbit: Orbit, truth: OrbitTruth, data: OrbitData) -> Record:
    """Sum a trial up: the columns of the table ``orbits`` without its key."""
    offset = orbit.positions_m - truth.states[:, :3]
    errors = np.linalg.norm(offset, axis=1)
    arc = data.wanted_s <= _end_of_arc(data)
    state = orbit.state - truth.states[0]
    weighted = [nees(off, P) for off, P in zip(offset[arc], orbit.position_covariances_m2[arc], strict=True)]
    sigma = np.sqrt(np.maximum(np.trace(orbit.position_covariances_m2[-1]), 0.0))
    placed = orbit.residuals_px[orbit.used]
    wrong = wrong_sightings(orbit, truth, data)
    known = data.knowledge
    gm = known.field.harmonics.gm_m3_s2 * estimate.diagnostics.get("gm_ratio", 1.0) / truth.gm_m3_s2 - 1.0
    light = _length(known.field.light_m_s2) * estimate.diagnostics.get("solar_pressure_ratio", 1.0)
    return {
        "epoch_error_m": float(errors[0]),
        "epoch_velocity_error_m_s": _length(state[3:]),
        "epoch_nees": _over(nees(state, orbit.covariance), _STATE),
        "arc_median_m": float(np.median(errors[arc])),
        "arc_rms_m": float(np.sqrt(np.mean(errors[arc] ** 2))),
        "arc_p90_m": float(np.quantile(errors[arc], 0.9)),
        "arc_nees": _over(None if None in weighted else float(np.mean(np.array(weighted, dtype=np.float64))), _AXES),
        "predicted_error_m": float(errors[-1]) if not arc[-1] else None,
        "predicted_sigma_m": float(sigma) if not arc[-1] else None,
        "residual_rms_px": float(np.sqrt(np.mean(placed**2))) if len(placed) else None,
        "wrong_left_share": float((wrong & orbit.used).sum() / max(int(orbit.used.sum()), 1)) if len(wrong) else None,
        "right_edited_share": (
            float((~wrong & ~orbit.used).sum() / max(int((~wrong).sum()), 1)) if len(wrong) else None
        ),
        "gm_error": float(gm),
        "solar_pressure_error": light / _length(truth.light_m_s2) - 1.0 if truth.light_m_s2.any() else None,
    }


def wrong_sightings(orbit: Orbit, truth: OrbitTruth, data: OrbitData) -> NDArray[np.bool_]:
    """(K,): sightings of another crater than the one of their number, see `craters_of_numbers`."""
    wrong, landmark = np.ones(len(truth.crater), dtype=bool), data.pictures.landmark
    for number, craters in craters_of_numbers(orbit, landmark, truth.crater).items():
        rows = np.flatnonzero(landmark == number)
        wrong[rows] = ~np.isin(truth.crater[rows], craters)
    return wrong


def craters_of_numbers(orbit: Orbit, landmark: IndexArray, crater: IndexArray) -> dict[int, IndexArray]:
    """Return the craters that each number of an orbit's landmarks stands for, by its K sightings.

    A number stands for the ``crater`` (K,) that most of the sightings of this ``landmark`` (K,) are of, and for the
    next one as well where the solution has two landmarks of it.
    """
    found = {}
    for number, count in zip(*np.unique(orbit.numbers, return_counts=True), strict=True):
        craters, seen = np.unique(crater[landmark == number], return_counts=True)
        found[int(number)] = craters[np.argsort(-seen, kind="stable")[:count]]
    return found


def residual_records(orbit: Orbit, data: OrbitData) -> list[Record]:
    """List the residuals: the columns of the table ``residuals`` without its key."""
    times = data.pictures.times_s[data.pictures.image] / DAY_S
    return [
        {"time_days": float(time), "u_px": float(u), "v_px": float(v), "used": bool(used)}
        for time, (u, v), used in zip(times, orbit.residuals_px, orbit.used, strict=True)
        if np.isfinite(u)
    ]


def _end_of_arc(data: OrbitData) -> float:
    """Return the last time with data, up to rounding."""
    radio = [] if data.radiometry is None else [data.radiometry.times_s[-1:]]
    return float(np.concatenate([data.pictures.times_s[-1:], *radio]).max()) + 1.0


def _over(value: float | None, freedoms: int) -> float | None:
    return None if value is None else value / freedoms


def _length(vector: FloatArray) -> float:
    return float(np.linalg.norm(vector))


KIND = OrbitTrials

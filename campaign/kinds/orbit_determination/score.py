"""Scores of an orbit: errors in inertial space, at the epoch, over the arc and predicted.

The phase of the body's rotation and the landmarks' longitudes are one unknown by two names; inertial positions do not
depend on which of them is wrong.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

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
from boresight.campaign.trial.pose_score import nees
from boresight.estimators.orbit.contract import Orbit, OrbitEstimate
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.orbits.data import OrbitData
from boresight.scenarios.orbits.draw import OrbitTruth
from boresight.scenarios.orbits.true_orbit import DAY_S

Record = dict[str, object]

_STATE = 6
_AXES = 3


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
        "residual_rms_px": float(np.sqrt(np.mean(placed**2))),
        "wrong_left_share": float((wrong & orbit.used).sum() / max(int(orbit.used.sum()), 1)),
        "right_edited_share": float((~wrong & ~orbit.used).sum() / max(int((~wrong).sum()), 1)),
        "gm_error": float(gm),
        "solar_pressure_error": light / _length(truth.light_m_s2) - 1.0 if truth.light_m_s2.any() else None,
    }


def wrong_sightings(orbit: Orbit, truth: OrbitTruth, data: OrbitData) -> NDArray[np.bool_]:
    """(K,): sightings of another crater than the one of their number.

    A number stands for the crater that most of its sightings are of, and for the next one as well where the estimate
    has two landmarks of it.
    """
    wrong = np.ones(len(truth.crater), dtype=bool)
    numbers, counts = np.unique(orbit.numbers, return_counts=True)
    for number, count in zip(numbers, counts, strict=True):
        rows = np.flatnonzero(data.pictures.landmark == number)
        craters, seen = np.unique(truth.crater[rows], return_counts=True)
        stands_for = craters[np.argsort(-seen, kind="stable")[:count]]
        wrong[rows] = ~np.isin(truth.crater[rows], stands_for)
    return wrong


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

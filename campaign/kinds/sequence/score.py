"""Scores of a sequence: the errors of every frame, and their summary in a trial."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from boresight.campaign.trial.checks import (
    check_array,
    check_covariance,
    check_indices,
    check_numbers,
    check_seconds,
    check_several,
    check_status,
    check_type,
)
from boresight.campaign.trial.score import nees
from boresight.estimators.slam.contract import FrameEstimate, SequenceEstimate
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.observation import TrackSequence
from boresight.scenarios.sequences import SequenceTruth
from boresight.scenarios.sequences.trajectory import inertial_from_body
from boresight.scenarios.spec.trajectory import LEAST_HORIZONTAL

Epoch = dict[str, object]

REVOLUTIONS = (1, 2)
_FULL_TURN_DEG = 360.0
_SAME_FRAME_DEG = 1e-6
_LEAST_MOTION = 1e-9  # of the distance, below which a motion is rounding


def check_sequence(estimate: SequenceEstimate, sequence: TrackSequence) -> None:
    """Refuse an estimate that does not keep the contract.

    Raise `ValueError` if it is none, the status or the reason is none, frames are too many or missing, or a number is
    not finite or of an impossible size.
    """
    check_type(estimate, SequenceEstimate)
    check_status(estimate.status, estimate.reason)
    check_several("frames", estimate.frames)
    given, there = len(estimate.frames), len(sequence.frames)
    if given > there or (estimate.status == "ok" and given < there):
        raise ValueError(f"{given} frames of {estimate.status} for {there} of the sequence")
    check_numbers(estimate.diagnostics, "diagnostics")
    known: set[int] = set()
    for index, (frame, seen) in enumerate(zip(estimate.frames, sequence.frames, strict=False)):
        known.update(seen.tracks.tolist())
        _check_frame(frame, index, known)


def _check_frame(frame: FrameEstimate, index: int, known: set[int]) -> None:
    check_type(frame, FrameEstimate)
    where, n = f"frame {index}", len(frame.tracks)
    check_indices(f"{where}: tracks", frame.tracks, (n,))
    check_array(f"{where}: position_m", frame.position_m, (3,))
    check_array(f"{where}: points_m", frame.points_m, (n, 3))
    if frame.covariance_m2 is not None:
        check_covariance(f"{where}: covariance_m2", frame.covariance_m2, 3)
    if frame.velocity_m_s is not None:
        check_array(f"{where}: velocity_m_s", frame.velocity_m_s, (3,))
    check_seconds({"seconds": frame.seconds}, where)
    tracks = set(frame.tracks.tolist())
    if len(tracks) != n or not tracks <= known:
        raise ValueError(f"{where}: its landmarks are of tracks not seen so far, or of one twice")


def score_epochs(estimate: SequenceEstimate, sequence: TrackSequence, truth: SequenceTruth) -> list[Epoch]:
    """Score every frame that there is an estimate for: the columns of the table ``epochs`` without its key.

    An estimate stands in the body's axes as the spacecraft knows them. It is scored in inertial space: the truth is
    turned into those axes, so that an error of the known rotation counts where it makes the positions wrong, and not by
    another name for the same place.
    """
    older = np.empty(0, dtype=np.int64)
    epochs = []
    for index, (frame, seen) in enumerate(zip(estimate.frames, sequence.frames, strict=False)):
        turn = known_from_true(truth.trajectory.R_body_inertial[index], seen.R_body_inertial)
        epochs.append(
            {
                "frame": index,
                "anomaly_deg": None if np.isnan(truth.anomaly_deg[index]) else float(truth.anomaly_deg[index]),
                "time_s": float(truth.trajectory.times_s[index]),
                **_inertial(frame.position_m, seen.R_body_inertial, ""),
                **_inertial(truth.poses[index].camera_position_m, truth.trajectory.R_body_inertial[index], "true_"),
                **_position(frame, index, truth, turn),
                **_landmarks(frame, seen.tracks, older, _squares(frame, truth, turn)),
                "n_tracks": len(seen.tracks),
            }
        )
        older = seen.tracks
    return epochs


def known_from_true(true: FloatArray, known: FloatArray) -> FloatArray:
    """(3, 3) rotation from the body's true axes to those that it is believed to have, by its two R_body_inertial."""
    return np.eye(3) if np.array_equal(true, known) else known @ true.T


def _inertial(position_m: FloatArray, R_body_inertial: FloatArray, prefix: str) -> Epoch:
    """Turn a position into inertial axes, by the rotation of the body as it is true or as the spacecraft knows it."""
    turned = inertial_from_body(position_m, R_body_inertial)
    return {f"{prefix}{axis}_m": float(value) for axis, value in zip("xyz", turned, strict=True)}


def _position(frame: FrameEstimate, index: int, truth: SequenceTruth, turn: FloatArray) -> Epoch:
    error = frame.position_m - turn @ truth.poses[index].camera_position_m
    axes = orbit_frame(truth, index) @ turn.T
    radial, along, cross = axes @ error
    covariance = frame.covariance_m2
    return {
        "position_error_m": float(np.linalg.norm(error)),
        "radial_m": float(radial),
        "along_m": float(along),
        "cross_m": float(cross),
        "nees": nees(error, covariance),
        "position_sigma_m": None if covariance is None else float(np.sqrt(max(np.trace(covariance), 0.0))),
    }


def orbit_frame(truth: SequenceTruth, index: int) -> FloatArray:
    """(3, 3) rows, true body axes, at a frame of the true path: radial, along-track and cross-track.

    The plane of motion in inertial space is taken from the frames on both sides.
    """
    at, positions = truth.poses[index].camera_position_m, truth.trajectory.positions_m
    after, before = positions[min(index + 1, len(positions) - 1)], positions[max(index - 1, 0)]
    moved = truth.trajectory.R_body_inertial[index] @ (after - before)
    return track_axes(at, moved, truth.poses[index].rotation[0])


def track_axes(position_m: FloatArray, motion: FloatArray, right: FloatArray) -> FloatArray:
    """(3, 3) rows: radial, along the horizontal motion, and across both.

    Without a horizontal motion (less than 1e-9 of the distance is rounding), of a camera that hovers or descends, along
    is the horizontal part of ``right``, the camera's x axis; or of any other axis if that is vertical.
    """
    radial = position_m / np.linalg.norm(position_m)
    least = _LEAST_MOTION * np.linalg.norm(position_m)
    for along in (*([motion] if np.linalg.norm(motion) > least else []), right, *np.eye(3)):
        cross = np.cross(radial, along)
        if np.linalg.norm(cross) > LEAST_HORIZONTAL * np.linalg.norm(along):
            break
    cross /= np.linalg.norm(cross)
    return np.stack([radial, np.cross(cross, radial), cross])


def _squares(frame: FrameEstimate, truth: SequenceTruth, turn: FloatArray) -> FloatArray:
    """(n,) squared errors of the landmarks of a frame, m2; ``turn`` leads to the axes that they stand in."""
    true = truth.points_m[frame.tracks] @ turn.T
    return np.asarray(np.sum((frame.points_m - true) ** 2, axis=1), dtype=np.float64)


def _landmarks(frame: FrameEstimate, seen: NDArray[np.int64], older: NDArray[np.int64], squares: FloatArray) -> Epoch:
    """Score the landmarks of the tracks that are seen in this frame, all of them and without the new ones."""
    current = np.isin(frame.tracks, seen)
    settled = current & np.isin(frame.tracks, older)
    return {
        "landmark_rmse_m": _root_mean(squares[current]),
        "settled_landmark_rmse_m": _root_mean(squares[settled]),
        "n_landmarks": int(current.sum()),
        "n_settled": int(settled.sum()),
    }


def _root_mean(squares: FloatArray) -> float | None:
    return float(np.sqrt(squares.mean())) if len(squares) else None


def final_landmark_rmse(estimate: SequenceEstimate, sequence: TrackSequence, truth: SequenceTruth) -> float | None:
    """RMS error of all landmarks that were seen twice or more, m, each as it was estimated when it was seen last."""
    times_seen: Counter[int] = Counter()
    squares: dict[int, float] = {}
    for frame, seen, true in zip(estimate.frames, sequence.frames, truth.trajectory.R_body_inertial, strict=False):
        turn = known_from_true(true, seen.R_body_inertial)
        times_seen.update(seen.tracks.tolist())
        current = np.isin(frame.tracks, seen.tracks)
        own = _squares(frame, truth, turn)[current]
        squares.update(zip(frame.tracks[current].tolist(), own.tolist(), strict=True))
    return _root_mean(np.array([square for track, square in squares.items() if times_seen[track] > 1]))


def summary(
    estimate: SequenceEstimate, sequence: TrackSequence, truth: SequenceTruth, epochs: Sequence[Epoch]
) -> dict[str, float | None]:
    """Sum up a trial: errors after whole revolutions, RMS errors of its landmarks, mean NEES of its positions.

    What is summed up over frames is None for an estimate that failed: it has the first frames alone, whose errors are
    smaller. Its frames stay in the table ``epochs``.
    """
    known = [_number(epoch["nees"]) for epoch in epochs if epoch["nees"] is not None]
    over_frames = {
        "landmark_rmse_m": _over_frames(epochs, "landmark_rmse_m", "n_landmarks"),
        "settled_landmark_rmse_m": _over_frames(epochs, "settled_landmark_rmse_m", "n_settled"),
        "final_landmark_rmse_m": final_landmark_rmse(estimate, sequence, truth),
        "mean_position_nees": float(np.mean(known)) if known else None,
    }
    return {
        **{f"error_after_{n}_m": _after(epochs, n) for n in REVOLUTIONS},
        **{name: value if estimate.status == "ok" else None for name, value in over_frames.items()},
    }


def _after(epochs: Sequence[Epoch], revolutions: int) -> float | None:
    """Position error of the frame that ends a revolution; None where there is none or the estimate ended before."""
    wanted = revolutions * _FULL_TURN_DEG
    known = [e for e in epochs if e["anomaly_deg"] is not None]
    found = [e for e in known if abs(_number(e["anomaly_deg"]) - wanted) < _SAME_FRAME_DEG]
    return _number(found[0]["position_error_m"]) if found else None


def _over_frames(epochs: Sequence[Epoch], name: str, count: str) -> float | None:
    """Root of the mean square over all (frame, landmark) pairs."""
    pairs = [(_number(e[name]), _number(e[count])) for e in epochs if e[name] is not None]
    if not pairs:
        return None
    rmse, weights = np.array(pairs).T
    return float(np.sqrt(weights @ rmse**2 / weights.sum()))


def _number(value: object) -> float:
    assert isinstance(value, int | float)  # noqa: S101  the columns are made above
    return float(value)


def parameter_errors(estimate: SequenceEstimate, truth: SequenceTruth) -> dict[str, float]:
    """Score parameters of the motion that an estimator reports among its diagnostics.

    ``gm_m3_s2`` with ``gm_sigma_m3_s2``, or ``radiation_m_s2`` with ``radiation_sigma_m_s2``, give the size of the
    relative error in per cent, and the squared error over the variance (``nees``, 1 is expected). An estimate that
    failed has none.
    """
    if estimate.status != "ok":
        return {}
    true = {
        "gm": ("m3_s2", truth.gm_m3_s2),
        "radiation": ("m_s2", float(np.linalg.norm(truth.trajectory.radiation_m_s2))),
    }
    scores = {}
    for name, (unit, value) in true.items():
        told, sigma = (estimate.diagnostics.get(f"{name}{kind}_{unit}") for kind in ("", "_sigma"))
        if told is not None and value:
            scores[f"{name}_error_percent"] = 100.0 * abs(told / value - 1.0)
        if told is not None and sigma:
            scores[f"{name}_nees"] = ((told - value) / sigma) ** 2
    return scores

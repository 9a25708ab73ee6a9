"""What is drawn of a sequence: trajectory, errors with their covariance, tracks and landmarks."""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from campaign.inspection.recompute import Recomputed
from campaign.inspection.show import Drawn
from campaign.kinds.sequence.score import known_from_true, orbit_frame
from campaign.kinds.sequence.trial import FollowedSequence, SequenceTrials
from campaign.trial.kind import Record
from estimators.slam.contract import SequenceEstimate
from reports.figures.followed import (
    Followed,
    TrackLives,
    draw_error_bands,
    draw_landmark_map,
    draw_tracks,
    draw_trajectory,
)
from reports.schema.named_figure import NamedFigure
from scenarios.sequences import SequenceTruth
from scenarios.tracks import TrackSequence

FloatArray = NDArray[np.float64]


def draw_sequence_case(again: Recomputed) -> Drawn | None:
    """Draw the trial of an estimator of sequences up to its last frame."""
    shown, records, what = again.shown, again.records, str(again.case)
    if not isinstance(shown, FollowedSequence) or not isinstance(again.trials, SequenceTrials):
        return None
    truth, sequence = shown.seen.truth, shown.seen.sequence
    estimate = shown.estimate or SequenceEstimate("failed", ())
    figures = []
    if estimate.frames and records.get("epochs"):
        followed = followed_of(estimate, sequence, truth, records["epochs"], again.trials.ground.reach_m)
        figures += [_trajectory(followed, what), _bands(followed, what)]
    ends = last_seen(estimate, sequence, truth)
    if sequence.frames:
        figures.append(_tracks(lives_of(sequence, truth, ends, len(estimate.frames)), what))
    if ends:
        figures.append(_landmarks(truth, ends, what))
    notes = [
        f"The estimate has {len(estimate.frames)} of {len(sequence.frames)} frames.",
        "Estimators of sequences tell the covariance of the camera's position, and none of landmarks: those are drawn"
        " with their true errors.",
    ]
    return Drawn(figures, notes=notes)


def followed_of(
    estimate: SequenceEstimate, sequence: TrackSequence, truth: SequenceTruth, epochs: list[Record], radius_m: float
) -> Followed:
    """Collect trajectory and errors; positions in the axes of the true orbit at its first frame."""
    axes = _orbit_axes(truth)
    n = len(epochs)
    place = {prefix: _columns(epochs, *(f"{prefix}{axis}_m" for axis in "xyz")) for prefix in ("", "true_")}
    sigma = np.full((n, 3), np.nan)
    for index, frame in enumerate(estimate.frames):
        if frame.covariance_m2 is not None:
            turn = known_from_true(truth.path.R_body_inertial[index], sequence.frames[index].R_body_inertial)
            own = orbit_frame(truth, index) @ turn.T
            sigma[index] = np.sqrt(np.maximum(np.diag(own @ frame.covariance_m2 @ own.T), 0.0))
    return Followed(
        anomaly_deg=_columns(epochs, "anomaly_deg")[:, 0],
        true_m=place["true_"] @ axes.T,
        estimated_m=place[""] @ axes.T,
        error_m=_columns(epochs, "radial_m", "along_m", "cross_m"),
        sigma_m=sigma,
        body_radius_m=radius_m,
    )


def _orbit_axes(truth: SequenceTruth) -> FloatArray:
    """(3, 3) rows, inertial: towards the first position, along the motion there, and across both."""
    at, velocity = truth.path.positions_m[0], truth.path.velocities_m_s[0]
    radial = at / np.linalg.norm(at)
    cross = np.cross(radial, velocity)
    cross /= np.linalg.norm(cross)
    return np.stack([radial, np.cross(cross, radial), cross])


def last_seen(
    estimate: SequenceEstimate, sequence: TrackSequence, truth: SequenceTruth
) -> dict[int, tuple[FloatArray, int]]:
    """Return the error (3,), m, true body axes, of each track's landmark when seen last, and how often it was seen."""
    errors: dict[int, FloatArray] = {}
    times: Counter[int] = Counter()
    for index, (frame, seen) in enumerate(zip(estimate.frames, sequence.frames, strict=False)):
        turn = known_from_true(truth.path.R_body_inertial[index], seen.R_body_inertial)
        held = dict(zip(frame.tracks.tolist(), frame.points_m, strict=True))
        times.update(seen.tracks.tolist())
        errors |= {t: turn.T @ held[t] - truth.points_m[t] for t in seen.tracks.tolist() if t in held}
    return {track: (error, times[track]) for track, error in errors.items()}


def lives_of(
    sequence: TrackSequence, truth: SequenceTruth, ends: dict[int, tuple[FloatArray, int]], estimated: int
) -> TrackLives:
    """Say from where to where each track lives, and where it was seen at a wrong place."""
    anomaly, wrong = truth.anomaly_deg, []
    span: dict[int, tuple[int, int]] = {}
    for index, frame in enumerate(sequence.frames):
        for track in frame.tracks.tolist():
            span[track] = (span[track][0] if track in span else index, index)
        wrong += [(anomaly[index], track) for track in frame.tracks[truth.wrong[index]].tolist()]
    tracks = sorted(span)
    place = {track: row for row, track in enumerate(tracks)}
    first, last = (anomaly[[span[track][end] for track in tracks]] for end in (0, 1))
    error = [float(np.linalg.norm(ends[track][0])) if track in ends else np.nan for track in tracks]
    return TrackLives(
        first, last, np.array(error),
        np.array([(at, place[track]) for at, track in wrong]).reshape(-1, 2),
        np.array([(anomaly[index], len(frame.tracks)) for index, frame in enumerate(sequence.frames)]),
        float(anomaly[max(estimated - 1, 0)]) if estimated < len(sequence.frames) else None,
    )  # fmt: skip


def _columns(records: list[Record], *names: str) -> FloatArray:
    return np.array([[float(str(record[name])) for name in names] for record in records])


def _trajectory(followed: Followed, what: str) -> NamedFigure:
    return NamedFigure(
        "trajectory",
        draw_trajectory(followed, what),
        f"{what}. True and estimated trajectory in inertial space: in the plane of the orbit, and against its normal.",
        "A circle about the body and an estimate of it, seen from above and from the side.",
    )


def _bands(followed: Followed, what: str) -> NamedFigure:
    return NamedFigure(
        "errors",
        draw_error_bands(followed, what),
        f"{what}. Error of the camera's position right after each frame, and three standard deviations of what the"
        " estimator says of it.",
        "Three curves over the anomaly in bands about zero.",
    )


def _tracks(lives: TrackLives, what: str) -> NamedFigure:
    return NamedFigure(
        "tracks",
        draw_tracks(lives, what),
        f"{what}. Above, each track from its first to its last frame, in the colour of its landmark's error when it was"
        " seen last; crosses are sightings at a wrong place. Below, how many tracks each frame has.",
        "Short lines rising from left to right, and the number of tracks over the anomaly.",
    )


def _landmarks(truth: SequenceTruth, ends: dict[int, tuple[FloatArray, int]], what: str) -> NamedFigure:
    tracks = list(ends)
    errors = np.array([ends[track][0] for track in tracks])
    new = np.array([ends[track][1] < 2 for track in tracks])
    return NamedFigure(
        "landmarks",
        draw_landmark_map(truth.points_m[tracks], errors, new, what),
        f"{what}. Left, landmarks on the body by their error when they were seen last. Right, the error of their height"
        " over that along the ground.",
        "Coloured dots over longitude and latitude, and a scatter of two components of their errors.",
    )

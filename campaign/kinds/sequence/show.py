"""The displays of sequences."""

from __future__ import annotations

from collections import Counter
from typing import cast

import numpy as np

from boresight.campaign.inspection.recompute import Case, Recomputed
from boresight.campaign.inspection.show import (
    CaseFigures,
    CaseFiles,
    EstimatorRun,
    PosedFrame,
    PosedFrames,
    Show,
    coarsened,
    middle_and_worst,
)
from boresight.campaign.kinds.sequence import FollowedSequence, SequenceTrials
from boresight.campaign.kinds.sequence.score import known_from_true, orbit_frame, track_axes
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.runs.execute import opened
from boresight.campaign.store import RunFolder
from boresight.campaign.trial.kind import Record
from boresight.estimators.slam.contract import SequenceEstimate
from boresight.reports.figures.named import NamedFigure
from boresight.reports.figures.sequences import (
    ANOMALY,
    TIME,
    TrackLifetimes,
    TrajectoryErrors,
    draw_error_bands,
    draw_landmark_map,
    draw_tracks,
    draw_trajectory,
)
from boresight.reports.pages.view3d import TRUE, CameraSet, PointSet, View3D
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.bodies import load_body
from boresight.scenarios.bodies.embedded import sphere
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Pose, TriangleMesh
from boresight.scenarios.observation import TrackSequence
from boresight.scenarios.sequences import MeshGround, SequenceTruth


def draw_sequence_case(again: Recomputed) -> CaseFigures:
    """Draw the trial of an estimator of sequences up to its last frame."""
    shown, records, what = cast("FollowedSequence", again.shown), again.records, str(again.case)
    truth, sequence = shown.truth, shown.observation
    estimate = shown.estimate or SequenceEstimate("failed", ())
    figures = []
    if estimate.frames and records.get("epochs"):
        followed = followed_of(estimate, sequence, truth, records["epochs"], again.trials.ground.reach_m)
        circles = followed.abscissa == ANOMALY
        figures += [
            NamedFigure(
                "trajectory",
                draw_trajectory(followed, what),
                f"{what}. True and estimated trajectory in inertial space: in the plane of the"
                f" {'orbit' if circles else 'first motion'}, and against its normal.",
                f"A {'circle' if circles else 'way'} about the body and an estimate of it, seen from above and from the"
                " side.",
            ),
            NamedFigure(
                "errors",
                draw_error_bands(followed, what),
                f"{what}. Error of the camera's position right after each frame, and three standard deviations of what"
                " the estimator says of it.",
                f"Three curves over the {followed.abscissa.partition(',')[0]} in bands about zero.",
            ),
        ]
    ends = last_seen(estimate, sequence, truth)
    if sequence.frames:
        lives = lives_of(sequence, truth, ends, len(estimate.frames))
        figures.append(
            NamedFigure(
                "tracks",
                draw_tracks(lives, what),
                f"{what}. Above, each track from its first to its last frame, in the colour of its landmark's"
                " error when it was seen last; crosses are sightings at a wrong place. Below, how many tracks each"
                " frame has.",
                "Short lines rising from left to right, and the number of tracks over the"
                f" {lives.abscissa.partition(',')[0]}.",
            )
        )
    if ends:
        tracks = list(ends)
        errors = np.array([ends[track][0] for track in tracks])
        new = np.array([ends[track][1] < 2 for track in tracks])
        figures.append(
            NamedFigure(
                "landmarks",
                draw_landmark_map(truth.points_m[tracks], errors, new, what),
                f"{what}. Left, landmarks on the body by their error when they were seen last. Right, the error of"
                " their height over that along the ground.",
                "Coloured dots over longitude and latitude, and a scatter of two components of their errors.",
            )
        )
    notes = [
        f"The estimate has {len(estimate.frames)} of {len(sequence.frames)} frames.",
        "Estimators of sequences tell the covariance of the camera's position, and none of landmarks: those are drawn"
        " with their true errors.",
    ]
    return CaseFigures(figures, notes=notes)


def followed_of(
    estimate: SequenceEstimate, sequence: TrackSequence, truth: SequenceTruth, epochs: list[Record], radius_m: float
) -> TrajectoryErrors:
    """Collect trajectory and errors; positions in the axes of the true orbit at its first frame."""
    path, n = truth.trajectory, len(epochs)
    right = path.R_body_inertial[0].T @ truth.poses[0].rotation[0]
    # Towards the first position, along the motion there, and across both.
    axes = track_axes(path.positions_m[0], path.velocities_m_s[0], right)
    along, abscissa = _abscissa(truth)
    place = {prefix: _columns(epochs, *(f"{prefix}{axis}_m" for axis in "xyz")) for prefix in ("", "true_")}
    sigma = np.full((n, 3), np.nan)
    for index, frame in enumerate(estimate.frames):
        if frame.covariance_m2 is not None:
            turn = known_from_true(truth.trajectory.R_body_inertial[index], sequence.frames[index].R_body_inertial)
            own = orbit_frame(truth, index) @ turn.T
            sigma[index] = np.sqrt(np.maximum(np.diag(own @ frame.covariance_m2 @ own.T), 0.0))
    return TrajectoryErrors(
        along=along[:n],
        true_m=place["true_"] @ axes.T,
        estimated_m=place[""] @ axes.T,
        error_m=_columns(epochs, "radial_m", "along_m", "cross_m"),
        sigma_m=sigma,
        body_radius_m=radius_m,
        abscissa=abscissa,
    )


def _abscissa(truth: SequenceTruth) -> tuple[FloatArray, str]:
    """Return what the frames are drawn over, (F,), and its label: the anomaly, or the time where there is none."""
    if np.isnan(truth.anomaly_deg).any():
        return truth.trajectory.times_s, TIME
    return truth.anomaly_deg, ANOMALY


def last_seen(
    estimate: SequenceEstimate, sequence: TrackSequence, truth: SequenceTruth
) -> dict[int, tuple[FloatArray, int]]:
    """Return the error (3,), m, true body axes, of each track's landmark when seen last, and how often it was seen."""
    errors: dict[int, FloatArray] = {}
    times: Counter[int] = Counter()
    for index, (frame, seen) in enumerate(zip(estimate.frames, sequence.frames, strict=False)):
        turn = known_from_true(truth.trajectory.R_body_inertial[index], seen.R_body_inertial)
        held = dict(zip(frame.tracks.tolist(), frame.points_m, strict=True))
        times.update(seen.tracks.tolist())
        errors |= {t: turn.T @ held[t] - truth.points_m[t] for t in seen.tracks.tolist() if t in held}
    return {track: (error, times[track]) for track, error in errors.items()}


def lives_of(
    sequence: TrackSequence, truth: SequenceTruth, ends: dict[int, tuple[FloatArray, int]], estimated: int
) -> TrackLifetimes:
    """Say from where to where each track lives, and where it was seen at a wrong place."""
    (along, abscissa), wrong = _abscissa(truth), []
    span: dict[int, tuple[int, int]] = {}
    for index, frame in enumerate(sequence.frames):
        for track in frame.tracks.tolist():
            span[track] = (span[track][0] if track in span else index, index)
        wrong += [(along[index], track) for track in frame.tracks[truth.wrong[index]].tolist()]
    tracks = sorted(span)
    place = {track: row for row, track in enumerate(tracks)}
    first, last = (along[[span[track][end] for track in tracks]] for end in (0, 1))
    error = [float(np.linalg.norm(ends[track][0])) if track in ends else np.nan for track in tracks]
    return TrackLifetimes(
        first, last, np.array(error),
        np.array([(at, place[track]) for at, track in wrong]).reshape(-1, 2),
        np.array([(along[index], len(frame.tracks)) for index, frame in enumerate(sequence.frames)]),
        float(along[max(estimated - 1, 0)]) if estimated < len(sequence.frames) else None,
        abscissa,
    )  # fmt: skip


def _columns(records: list[Record], *names: str) -> FloatArray:
    return np.array([[float(str(record[name])) for name in names] for record in records])


def look_at_sequences(scene: EstimatorRun) -> View3D:
    """Show the trial in the middle and the worst one, in the axes that the body has at each frame."""
    marks, cameras, ground = [], [], None
    for name, colour, again in middle_and_worst(scene):
        if again.shown is not None:
            ground = again.trials.ground
            marks += _track_marks(again.shown, name)
            cameras += _paths(again.shown, again.case, name, colour)
    if ground is None:
        raise BoresightError(f"{scene.folder.path}: no trial of {scene.title} has a sequence to look at")
    if isinstance(ground, MeshGround):
        loaded = scene.campaign.scenario(scene.scenario)
        mesh = load_body(loaded.spec.body, loaded.search_dirs).mesh
    else:
        ball = sphere()
        mesh = TriangleMesh(ball.vertices_m * (ground.reach_m / ball.radius_m), ball.faces)
    body = coarsened(mesh)
    note = "The trial of median error and the worst one; a landmark stands where it truly is."
    return View3D(scene.title, note, body.vertices_m, body.faces, marks, cameras)


def _track_marks(shown: FollowedSequence, name: str) -> list[PointSet]:
    if shown.estimate is None:
        return []
    truth = shown.truth
    ends = last_seen(shown.estimate, shown.observation, truth)
    tracks = list(ends)
    errors = np.array([float(np.linalg.norm(ends[track][0])) for track in tracks])
    texts = [
        f"track {t}<br>error {e:.3g} m<br>seen in {ends[t][1]} frames" for t, e in zip(tracks, errors, strict=True)
    ]
    return [PointSet(f"landmark error, {name} trial", truth.points_m[tracks].reshape(-1, 3), errors, texts, "m")]


def _paths(shown: FollowedSequence, case: Case, name: str, colour: str) -> list[CameraSet]:
    frames = () if shown.estimate is None else shown.estimate.frames
    true = np.array([pose.camera_position_m for pose in shown.truth.poses])
    estimated = np.array([frame.position_m for frame in frames]).reshape(-1, 3)
    errors = np.linalg.norm(estimated - true[: len(estimated)], axis=1)
    texts = [f"trial {case.trial}, frame {i}<br>{error:.3g} m from the truth" for i, error in enumerate(errors)]
    truth = CameraSet(f"truth, {name} trial", TRUE, true, [f"frame {i}" for i in range(len(true))], joined=True)
    return [truth, CameraSet(f"estimate, {name} trial", colour, estimated, texts, joined=True)]


def kept(shown: FollowedSequence) -> CaseFiles:
    """Return the frames of an estimate; nothing of an estimator that raised."""
    if shown.estimate is None:
        return CaseFiles()
    frames = [
        {
            "position_body_m": frame.position_m.tolist(),
            "covariance_m2": None if frame.covariance_m2 is None else frame.covariance_m2.tolist(),
            "tracks": frame.tracks.tolist(),
            "points_body_m": frame.points_m.tolist(),
        }
        for frame in shown.estimate.frames
    ]
    return CaseFiles({}, {"status": shown.estimate.status, "reason": shown.estimate.reason, "frames": frames})


def posed(shown: FollowedSequence, case: Case) -> PosedFrames:
    """Return the frames of a sequence in body axes, and its landmarks where they were put when they were seen last."""
    del case
    sequence, truth = shown.observation, shown.truth
    frames, places = [], {}
    estimates = () if shown.estimate is None else shown.estimate.frames
    for index, (found, seen) in enumerate(zip(estimates, sequence.frames, strict=False)):
        held = dict(zip(found.tracks.tolist(), found.points_m, strict=True))
        places.update({track: held[track] for track in seen.tracks.tolist() if track in held})
        frames.append(
            PosedFrame(
                f"{index:06d}.tiff",
                seen.time_s,
                truth.poses[index],
                Pose(seen.R_cam_body, -seen.R_cam_body @ found.position_m),
                seen.tracks,
                seen.uv_px,
            )
        )
    return PosedFrames(sequence.camera, frames, places)


def trajectory(campaign: ResolvedCampaign, folder: RunFolder, case: Case) -> list[PosedFrame]:
    """Combine the stored positions of a sequence with its attitudes, true and as known on board, in inertial space.

    Epochs are those of the given states; on an orbit the first is 0.
    """
    trials: SequenceTrials = opened(campaign, case.scenario, folder.path)
    epochs = folder.of_trial("epochs", case.scenario, case.estimator, case.trial).to_pylist()
    if not epochs:
        return []
    (path, sequence), frames = trials.known(case.trial), []
    for epoch in epochs:
        index = int(epoch["frame"])
        seen, at = sequence.frames[index], [np.array([epoch[f"{p}{a}_m"] for a in "xyz"]) for p in ("true_", "")]
        turns = (path.poses[index].rotation @ path.R_body_inertial[index], seen.R_cam_body @ seen.R_body_inertial)
        true, estimated = (
            Pose(turn, -turn @ place, from_frame="inertial") for turn, place in zip(turns, at, strict=True)
        )
        time_s = path.start_s + float(epoch["time_s"])
        frames.append(PosedFrame(f"{index:06d}.tiff", time_s, true, estimated, seen.tracks, seen.uv_px))
    return frames


SHOW = Show(
    draw=draw_sequence_case,
    kept=kept,
    look=look_at_sequences,
    posed=posed,
    trajectory=trajectory,
    long=lambda campaign: any(s.spec.sequence and s.spec.sequence.images for s in campaign.scenarios),
)

"""What trials of sequences show of themselves."""

from __future__ import annotations

import numpy as np

from campaign.inspection.case import Case
from campaign.inspection.coarse import coarsened
from campaign.inspection.look_parts import MOST_FACES, middle_and_worst
from campaign.inspection.posed import PosedFrame, PosedFrames
from campaign.inspection.recompute import recompute
from campaign.inspection.show import Kept, Scene, Show, listed
from campaign.kinds.sequence.draw import draw_sequence_case, last_seen
from campaign.kinds.sequence.trial import FollowedSequence, SequenceTrials
from campaign.resolved import ResolvedCampaign
from campaign.runs.worker import opened
from campaign.store import RunFolder
from reports.pages.look import TRUE, Cameras, Look, Marks
from scenarios.bodies import load_body
from scenarios.bodies.embedded import sphere
from scenarios.errors import BoresightError
from scenarios.geometry import Pose, TriangleMesh
from scenarios.sequences import MeshGround


def look_at_sequences(scene: Scene) -> Look:
    """Show the trial in the middle and the worst one, in the axes that the body has at each frame."""
    marks, cameras, ground = [], [], None
    for name, colour, case in middle_and_worst(scene):
        again = recompute(scene.campaign, scene.folder, case)
        if not isinstance(again.shown, FollowedSequence) or not isinstance(again.trials, SequenceTrials):
            continue
        ground = again.trials.ground
        marks += _track_marks(again.shown, name)
        cameras += _paths(again.shown, case, name, colour)
    if ground is None:
        raise BoresightError(f"{scene.folder.path}: no trial of {scene.title} has a sequence to look at")
    body = coarsened(
        _mesh_of(scene.campaign, scene.scenario, isinstance(ground, MeshGround), ground.reach_m), MOST_FACES
    )
    note = "The trial of median error and the worst one; a landmark stands where it truly is."
    return Look(scene.title, note, body.vertices_m, body.faces, marks, cameras)


def _mesh_of(campaign: ResolvedCampaign, scenario: str, meshed: bool, radius_m: float) -> TriangleMesh:
    if meshed:
        loaded = campaign.scenario(scenario)
        return load_body(loaded.spec.body, loaded.search_dirs).mesh
    ball = sphere()
    return TriangleMesh(ball.vertices_m * (radius_m / ball.radius_m), ball.faces)


def _track_marks(shown: FollowedSequence, name: str) -> list[Marks]:
    if shown.estimate is None:
        return []
    truth = shown.seen.truth
    ends = last_seen(shown.estimate, shown.seen.sequence, truth)
    tracks = list(ends)
    errors = np.array([float(np.linalg.norm(ends[track][0])) for track in tracks])
    texts = [
        f"track {t}<br>error {e:.3g} m<br>seen in {ends[t][1]} frames" for t, e in zip(tracks, errors, strict=True)
    ]
    return [Marks(f"landmark error, {name} trial", truth.points_m[tracks].reshape(-1, 3), errors, texts, "m")]


def _paths(shown: FollowedSequence, case: Case, name: str, colour: str) -> list[Cameras]:
    frames = () if shown.estimate is None else shown.estimate.frames
    true = np.array([pose.camera_position_m for pose in shown.seen.truth.poses])
    estimated = np.array([frame.position_m for frame in frames]).reshape(-1, 3)
    errors = np.linalg.norm(estimated - true[: len(estimated)], axis=1)
    texts = [f"trial {case.trial}, frame {i}<br>{error:.3g} m from the truth" for i, error in enumerate(errors)]
    truth = Cameras(f"truth, {name} trial", TRUE, true, [f"frame {i}" for i in range(len(true))], joined=True)
    return [truth, Cameras(f"estimate, {name} trial", colour, estimated, texts, joined=True)]


def kept(shown: object) -> Kept:
    """Return the frames of an estimate; nothing of an estimator that raised."""
    if not isinstance(shown, FollowedSequence) or shown.estimate is None:
        return Kept()
    frames = [
        {
            "position_body_m": frame.position_m.tolist(),
            "covariance_m2": listed(frame.covariance_m2),
            "tracks": frame.tracks.tolist(),
            "points_body_m": frame.points_m.tolist(),
        }
        for frame in shown.estimate.frames
    ]
    return Kept({}, {"status": shown.estimate.status, "reason": shown.estimate.reason, "frames": frames})


def posed(shown: object, case: Case) -> PosedFrames | None:
    """Return the frames of a sequence in body axes, and its landmarks where they were put when they were seen last."""
    del case
    if not isinstance(shown, FollowedSequence):
        return None
    sequence, truth = shown.seen.sequence, shown.seen.truth
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
    """Combine the stored positions of a sequence with its attitudes, true and as known on board, in inertial space."""
    trials = opened(campaign, case.scenario, folder.path, SequenceTrials)
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
        frames.append(PosedFrame(f"{index:06d}.tiff", float(epoch["time_s"]), true, estimated, seen.tracks, seen.uv_px))
    return frames


def _on_images(campaign: ResolvedCampaign) -> bool:
    return any(s.spec.sequence is not None and s.spec.sequence.images is not None for s in campaign.scenarios)


SHOW = Show(
    draw=draw_sequence_case,
    kept=kept,
    look=look_at_sequences,
    posed=posed,
    trajectory=trajectory,
    long=_on_images,
)

"""What trials of sequences show of themselves."""

from __future__ import annotations

import numpy as np

from campaign.inspection.case import Case
from campaign.inspection.posed import PosedFrame, PosedFrames
from campaign.inspection.show import Kept, Show, listed
from campaign.kinds.sequence.draw import draw_sequence_case
from campaign.kinds.sequence.look import look_at_sequences
from campaign.kinds.sequence.trial import FollowedSequence, SequenceTrials
from campaign.resolved import ResolvedCampaign
from campaign.runs.worker import opened
from campaign.store import RunFolder
from scenarios.geometry import Pose


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

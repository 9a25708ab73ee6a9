"""Poses of a stored run, true and estimated, with what was seen of which landmark: what trajectories are made of."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from campaign.experiments.registry import Bench
from campaign.experiments.sequence import FollowedSequence, SequenceTrials
from campaign.experiments.single_image import EstimatedImage, SingleImage
from campaign.inspection.case import Case
from campaign.inspection.recompute import Recomputed, recompute
from campaign.resolve import ResolvedCampaign
from campaign.score import pose_of
from campaign.store import RunFolder
from campaign.worker import experiment_of
from scenarios.errors import BoresightError
from scenarios.geometry import Camera, Pose

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class PosedFrame:
    """One image of a trajectory.

    Parameters
    ----------
    name
        Of its file.
    time_s
        Epoch; the number of the trial where images have none.
    true, estimated
        T_cam_world. The world is the body of single images, and of sequences inertial space in a trajectory and the
        body, as the spacecraft knows its axes, in a model.
    landmarks, uv_px
        (n,) and (n, 2): which landmarks were seen in it, and where.
    """

    name: str
    time_s: float
    true: Pose
    estimated: Pose
    landmarks: IndexArray
    uv_px: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PosedFrames:
    """Frames of one camera in the order of time, and the estimated place of each landmark, world axes, m."""

    camera: Camera
    frames: Sequence[PosedFrame]
    places_m: dict[int, FloatArray]


def posed(campaign: ResolvedCampaign, folder: RunFolder, cases: Iterable[Case]) -> Iterator[tuple[str, PosedFrames]]:
    """Recompute cases and give their poses in the body's axes: a model of each sequence, or one of all single images.

    Yields
    ------
    name, frames
        Name of the model, after its scenario and estimator, and of a sequence its trial.

    Raises
    ------
    BoresightError
        If what is recomputed is not what is stored.
    """
    together: dict[tuple[str, str], list[PosedFrames]] = {}
    for case in cases:
        again = _same(recompute(campaign, folder, case))
        if isinstance(again.shown, FollowedSequence):
            yield case.stem, _sequence(again.shown)
        elif isinstance(again.shown, EstimatedImage):
            together.setdefault((case.scenario, case.estimator), []).append(_single(again.shown, case))
    for (scenario, estimator), parts in together.items():
        frames = [frame for part in parts for frame in part.frames]
        places = {number: place for part in parts for number, place in part.places_m.items()}
        yield f"{scenario}_{estimator}", PosedFrames(parts[0].camera, frames, places)


def check_posed(campaign: ResolvedCampaign) -> None:
    """Refuse a campaign whose trials have no camera poses.

    Raises
    ------
    BoresightError
        If they have none.
    """
    kind = campaign.spec.experiment
    if kind not in (SequenceTrials.kind, SingleImage.kind):
        raise BoresightError(f"trials of {kind} have no camera poses: export them with --to csv, parquet or latex")


def _same(again: Recomputed) -> Recomputed:
    if again.sameness.differences:
        raise BoresightError(f"{again.case}: {again.sameness}: the run cannot be exported so")
    return again


def stored_images(rows: pd.DataFrame) -> Iterator[tuple[str, list[PosedFrame]]] | None:
    """Give the trajectories of single images as their rows hold them; None where they hold no poses.

    Rows of other kinds have none, nor have those that an earlier version stored.
    """
    solved = rows[rows["status"] == "ok"]
    if "true_qw" not in rows or rows["true_qw"].isna().any() or solved["qw"].isna().any():
        return None
    nothing = np.zeros(0, dtype=np.int64), np.zeros((0, 2))
    return (
        (
            f"{scenario}_{estimator}",
            [
                PosedFrame(*_image_of(row), pose_of(row, "true_"), pose_of(row), *nothing)
                for row in own.to_dict("records")
            ],
        )
        for (scenario, estimator), own in solved.groupby(["scenario", "estimator"], sort=False)
    )


def _image_of(row: Mapping[Hashable, Any]) -> tuple[str, float]:
    """Name of the image of a row, and its epoch: the trial where images have none."""
    name, trial = str(row["image"] or ""), int(row["trial"])
    return (name, float(row["time_s"])) if name else (f"{trial:07d}.tiff", float(trial))


def _single(shown: EstimatedImage, case: Case) -> PosedFrames:
    """Return an estimated image; no frame where there is no estimate."""
    camera, estimate = shown.observation.camera, shown.estimate
    if estimate is None or estimate.status != "ok":
        return PosedFrames(camera, [], {})
    frame, table = shown.observation.frames[0], estimate.details.get("landmarks")
    numbers, uv, places = np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros((0, 3))
    if table is not None and len(table["landmark"]):
        numbers = np.asarray(table["landmark"], dtype=np.int64)
        uv, places = (
            np.column_stack([np.asarray(table[name], dtype=np.float64) for name in names])
            for names in (("u_px", "v_px"), ("x_m", "y_m", "z_m"))
        )
    one = PosedFrame(
        shown.sight.image_name or f"{case.trial:07d}.tiff",
        frame.time_s if shown.sight.image_name else float(case.trial),
        shown.sight.view.T_cam_body,
        estimate.poses[0],
        numbers,
        uv,
    )
    return PosedFrames(camera, [one], dict(zip(numbers.tolist(), places, strict=True)))


def _sequence(shown: FollowedSequence) -> PosedFrames:
    """Return the frames of a sequence in body axes, and its landmarks where they were put when they were seen last."""
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


def trajectories(
    campaign: ResolvedCampaign, folder: RunFolder, cases: Iterable[Case]
) -> Iterator[tuple[str, Sequence[PosedFrame]]]:
    """Give the trajectory of each case: of sequences in inertial space, without an estimator working again."""
    if campaign.spec.experiment != SequenceTrials.kind:
        for name, found in posed(campaign, folder, cases):
            yield name, found.frames
        return
    for case in cases:
        experiment = experiment_of(campaign, case.scenario, Bench(folder.path, 1, keep_images=False))
        if isinstance(experiment, SequenceTrials):
            yield case.stem, _flown(experiment, folder, case)


def _flown(experiment: SequenceTrials, folder: RunFolder, case: Case) -> list[PosedFrame]:
    """Lay the stored positions of a sequence beside its attitudes, as they are true and as they are known."""
    epochs = folder.of_trial("epochs", case.scenario, case.estimator, case.trial).to_pylist()
    if not epochs:
        return []
    (path, sequence), frames = experiment.known(case.trial), []
    for epoch in epochs:
        index = int(epoch["frame"])
        seen, at = sequence.frames[index], [np.array([epoch[f"{p}{a}_m"] for a in "xyz"]) for p in ("true_", "")]
        turns = (path.poses[index].rotation @ path.R_body_inertial[index], seen.R_cam_body @ seen.R_body_inertial)
        true, estimated = (
            Pose(turn, -turn @ place, from_frame="inertial") for turn, place in zip(turns, at, strict=True)
        )
        frames.append(PosedFrame(f"{index:06d}.tiff", float(epoch["time_s"]), true, estimated, seen.tracks, seen.uv_px))
    return frames

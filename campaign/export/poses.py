"""Poses of a stored run, true and estimated, with what was seen of which landmark: what trajectories are made of."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from campaign.inspection.case import Case
from campaign.inspection.posed import PosedFrame, PosedFrames
from campaign.inspection.recompute import Recomputed, recompute
from campaign.inspection.show import Show, show_of
from campaign.resolved import ResolvedCampaign
from campaign.store import RunFolder
from campaign.trial.pose_score import pose_of
from scenarios.errors import BoresightError

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


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
    show = _showing(campaign)
    together: dict[tuple[str, str], list[PosedFrames]] = {}
    for case in cases:
        found = None if show.posed is None else show.posed(_same(recompute(campaign, folder, case)).shown, case)
        if found is not None and show.pooled:
            together.setdefault((case.scenario, case.estimator), []).append(found)
        elif found is not None:
            yield case.stem, found
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
    _showing(campaign)


def _showing(campaign: ResolvedCampaign) -> Show:
    kind = campaign.spec.experiment
    show = show_of(kind)
    if show is None or show.posed is None:
        raise BoresightError(f"trials of {kind} have no camera poses: export them with --to csv, parquet or latex")
    return show


def _same(again: Recomputed) -> Recomputed:
    if again.sameness.differences:
        raise BoresightError(f"{again.case}: {again.sameness}: the run cannot be exported so")
    return again


def stored_images(rows: pd.DataFrame) -> Iterator[tuple[str, list[PosedFrame]]] | None:
    """Return the trajectories of single images as their rows hold them; None where they hold no poses."""
    solved = rows[rows["status"] == "ok"]
    if rows["true_qw"].isna().any() or solved["qw"].isna().any():
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


def trajectories(
    campaign: ResolvedCampaign, folder: RunFolder, cases: Iterable[Case]
) -> Iterator[tuple[str, Sequence[PosedFrame]]]:
    """Give the trajectory of each case: of sequences in inertial space, without an estimator working again."""
    show = _showing(campaign)
    if show.trajectory is None:
        for name, found in posed(campaign, folder, cases):
            yield name, found.frames
        return
    for case in cases:
        yield case.stem, show.trajectory(campaign, folder, case)

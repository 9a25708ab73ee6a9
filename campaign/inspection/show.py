"""The displays of a kind of trial: pictures and files of a case, a run in space, poses to export."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from importlib.util import find_spec
from typing import TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from campaign.inspection.case import Case
from campaign.inspection.posed import PosedFrame, PosedFrames
from campaign.inspection.recompute import Recomputed
from campaign.resolved import ResolvedCampaign
from campaign.runs.worker import opened
from campaign.store import RunFolder
from campaign.trial.kind import module_of
from reports.pages.view3d import View3D
from reports.run.data import RunData
from reports.schema.named_figure import NamedFigure
from scenarios.geometry import Pose

T = TypeVar("T")


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """Figures of a case, the credits that they carry, and sentences above them."""

    figures: Sequence[NamedFigure]
    credits: Sequence[str] = ()
    notes: Sequence[str] = field(default=())


@dataclass(frozen=True, slots=True, eq=False)
class Kept:
    """Files to write next to the page of a case: images that a method saw, by name, and what it returned."""

    images: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)
    estimate: Mapping[str, object] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """One scenario and estimator of a stored run, to be looked at in space."""

    campaign: ResolvedCampaign
    folder: RunFolder
    run: RunData
    scenario: str
    label: str

    @property
    def title(self) -> str:
        """Title of the page."""
        return f"{self.scenario} / {self.label}"

    def opened(self, kind: type[T]) -> T:
        """Open the trials of the scenario, with the first data base, which are of a class that their kind knows."""
        return opened(self.campaign, self.scenario, self.folder.path, kind)


@dataclass(frozen=True, slots=True, kw_only=True)
class Show:
    """The displays of a kind of trial; None for one that it lacks.

    Parameters
    ----------
    draw
        Draws a recomputed case, None where its witness was shown nothing.
    kept
        Returns what is kept of what a witness was shown.
    look
        Collects what is to be seen of a run in space.
    examples
        Draws typical trials for the report of a run.
    posed
        Returns the camera poses of a recomputed case in the body's axes.
    trajectory
        Returns the trajectory of a stored case without an estimator working again; None where ``posed`` gives it.
    pooled
        Whether the poses of all trials are of one body at rest and make one model.
    long
        Whether a case of a campaign takes minutes to make again.
    """

    draw: Callable[[Recomputed], Drawn | None] = lambda again: None
    kept: Callable[[object], Kept] = lambda shown: Kept()
    look: Callable[[Scene], View3D] | None = None
    examples: Callable[[ResolvedCampaign, RunFolder], Iterator[NamedFigure]] = lambda campaign, folder: iter(())
    posed: Callable[[object, Case], PosedFrames | None] | None = None
    trajectory: Callable[[ResolvedCampaign, RunFolder, Case], Sequence[PosedFrame]] | None = None
    pooled: bool = False
    long: Callable[[ResolvedCampaign], bool] = lambda campaign: False


def plain_pose(pose: Pose) -> dict[str, object]:
    """Return a pose in plain values."""
    return {"T_cam_body_quat_wxyz": pose.quat_wxyz.tolist(), "T_cam_body_translation_m": pose.translation_m.tolist()}


def listed(matrix: NDArray[np.float64] | None) -> object:
    """Return a matrix as lists."""
    return None if matrix is None else np.asarray(matrix).tolist()


def plain(value: float | str) -> object:
    """Return a number or a text that JSON can hold."""
    return value if isinstance(value, str) else float(value)


def show_of(kind: str) -> Show | None:
    """Look up what a kind of trial shows; None of one that holds numbers alone."""
    module = f"{module_of(kind)}.show"
    return None if find_spec(module) is None else cast("Show", import_module(module).SHOW)

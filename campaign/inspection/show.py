"""Displays of a kind of trial: figures and files of a case, a three-dimensional view of a run, poses for export."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from importlib.util import find_spec
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from boresight.campaign.inspection.recompute import Case, Recomputed
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.runs.execute import opened
from boresight.campaign.store import RunFolder
from boresight.campaign.trial.kind import module_of
from boresight.reports.figures.named import NamedFigure
from boresight.reports.pages.view3d import View3D
from boresight.reports.run.data import RunData
from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.geometry import Camera, Pose


@dataclass(frozen=True, slots=True, eq=False)
class PosedFrame:
    """One image of a trajectory: file name, epoch (s; the trial number for images without), and poses T_cam_world.

    The world frame is the body frame for single images; for sequences it is inertial in a trajectory and the believed
    body frame in a model. ``landmarks`` (n,) are the numbers of the observed landmarks, ``uv_px`` (n, 2) their
    positions.
    """

    name: str
    time_s: float
    true: Pose
    estimated: Pose
    landmarks: IndexArray
    uv_px: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PosedFrames:
    """Frames of one camera in order of time, and estimated positions of landmarks by number, world axes, m."""

    camera: Camera
    frames: Sequence[PosedFrame]
    places_m: dict[int, FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class CaseFigures:
    """Figures of a case, drawn one after the other when they are asked for; their credits, and the notes above them."""

    figures: Iterable[NamedFigure]
    credits: Sequence[str] = ()
    notes: Sequence[str] = field(default=())


@dataclass(frozen=True, slots=True, eq=False)
class CaseFiles:
    """Files for the page of a case: images used by the method, by name, and its estimate."""

    images: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)
    estimate: Mapping[str, object] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class EstimatorRun:
    """One scenario and one estimator (``label``) of a stored run."""

    campaign: ResolvedCampaign
    folder: RunFolder
    run: RunData
    scenario: str
    label: str

    @property
    def title(self) -> str:
        """Title of the page."""
        return f"{self.scenario} / {self.label}"

    def opened(self) -> Any:
        """Open the trials of the scenario with the first data base; their class is that of the kind of trial."""
        return opened(self.campaign, self.scenario, self.folder.path)


@dataclass(frozen=True, slots=True, kw_only=True)
class Show:
    """Displays of a kind of trial; None for those that it lacks.

    ``draw`` draws a recomputed case whose `InspectedTrial` is known, ``kept`` returns the files to write of that trial,
    and ``posed`` its camera poses in body axes. ``trajectory`` returns the trajectory of a stored case without running
    an estimator; None if ``posed`` gives it. ``pooled`` says whether the poses of all trials refer to the same fixed
    body, and form one model. ``look`` collects the three-dimensional view of a run, ``examples`` draws typical trials
    for its report. ``long`` says whether recomputing a case of a campaign takes minutes.
    """

    draw: Callable[[Recomputed], CaseFigures]
    kept: Callable[[Any], CaseFiles]
    look: Callable[[EstimatorRun], View3D] | None = None
    examples: Callable[[ResolvedCampaign, RunFolder], Iterator[NamedFigure]] = lambda campaign, folder: iter(())
    posed: Callable[[Any, Case], PosedFrames] | None = None
    trajectory: Callable[[ResolvedCampaign, RunFolder, Case], Sequence[PosedFrame]] | None = None
    pooled: bool = False
    long: Callable[[ResolvedCampaign], bool] = lambda campaign: False


def plain_pose(pose: Pose) -> dict[str, object]:
    """Return a pose in plain values."""
    return {"T_cam_body_quat_wxyz": pose.quat_wxyz.tolist(), "T_cam_body_translation_m": pose.translation_m.tolist()}


def show_of(kind: str) -> Show | None:
    """Return the displays of a kind of trial; None if it has none."""
    module = f"{module_of(kind)}.show"
    return None if find_spec(module) is None else cast("Show", import_module(module).SHOW)

"""Displays of a kind of trial: figures and files of a case, poses for export, and a three-dimensional view of a run.

The view has a coarse body, landmarks by their rate of recognition, and cameras by outcome.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from importlib.util import find_spec
from typing import Any, cast

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from boresight.campaign.inspection.recompute import Case, Choice, Recomputed, chosen_rows, recompute, worst_cases
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.runs.execute import opened
from boresight.campaign.store import RunFolder
from boresight.campaign.trial.kind import module_of
from boresight.reports.figures.named import NamedFigure
from boresight.reports.pages.view3d import BAD, FAILED, GOOD, CameraSet, PointSet, View3D
from boresight.reports.run.data import RunData
from boresight.reports.schema.records import CONTROLS
from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Pose, TriangleMesh

_FINER = 1.25

MOST_FACES = 40_000
_NEAR = 1.8


@dataclass(frozen=True, slots=True, eq=False)
class PosedFrame:
    """One image of a trajectory: file name, '' of a rendered single image, epoch, s, and poses T_cam_world.

    The world frame is the body frame for single images; for sequences it is inertial in a trajectory and the believed
    body frame in a model. ``landmarks`` (n,) are the numbers of the observed landmarks, ``uv_px`` (n, 2) their
    positions. ``sun_dir_cam`` (3,) is the unit vector to the Sun, and ``covariance`` (6, 6) that of the estimate,
    [rotation_rad, translation_m] in camera axes; None if unknown.
    """

    name: str
    time_s: float
    true: Pose
    estimated: Pose
    landmarks: IndexArray
    uv_px: FloatArray
    sun_dir_cam: FloatArray | None = None
    covariance: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """Motion of a camera in inertial axes about a body's centre.

    Positions (n, 3), and velocities or None if unknown, are at ``times_s`` (n,), which ascend. ``R_cam_inertial``
    (k, 3, 3) are at ``attitude_times_s`` (k,).
    """

    times_s: FloatArray
    positions_m: FloatArray
    velocities_m_s: FloatArray | None
    attitude_times_s: FloatArray
    R_cam_inertial: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PosedFrames:
    """Frames of one camera in order of time, and estimated positions of landmarks by number, world axes, m.

    Pixels of frames are those of the camera's ``pinhole``.
    """

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
    an estimator; None if ``posed`` gives it. ``flights`` returns truth and estimate of an orbit, by these names; none
    if there is no solution. ``pooled`` says whether the poses of all trials refer to the same fixed
    body, and form one model. ``look`` collects the three-dimensional view of a run, ``examples`` draws typical trials
    for its report. ``long`` says whether recomputing a case of a campaign takes minutes.
    """

    draw: Callable[[Recomputed], CaseFigures]
    kept: Callable[[Any], CaseFiles]
    look: Callable[[EstimatorRun], View3D] | None = None
    examples: Callable[[ResolvedCampaign, RunFolder], Iterator[NamedFigure]] = lambda campaign, folder: iter(())
    posed: Callable[[Any, Case], PosedFrames] | None = None
    trajectory: Callable[[ResolvedCampaign, RunFolder, Case], Sequence[PosedFrame]] | None = None
    flights: Callable[[Any], Mapping[str, Flight]] | None = None
    pooled: bool = False
    long: Callable[[ResolvedCampaign], bool] = lambda campaign: False


def show_of(kind: str) -> Show | None:
    """Return the displays of a kind of trial; None if it has none."""
    module = f"{module_of(kind)}.show"
    return None if find_spec(module) is None else cast("Show", import_module(module).SHOW)


def look_of(campaign: ResolvedCampaign, folder: RunFolder, run: RunData, choice: Choice) -> View3D:
    """Collect the view of one scenario and estimator.

    Raise BoresightError if the choice leaves several scenarios or estimators, or the kind of trial has no such view.
    """
    scenario, label = _one(run, choice)
    kind = campaign.spec.experiment
    show = show_of(kind)
    if show is None or show.look is None:
        raise BoresightError(f"{folder.path}: --look: trials of {kind} have no camera to look at: leave it out")
    return show.look(EstimatorRun(campaign, folder, run, scenario, label))


def _one(run: RunData, choice: Choice) -> list[str]:
    """Return one scenario and one estimator: those named, or the only ones apart from `CONTROLS`."""
    rows, chosen = chosen_rows(run.rows, choice, str(run.folder)), []
    for column, left_out in (("scenario", ()), ("estimator", CONTROLS)):
        there = list(dict.fromkeys(rows[column].astype(str)))
        rest = [name for name in there if name not in left_out] or there
        if len(rest) > 1:
            raise BoresightError(f"--look shows one {column}: give --{column}, one of {', '.join(there)}")
        chosen.append(rest[0])
    return chosen


def camera_sets(
    rows: pd.DataFrame, badness: FloatArray, describe: Callable[[float], str], places: Callable[[int], FloatArray]
) -> list[CameraSet]:
    """Group the cameras of trials: good, bad (``badness`` above the median), and without an estimate.

    ``badness`` (n,) is the error measure of each of the rows, one for each trial, and ``describe`` formats it.
    ``places`` returns the camera positions (n, 3) of a trial.
    """
    values = pd.Series(badness, index=rows.index)
    solved = rows["status"] == "ok"
    good = solved & (values <= values[solved].median())
    sets = (("good trials", GOOD, good), ("bad trials", BAD, solved & ~good), ("no estimate", FAILED, ~solved))
    found = []
    for name, colour, which in sets:
        texts, points = [], [np.zeros((0, 3))]
        keys = rows.loc[which, ["trial", "status", "reason"]].itertuples(index=False, name=None)
        for (trial, status, reason), value in zip(keys, values[which], strict=True):
            points.append(np.reshape(places(int(trial)), (-1, 3)))
            text = f"trial {trial}<br>" + (describe(value) if status == "ok" else f"{status}: {reason}")
            texts += [text] * len(points[-1])
        if texts:
            found.append(CameraSet(name, colour, np.concatenate(points), texts))
    return found


def camera_scale(places_m: FloatArray, radius_m: float) -> tuple[float, str]:
    """Return the factor by which cameras (n, 3) are drawn nearer than they are, and a sentence about it.

    At 2 km a body of 300 m would be a dot: cameras at the median range are drawn at 1.8 radii of the body.
    """
    middle = float(np.median(np.linalg.norm(places_m, axis=1))) if len(places_m) else 0.0
    factor = max(middle / (_NEAR * radius_m), 1.0)
    return (factor, f" Cameras are drawn {factor:.2g} times nearer to the body than they are." if factor > 1.0 else "")


def finite_or_dash(value: float, unit: str) -> str:
    """Format a number with its unit, or a dash for NaN."""
    return "-" if np.isnan(value) else f"{value:.3g} {unit}"


def middle_and_worst(scene: EstimatorRun) -> Iterator[tuple[str, str, Recomputed]]:
    """Recompute the median and the worst trial, with names and colours; one trial if they are the same."""
    every = len(scene.run.of(scene.scenario, scene.label))
    ranked, _ = worst_cases(scene.run, every, Choice(scene.scenario, scene.label), None)
    cases = dict.fromkeys([ranked[len(ranked) // 2], ranked[0]])
    for name, colour, case in zip(("middle", "worst"), (GOOD, BAD), cases, strict=False):
        yield name, colour, recompute(scene.campaign, scene.folder, case)


def outcome_marks(places_m: FloatArray, outcomes: pd.DataFrame, words: tuple[str, str, str]) -> PointSet:
    """Colour craters by their share of hits; ``words`` name the share, the chances and the hits."""
    chances, hits = (outcomes[name].to_numpy(dtype=np.float64) for name in ("chances", "hits"))
    share = np.where(chances > 0, 100.0 * hits / np.maximum(chances, 1.0), np.nan)
    texts = [
        f"crater {number}<br>{words[1]}: {c:.0f} times<br>{words[2]}: {h:.0f} ({finite_or_dash(s, '%')})"
        for number, c, h, s in zip(outcomes.index, chances, hits, share, strict=True)
    ]
    return PointSet(words[0], places_m, share, texts, "%")


def crater_look(
    scene: EstimatorRun,
    rows: pd.DataFrame,
    marks: list[PointSet],
    mesh: TriangleMesh,
    trials: tuple[dict[int, FloatArray], str, pd.Series | None],
) -> View3D:
    """Compose the view of craters; ``trials`` are cameras by trial, the name of faults, and their number by row."""
    views, called, faults = trials
    body = coarsened(mesh)
    factor, scale_note = camera_scale(np.concatenate(list(views.values())), body.radius_m)
    badness = np.full(len(rows), np.nan) if faults is None else faults[rows.index].to_numpy(dtype=np.float64)
    middle = float(np.nanmedian(badness)) if np.isfinite(badness).any() else 0.0
    note = f"{len(rows)} trials. Good and bad: at most, or more than, the median of {middle:g} {called}.{scale_note}"
    cameras = camera_sets(rows, badness, lambda value: f"{value:.0f} {called}", lambda trial: views[trial] / factor)
    return View3D(scene.title, note, body.vertices_m, body.faces, marks, cameras)


def places_of(centre_m: FloatArray, numbers: IndexArray, outcomes: pd.DataFrame) -> FloatArray:
    """Return the centres of the craters that index ``outcomes``."""
    return pd.DataFrame(centre_m, index=numbers).loc[outcomes.index].to_numpy(dtype=np.float64)


def coarsened(mesh: TriangleMesh, most_faces: int = MOST_FACES) -> TriangleMesh:
    """Merge the vertices of each cube of a grid into their mean until no more than ``most_faces`` facets are left.

    Degenerate facets are removed. The result is only for display.
    """
    if len(mesh.faces) <= most_faces:
        return mesh
    # A closed surface of area A in cubes of edge a crosses about A / a^2 of them, with two facets for each vertex.
    area_m2 = float(mesh.areas_m2.sum())
    edge_m = float(np.sqrt(2.0 * area_m2 / most_faces))
    while True:
        coarse = _merged(mesh, edge_m)
        if len(coarse.faces) <= most_faces:
            return coarse
        edge_m *= _FINER


def _merged(mesh: TriangleMesh, edge_m: float) -> TriangleMesh:
    cubes = np.floor(mesh.vertices_m / edge_m).astype(np.int64)
    _, which, counts = np.unique(cubes, axis=0, return_inverse=True, return_counts=True)
    which = which.ravel()
    sums = np.stack([np.bincount(which, mesh.vertices_m[:, axis]) for axis in range(3)], axis=1)
    faces = which[mesh.faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return TriangleMesh(sums / counts[:, None], faces[np.sort(first)].astype(np.int32))

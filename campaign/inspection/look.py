"""What is to be seen of a run in space: the body, landmarks by how they are recognised, good and bad cameras."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from campaign.experiments.registry import Bench
from campaign.experiments.sequence import FollowedSequence, SequenceTrials
from campaign.experiments.single_image import SingleImage
from campaign.inspection.case import CONTROLS, Case, Choice, unknown
from campaign.inspection.coarse import coarsened
from campaign.inspection.ranking import worst_cases
from campaign.inspection.recompute import recompute
from campaign.inspection.sequence import last_seen
from campaign.resolve import ResolvedCampaign
from campaign.store import RunFolder
from campaign.worker import experiment_of
from estimators.contract import Estimator
from estimators.landmark.database import LandmarkDatabase
from estimators.landmark.visibility import visible_landmarks
from reports.look import BAD, FAILED, GOOD, TRUE, Cameras, Look, Marks
from reports.run_data import RunData, select
from scenarios.bodies import load_body
from scenarios.bodies.embedded import sphere
from scenarios.errors import BoresightError
from scenarios.geometry import TriangleMesh
from scenarios.sequences import MeshGround

FloatArray = NDArray[np.float64]

_MOST_FACES = 40_000
_NEAR = 1.8
"""Radii of the body at which cameras are drawn that are farther: from 2 km a body of 300 m is a dot."""


def look_of(campaign: ResolvedCampaign, folder: RunFolder, run: RunData, choice: Choice) -> Look:
    """Collect what is to be seen of one scenario and estimator.

    Raises
    ------
    BoresightError
        If several scenarios or estimators are left to choose from, or the kind of trial has no places in space.
    """
    scenario, label = _one(run, choice)
    experiment = experiment_of(campaign, scenario, Bench(folder.path, 1, keep_images=False))
    if isinstance(experiment, SingleImage):
        return _images(experiment, run, scenario, label)
    if isinstance(experiment, SequenceTrials):
        return _sequence(campaign, folder, run, (scenario, label))
    raise BoresightError(f"--look: trials of {experiment.kind} have no poses of a camera to look at")


def _one(run: RunData, choice: Choice) -> tuple[str, str]:
    """Choose the one scenario and estimator: the named one, or the only one that is no control."""
    chosen = []
    for column, wanted, left_out in (("scenario", choice.scenario, ()), ("estimator", choice.estimator, CONTROLS)):
        there = list(dict.fromkeys(run.rows[column].astype(str)))
        rest = [name for name in there if name not in left_out] or there
        if wanted is not None and wanted not in there:
            raise unknown(column, wanted, there, str(run.folder))
        if wanted is None and len(rest) > 1:
            raise BoresightError(f"--look shows one {column}: give --{column}, one of {', '.join(there)}")
        chosen.append(wanted or rest[0])
    return chosen[0], chosen[1]


def _images(experiment: SingleImage, run: RunData, scenario: str, label: str) -> Look:
    rows = select(run.rows, scenario, label)
    views = {int(t): experiment.world.source.view(experiment.seed, int(t)) for t in rows["trial"]}
    places = {trial: view.T_cam_body.camera_position_m for trial, view in views.items()}
    database = _database(experiment.estimators[label])
    marks = []
    if database is not None:
        mesh = database.mesh()
        seen = np.zeros(len(database))
        for view in views.values():
            seen += visible_landmarks(mesh, view.camera, view.T_cam_body)
        marks = landmark_marks(database.means_m, seen, select(run.landmarks, scenario, label))
    body = coarsened(experiment.world.body.mesh, _MOST_FACES)
    middle = float(rows["position_error_m"].median())
    nearer = max(float(np.median(np.linalg.norm(list(places.values()), axis=1))) / (_NEAR * body.radius_m), 1.0)
    drawn = {trial: place / nearer for trial, place in places.items()}
    note = (
        f"{len(rows)} trials. Good and bad: below and above the median error of {middle:.3g} m. Cameras are drawn"
        f" {nearer:.2g} times nearer to the body than they are."
    )
    return Look(f"{scenario} / {label}", note, body.vertices_m, body.faces, marks, camera_sets(rows, drawn))


def _database(estimator: Estimator) -> LandmarkDatabase | None:
    found = getattr(estimator, "database", None)
    return found if isinstance(found, LandmarkDatabase) else None


def landmark_marks(places_m: FloatArray, in_view: FloatArray, recognised: pd.DataFrame) -> list[Marks]:
    """Colour landmarks by how often they are recognised and by how far they then are from what is seen.

    Parameters
    ----------
    places_m
        (N, 3).
    in_view
        (N,) in how many trials each is in view.
    recognised
        Rows of the stored table ``landmarks``.
    """
    numbers = np.arange(len(places_m))
    times = recognised.groupby("landmark").size().reindex(numbers).fillna(0).to_numpy(dtype=np.float64)
    error = recognised.groupby("landmark")["error_m"].median().reindex(numbers).to_numpy(dtype=np.float64)
    # Recognised where the mesh says that it is hidden: the mesh is coarse, and so is the share.
    share = np.where(in_view > 0, 100.0 * np.minimum(times / np.maximum(in_view, 1.0), 1.0), np.nan)
    texts = [
        f"landmark {i}<br>in view in {in_view[i]:.0f} trials, recognised in {times[i]:.0f}"
        f"<br>median error {'-' if np.isnan(error[i]) else f'{error[i]:.3g} m'}"
        for i in numbers
    ]
    return [
        Marks("recognised when in view", places_m, share, texts, "%"),
        Marks("median landmark error", places_m, error, texts, "m"),
    ]


def camera_sets(rows: pd.DataFrame, places: Mapping[int, FloatArray]) -> list[Cameras]:
    """Divide the cameras of trials into good ones, bad ones (above the median error) and those without an estimate."""
    solved = rows["status"] == "ok"
    good = solved & (rows["position_error_m"] <= rows["position_error_m"].median())
    sets = (("good trials", GOOD, good), ("bad trials", BAD, solved & ~good), ("no estimate", FAILED, ~solved))
    found = []
    for name, colour, which in sets:
        own = rows[which]
        texts = [
            f"trial {trial}<br>" + (f"error {error:.3g} m" if status == "ok" else f"{status}: {reason}")
            for trial, status, reason, error in own[["trial", "status", "reason", "position_error_m"]].itertuples(
                index=False, name=None
            )
        ]
        points = np.array([places[int(trial)] for trial in own["trial"]]).reshape(-1, 3)
        if len(points):
            found.append(Cameras(name, colour, points, texts))
    return found


def _sequence(campaign: ResolvedCampaign, folder: RunFolder, run: RunData, of: tuple[str, str]) -> Look:
    """Show the trial in the middle and the worst one, in the axes that the body has at each frame."""
    scenario, label = of
    every = len(select(run.rows, scenario, label))
    ranked, _ = worst_cases(run, every, Choice(scenario, label), None)
    cases = list(dict.fromkeys([ranked[len(ranked) // 2], ranked[0]]))
    marks, cameras, ground = [], [], None
    for name, colour, case in zip(("middle", "worst"), (GOOD, BAD), cases, strict=False):
        again = recompute(campaign, folder, case)
        if not isinstance(again.shown, FollowedSequence) or not isinstance(again.experiment, SequenceTrials):
            continue
        ground = again.experiment.ground
        marks += _track_marks(again.shown, name)
        cameras += _paths(again.shown, case, name, colour)
    if ground is None:
        raise BoresightError(f"{folder.path}: no trial of {scenario} / {label} has a sequence to look at")
    body = coarsened(_mesh_of(campaign, scenario, isinstance(ground, MeshGround), ground.reach_m), _MOST_FACES)
    note = "The trial of median error and the worst one; a landmark stands where it truly is."
    return Look(f"{scenario} / {label}", note, body.vertices_m, body.faces, marks, cameras)


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

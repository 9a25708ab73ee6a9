"""A look at single images: landmarks by how they are recognised, cameras of good and bad trials."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from campaign.inspection.coarse import coarsened
from campaign.inspection.look_parts import MOST_FACES, camera_sets, finite_or_dash, nearer
from campaign.inspection.show import Scene
from campaign.kinds.single_image.trial import SingleImage
from estimators.craters.database.landmarks import Landmarks
from estimators.craters.pose.estimator import CraterPose
from estimators.landmark.database import LandmarkDatabase
from estimators.landmark.visibility import visible_landmarks
from reports.pages.look import Look, Marks
from reports.run.data import select
from scenarios.geometry import View

FloatArray = NDArray[np.float64]


def look_at_images(scene: Scene) -> Look:
    """Show the landmarks of the first data base and the cameras of all its trials."""
    experiment, run = scene.opened(SingleImage), scene.run
    tables = (select(table, scene.scenario, scene.label) for table in (run.rows, run.landmarks))
    rows, recognised = (table[table["trial"] % scene.campaign.spec.databases == 0] for table in tables)
    views = {int(t): experiment.world.source.view(experiment.seed, int(t)) for t in rows["trial"]}
    body = coarsened(experiment.world.body.mesh, MOST_FACES)
    places = {trial: view.T_cam_body.camera_position_m for trial, view in views.items()}
    factor, told = nearer(np.array(list(places.values())), body.radius_m)
    marks = _marks(experiment.estimators[scene.label], list(views.values()), recognised)
    errors = rows["position_error_m"].to_numpy(dtype=np.float64)
    middle = rows["position_error_m"].median()
    note = f"{len(rows)} trials. Good and bad: below and above the median error of {middle:.3g} m.{told}"
    cameras = camera_sets(rows, errors, "error {:.3g} m".format, lambda trial: places[trial] / factor)
    return Look(scene.title, note, body.vertices_m, body.faces, marks, cameras)


def _marks(estimator: object, views: Sequence[View], recognised: pd.DataFrame) -> list[Marks]:
    """Colour the landmarks that an estimator has, or the craters of its data base; others have places of neither."""
    if isinstance(estimator, CraterPose):
        return [crater_marks(estimator.landmarks)]
    database = getattr(estimator, "database", None)
    if not isinstance(database, LandmarkDatabase):
        return []
    mesh, seen = database.mesh(), np.zeros(len(database))
    for view in views:
        seen += visible_landmarks(mesh, view.camera, view.T_cam_body)
    return landmark_marks(database.means_m, seen, recognised)


def crater_marks(craters: Landmarks) -> Marks:
    """Colour the craters of a data base by the images that they were found in, of which it was made."""
    sigma_m = np.sqrt(np.trace(craters.covariance_m2, axis1=1, axis2=2))
    texts = [
        f"crater {number}<br>{2.0 * radius:.3g} m across<br>in {images} images of the data base<br>sigma {sigma:.3g} m"
        for number, radius, images, sigma in zip(craters.number, craters.radius_m, craters.images, sigma_m, strict=True)
    ]
    return Marks("images of the data base", craters.position_body_m, craters.images.astype(float), texts, "")


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
        f"<br>median error {finite_or_dash(error[i], 'm')}"
        for i in numbers
    ]
    return [
        Marks("recognised when in view", places_m, share, texts, "%"),
        Marks("median landmark error", places_m, error, texts, "m"),
    ]

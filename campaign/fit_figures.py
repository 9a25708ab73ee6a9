"""The paper's figure 8 for one trial of a stored run, recomputed from its seed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from campaign.experiments.registry import Bench
from campaign.experiments.single_image import SingleImage
from campaign.resolve import ResolvedCampaign
from campaign.worker import experiment_of
from estimators.landmark.database import LandmarkDatabase
from estimators.landmark.projection import project_landmarks
from estimators.landmark.recognizer import LandmarkRecognizer, Recognition
from estimators.landmark.visibility import visible_landmarks
from reports.content import NamedFigure
from reports.figures import Fit, Overlay, draw_fit_panels
from scenarios.geometry import Camera, Pose, TriangleMesh


def fit_figures(campaign: ResolvedCampaign, run: Path, rows: pd.DataFrame) -> Iterator[NamedFigure]:
    """Draw a typical trial of every scenario and landmark recogniser: the one of median position error."""
    for scenario in campaign.scenarios:
        experiment = experiment_of(campaign, scenario.spec.name, Bench(run, 1, keep_images=False))
        if not isinstance(experiment, SingleImage):
            continue
        for label, estimator in experiment.estimators.items():
            mine = rows[(rows["scenario"] == scenario.spec.name) & (rows["estimator"] == label)]
            trial = median_trial(mine)
            if trial is None or not isinstance(estimator, LandmarkRecognizer):
                continue
            sight = experiment.world.source.sight(campaign.seed, trial)
            observation = experiment.observe(sight, trial)
            frame, camera = observation.frames[0], observation.camera
            found = estimator.recognise(frame, camera)
            fit = _fit(frame.image, found, estimator.database, camera)
            if fit is None:
                continue
            credit = [scenario.spec.images.credit] if scenario.spec.images and scenario.spec.images.credit else []
            yield _named(fit, f"{scenario.spec.name}, {label}, trial {trial} {sight.image_name}".strip(), trial, credit)


def median_trial(rows: pd.DataFrame) -> int | None:
    """Return the solved trial whose position error is the median (the lower one of two); None without any."""
    solved = rows[rows["status"] == "ok"].sort_values(["position_error_m", "trial"])
    return None if solved.empty else int(solved.iloc[(len(solved) - 1) // 2]["trial"])


def _named(fit: Fit, what: str, trial: int, credit: list[str]) -> NamedFigure:
    caption = (
        f"{what}: the trial of median position error. Left, the prior pose: mesh of the data base, 6-sigma search"
        " ellipses and both brightness centroids. Middle, the mesh rendered for the first iteration. Right, the"
        " converged fit with the corners of the image."
    )
    alt = "Three images of the body: with the mesh misplaced, the rendered mesh, and with the mesh in place."
    stem = "fit_" + what.split(",")[0] + f"_{trial}"
    return NamedFigure(stem, draw_fit_panels(fit, what, credit), caption, alt)


def _fit(image: NDArray[np.float32], found: Recognition, database: LandmarkDatabase, camera: Camera) -> Fit | None:
    if not found.alignment.steps or found.corners is None or found.solution is None or found.solution.fit is None:
        return None
    first = found.alignment.steps[0]
    matched = np.zeros(len(found.corners), dtype=np.bool_)
    matched[found.solution.rounds[-1].matches.corner] = True
    return Fit(
        image=image,
        mesh_image=first.rendered,
        before=overlay(database, camera, found.prior),
        after=overlay(database, camera, found.solution.fit.T_cam_body),
        observed_centroid_px=first.observed_px,
        rendered_centroid_px=first.rendered_px,
        corners_px=found.corners.uv_px,
        matched=matched,
    )


def overlay(database: LandmarkDatabase, camera: Camera, T_cam_body: Pose) -> Overlay:
    """Project a data base as it is drawn: visible landmarks with covariances, and the edges that face the camera."""
    mesh = database.mesh()
    projection = project_landmarks(database, camera, T_cam_body)
    visible = visible_landmarks(mesh, camera, T_cam_body)
    return Overlay(
        projection.uv_px[visible], projection.covariances_px2[visible], _facing_edges(mesh, camera, T_cam_body)
    )


def _facing_edges(mesh: TriangleMesh, camera: Camera, T_cam_body: Pose) -> NDArray[np.float64]:
    """Return the ends (m, 2, 2) of the edges of facets that face the camera."""
    to_camera = T_cam_body.camera_position_m - mesh.corners_m[:, 0]
    facing = mesh.faces[np.einsum("fi,fi->f", mesh.normals, to_camera) > 0.0]
    edges = np.unique(np.sort(facing[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    ends: NDArray[np.float64] = camera.project(T_cam_body.transform(mesh.vertices_m))[edges]
    return ends

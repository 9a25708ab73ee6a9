"""The paper's figure 8 for one trial of a stored run, recomputed from its seed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from boresight.campaign.imaging.observe import observe
from boresight.campaign.inspection.case import Case
from boresight.campaign.kinds.single_image.trial import SingleImage
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.runs.blocks import opened
from boresight.campaign.store import RunFolder
from boresight.estimators.landmark.database import LandmarkDatabase
from boresight.estimators.landmark.projection import project_landmarks, visible_landmarks
from boresight.estimators.landmark.recognizer import LandmarkRecognizer, Recognition
from boresight.reports.figures.named import NamedFigure, file_stem
from boresight.reports.figures.recognition import FitPanels, Overlay, draw_fit_panels
from boresight.scenarios.geometry import Camera, Pose, TriangleMesh
from boresight.scenarios.observation import Observation
from boresight.scenarios.spec.scenario import ScenarioSpec


@dataclass(frozen=True, slots=True, eq=False)
class SecondLook:
    """A trial of a landmark recogniser, worked out again from its seed, with the intermediate results.

    ``image_name`` is the file name of a real image, or ''.
    """

    observation: Observation
    image_name: str
    database: LandmarkDatabase
    found: Recognition


def second_look(campaign: ResolvedCampaign, folder: RunFolder, case: Case) -> SecondLook | None:
    """Recognise the landmarks of a case again; None where the estimator is no landmark recogniser."""
    trials: SingleImage = opened(campaign, case.scenario, folder.path, case.trial)
    estimator = trials.methods[case.estimator]
    if not isinstance(estimator, LandmarkRecognizer):
        return None
    trial_image = trials.world.source.trial_image(trials.seed, case.trial)
    observation = observe(trials.world, trial_image, trials.seed, case.trial)
    found = estimator.recognise(observation.frame, observation.camera)
    return SecondLook(observation, trial_image.image_name, estimator.database, found)


def fit_figures(campaign: ResolvedCampaign, folder: RunFolder) -> Iterator[NamedFigure]:
    """Draw a typical trial of every scenario and landmark recogniser: the one of median position error.

    The scenarios of a grid are many and look alike: the first stands for them.
    """
    rows = folder.table("rows")
    for scenario in campaign.scenarios[: None if campaign.spec.grid is None else 1]:
        for label in campaign.labels:
            mine = rows[(rows["scenario"] == scenario.spec.name) & (rows["estimator"] == label)]
            trial = median_trial(mine)
            look = None if trial is None else second_look(campaign, folder, Case(scenario.spec.name, label, trial))
            fit = fit_of(look) if look else None
            if look is None or fit is None or trial is None:
                continue
            what = f"{scenario.spec.name}, {label}, trial {trial} {look.image_name}".strip()
            stem = file_stem("fit", scenario.spec.name, label, str(trial))
            yield NamedFigure(
                stem,
                draw_fit_panels(fit, what, credit_lines(scenario.spec)),
                f"{what}: the trial of median position error. Left, the prior pose: mesh of the data base, 6-sigma"
                " search ellipses and both brightness centroids. Middle, the mesh rendered for the first iteration."
                " Right, the converged fit with the corners of the image.",
                "Three images of the body: with the mesh misplaced, the rendered mesh, and with the mesh in place.",
            )


def credit_lines(spec: ScenarioSpec) -> list[str]:
    """List the credits that figures with a scenario's images must carry."""
    return [spec.images.credit] if spec.images and spec.images.credit else []


def median_trial(rows: pd.DataFrame) -> int | None:
    """Return the solved trial whose position error is the median (the lower one of two); None without any."""
    solved = rows[rows["status"] == "ok"].sort_values(["position_error_m", "trial"])
    return None if solved.empty else int(solved.iloc[(len(solved) - 1) // 2]["trial"])


def fit_of(look: SecondLook) -> FitPanels | None:
    """Collect what the figure of a fit shows; None where the recognition failed before its end."""
    found = look.found
    if not found.alignment.steps or found.corners is None or found.solution is None or found.solution.fit is None:
        return None
    matched = np.zeros(len(found.corners), dtype=np.bool_)
    matched[found.solution.rounds[-1].matches.corner] = True
    return _fit(look, found.solution.fit.T_cam_body, found.corners.uv_px, matched)


def alignment_of(look: SecondLook) -> FitPanels | None:
    """Collect what the figure of an alignment shows; None where there was none."""
    if not look.found.alignment.steps:
        return None
    return _fit(look, look.found.alignment.T_cam_body, np.empty((0, 2)), np.empty(0, dtype=np.bool_))


def _fit(look: SecondLook, after: Pose, corners_px: NDArray[np.float64], matched: NDArray[np.bool_]) -> FitPanels:
    first, camera = look.found.alignment.steps[0], look.observation.camera
    return FitPanels(
        image=look.observation.frame.image,
        mesh_image=first.rendered,
        before=overlay(look.database, camera, look.found.prior),
        after=overlay(look.database, camera, after),
        observed_centroid_px=first.observed_px,
        rendered_centroid_px=first.rendered_px,
        corners_px=corners_px,
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

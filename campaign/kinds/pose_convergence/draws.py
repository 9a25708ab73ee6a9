"""Landmarks drawn from their own distributions: observations without any image (Rowell et al. 2015, section 3.4.4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimators.landmark.database import LandmarkDatabase
from estimators.landmark.matching import inverse_2x2
from estimators.landmark.pose.stack import PoseStack, ProblemStack
from estimators.landmark.projection import image_covariances
from estimators.landmark.visibility import faces_camera, is_occluded
from scenarios.draw import Stream, degrade, draw_view, generator
from scenarios.geometry import Camera, Pose, TriangleMesh, View
from scenarios.spec.scenario import ScenarioSpec

FloatArray = NDArray[np.float64]

LANDMARKS = 10
_TESTED_AT_ONCE = 16


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkDraw:
    """One trial.

    Parameters
    ----------
    view
        The true view.
    prior
        The disturbed pose.
    chosen
        (10,) landmarks, or fewer where fewer can be seen.
    uv_px
        Where they are observed.
    """

    view: View
    prior: Pose
    chosen: NDArray[np.intp]
    uv_px: FloatArray


def draw_landmarks(spec: ScenarioSpec, database: LandmarkDatabase, seed: int, trial: int) -> LandmarkDraw:
    """Draw a view, ten of the landmarks that are visible from it, and a position of each in the image.

    The paper draws ten landmarks of those projected into the image; a camera sees none behind the body, so they are
    drawn from the visible ones.
    """
    camera = spec.camera.camera()
    view = draw_view(spec, camera, generator(seed, Stream.TRUTH, trial))
    truth = view.T_cam_body
    rng = generator(seed, Stream.LANDMARKS, trial)
    chosen = first_visible(database.mesh(), camera, truth, rng.permutation(len(database)))
    points_cam_m = truth.transform(database.means_m[chosen])
    covariances = image_covariances(database.covariances_m2[chosen], points_cam_m, camera, truth)
    error = np.einsum("nij,nj->ni", np.linalg.cholesky(covariances), rng.normal(size=(LANDMARKS, 2))[: len(chosen)])
    prior = degrade(truth, spec.pose_error, camera, generator(seed, Stream.POSE_ERROR, trial))
    return LandmarkDraw(view, prior, chosen, camera.project(points_cam_m) + error)


def first_visible(
    mesh: TriangleMesh, camera: Camera, T_cam_body: Pose, order: NDArray[np.integer], count: int = LANDMARKS
) -> NDArray[np.intp]:
    """Return the first ``count`` vertices, in the given order, that the camera sees; all where they are fewer."""
    position = T_cam_body.camera_position_m
    near_side = camera.contains(camera.project(T_cam_body.transform(mesh.vertices_m))) & faces_camera(mesh, position)
    candidates = np.asarray(order[near_side[order]], dtype=np.intp)
    seen = np.empty(0, dtype=np.intp)
    for start in range(0, len(candidates), _TESTED_AT_ONCE):
        tested = candidates[start : start + _TESTED_AT_ONCE]
        seen = np.concatenate([seen, tested[~is_occluded(mesh, position, tested)]])
        if len(seen) >= count:
            break
    return seen[:count]


def problem_stack(draws: Sequence[LandmarkDraw], database: LandmarkDatabase, camera: Camera) -> ProblemStack:
    """Set the pose problems of trials side by side, weighted with the covariances seen from the disturbed poses."""
    chosen = np.stack([draw.chosen for draw in draws])
    points = database.means_m[chosen]
    covariances = [
        image_covariances(database.covariances_m2[draw.chosen], draw.prior.transform(seen), camera, draw.prior)
        for draw, seen in zip(draws, points, strict=True)
    ]
    information = inverse_2x2(np.concatenate(covariances)).reshape(*chosen.shape, 2, 2)
    return ProblemStack(points, np.stack([draw.uv_px for draw in draws]), information, camera)


def true_poses(draws: Sequence[LandmarkDraw]) -> PoseStack:
    """Stack the true poses."""
    return PoseStack.of([draw.view.T_cam_body for draw in draws])


def prior_poses(draws: Sequence[LandmarkDraw]) -> PoseStack:
    """Stack the disturbed poses."""
    return PoseStack.of([draw.prior for draw in draws])

"""Predict what the landmarks of a planned view tell of its pose, without an image."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from boresight.estimators.landmark.database import LandmarkDatabase
from boresight.estimators.landmark.matching import inverse_2x2
from boresight.estimators.landmark.pose.problem import MIN_LANDMARKS, PoseProblem
from boresight.estimators.landmark.projection import image_covariances, visible_landmarks
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.observation import Observation

_VISIBLE_SHARE = 0.5  # of views from all directions that show a point of a convex body


def planned_problem(
    database: LandmarkDatabase,
    planned: Observation,
    scale: float = 1.0,
    corner_px: float = 0.0,
    retained: Callable[[FloatArray, FloatArray], FloatArray] | None = None,
) -> PoseProblem | None:
    """Set up the expected pose problem of the landmarks that are visible from the planned pose, all recognised rightly.

    Each is at its predicted place, with the covariance of the data base times ``scale`` and of corners that are off by
    ``corner_px``. Its information is multiplied by the share of images that show its corner, see `recognised_shares`,
    and by ``retained``, of places (N, 2) and their covariances (N, 2, 2): the share (N,) that is left in an estimator.
    The result is None if fewer than four are expected to be recognised.
    """
    pose, camera = planned.frame.prior_T_cam_body, planned.camera
    seen = np.flatnonzero(visible_landmarks(database.mesh(), camera, pose))
    shares = recognised_shares(database)[seen]
    if shares.sum() < MIN_LANDMARKS:
        return None
    points_m = database.means_m[seen]
    points_cam_m = pose.transform(points_m)
    covariances = scale * image_covariances(database.covariances_m2[seen], points_cam_m, camera, pose)
    covariances += corner_px**2 * np.eye(2)
    uv_px = camera.project(points_cam_m)
    counted = shares if retained is None else shares * retained(uv_px, covariances)
    return PoseProblem(points_m, uv_px, counted[:, None, None] * inverse_2x2(covariances), camera)


def recognised_shares(database: LandmarkDatabase) -> FloatArray:
    """(N,) share of the images in which each landmark is visible that show its corner, estimated from the data base.

    It is the share of the data base's images in which it was seen, over the half of them in which a point of a convex
    body is visible. It is 1 where the provenance lacks the number of images: all visible landmarks are the most that
    can be recognised.
    """
    images = database.provenance.get("images")
    if not isinstance(images, int) or images < 1:
        return np.ones(len(database))
    return np.minimum(database.n_observations / (_VISIBLE_SHARE * images), 1.0)

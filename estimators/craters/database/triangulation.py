"""Positions of landmarks from all lines of sight to them, where the poses of the pictures are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimators.craters.database.files import CraterDatabase
from estimators.craters.database.landmarks import Landmarks
from estimators.craters.matching.association import AssociationOptions, centre_noise

FloatArray = NDArray[np.float64]


def triangulated(database: CraterDatabase, height_sigma_m: float, options: AssociationOptions) -> CraterDatabase:
    """Move each landmark to where its lines of sight meet best, with the shape's height as a prior.

    The normal equations of the points x: sum over pictures of (I - d d^T) / s^2 (x - c) = 0, where a line leaves the
    camera at c along d and s is the error of the rim's centre on the ground, and n n^T / h^2 (x - x0) for the a priori
    location x0 on the shape, known to h along the normal n.
    """
    landmarks = database.landmarks
    normal = landmarks.normal_body
    total = np.einsum("ni,nj->nij", normal, normal) / height_sigma_m**2
    weighted = np.einsum("nij,nj->ni", total, landmarks.position_body_m)
    for picture in database.pictures:
        rows = np.searchsorted(landmarks.number, picture.landmark)
        pose = picture.T_cam_body
        sight = pose.inverse().rotate(picture.camera.unproject(picture.ellipses.centre_px))
        ranges = np.linalg.norm(landmarks.position_body_m[rows] - pose.camera_position_m, axis=1)
        variance_px2 = centre_noise(picture.ellipses, options)[:, 0, 0]
        variance_m2 = variance_px2 * (ranges * picture.camera.pixel_angle_rad) ** 2
        across = (np.eye(3) - np.einsum("ni,nj->nij", sight, sight)) / variance_m2[:, None, None]
        np.add.at(total, rows, across)
        np.add.at(weighted, rows, across @ pose.camera_position_m)
    covariance = np.linalg.inv(total)
    moved: Landmarks = replace(
        landmarks,
        position_body_m=np.einsum("nij,nj->ni", covariance, weighted),
        covariance_m2=np.asarray(0.5 * (covariance + np.swapaxes(covariance, 1, 2)), dtype=np.float64),
    )
    return CraterDatabase(database.pictures, moved)

"""What two prior poses tell of a crater's place in the second image without the shape."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimators.craters.contract import CraterImage
from scenarios.geometry import cross_matrix

FloatArray = NDArray[np.float64]

_NO_BASELINE = 1e-6


def epipolar_offsets(first: CraterImage, second: CraterImage) -> FloatArray:
    """(n, m) px from each rim's centre in the second image to the epipolar line of each in the first.

    Two images from one place have no epipolar lines: then the place itself is predicted by the attitudes.
    """
    one, other = first.frame.prior_T_cam_body, second.frame.prior_T_cam_body
    rotation = other.rotation @ one.rotation.T
    baseline = other.translation_m - rotation @ one.translation_m
    here = _homogeneous(first.detections.ellipses.centre_px) @ np.linalg.inv(first.camera.matrix).T @ rotation.T
    there = _homogeneous(second.detections.ellipses.centre_px)
    length = float(np.linalg.norm(baseline))
    if length <= _NO_BASELINE * float(np.linalg.norm(other.translation_m)):
        places = here @ second.camera.matrix.T
        return np.asarray(np.linalg.norm((places[:, :2] / places[:, 2:])[:, None] - there[None, :, :2], axis=2))
    lines = here @ cross_matrix(baseline / length).T @ np.linalg.inv(second.camera.matrix)
    return np.asarray(np.abs(lines @ there.T) / np.linalg.norm(lines[:, :2], axis=1, keepdims=True))


def size_ratios(first: CraterImage, second: CraterImage) -> FloatArray:
    """(n, m) ratio of the sizes s'/s, as if both cameras were as far from the body's origin and had one focal length.

    The size is the longer semi-axis: foreshortening leaves it as it is.
    """
    sizes = [
        image.detections.ellipses.semi_axes_px[:, 0]
        * image.camera.pixel_angle_rad
        * float(np.linalg.norm(image.frame.prior_T_cam_body.translation_m))
        for image in (first, second)
    ]
    return np.asarray(sizes[1][None] / sizes[0][:, None])


def _homogeneous(uv_px: FloatArray) -> FloatArray:
    return np.column_stack([uv_px, np.ones(len(uv_px))])

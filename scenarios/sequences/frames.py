"""The frames of Delpech et al. (2015), section 3.1, out of ours.

Everything is worked out in the body frame R_A and in camera axes of our own (x right, y down, z along the boresight);
these conversions stand at the border, where results are stored or compared. The inertial frame ACRF has its origin at
the body's centre of mass, R_0 the same axes and its origin at the first camera position.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

R_PAPER_CAMERA: FloatArray = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""``x_C = R_PAPER_CAMERA x_cam``: the paper's R_C, z along the boresight, x along the sensor's vertical and y along its
horizontal. It does not say which way; x down the columns of the image makes y point left."""


def inertial_from_body(points_m: FloatArray, R_body_inertial: FloatArray) -> FloatArray:
    """Turn points (..., 3) of the body frame R_A into ACRF; ``R_body_inertial`` is (..., 3, 3), m."""
    return np.asarray(np.einsum("...ji,...j->...i", R_body_inertial, points_m), dtype=np.float64)


def first_camera_from_inertial(points_m: FloatArray, first_camera_m: FloatArray) -> FloatArray:
    """Shift points (..., 3) of ACRF to R_0, whose origin is the first camera position (3,) in ACRF, m."""
    return np.asarray(points_m - first_camera_m, dtype=np.float64)

"""Lambert images of a shape without the renderer of the package: OpenCV's projection and the painter's algorithm."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from boresight.scenarios.geometry import View


def painted(vertices_m: NDArray[np.float64], faces: NDArray[np.int64], view: View) -> NDArray[np.float32]:
    """Return a Lambert image (H, W) by the painter's algorithm and OpenCV's projection and polygons."""
    rotation, _ = cv2.Rodrigues(view.T_cam_body.rotation)
    uv, _ = cv2.projectPoints(vertices_m, rotation, view.T_cam_body.translation_m, view.camera.matrix, None)
    corners = np.round((uv[faces, 0] - 0.5) * 256).astype(np.int32)
    normals = np.cross(
        vertices_m[faces[:, 1]] - vertices_m[faces[:, 0]], vertices_m[faces[:, 2]] - vertices_m[faces[:, 0]]
    )
    cosines = np.clip(normals @ view.sun_dir_body / np.linalg.norm(normals, axis=1), 0, None)
    depth = view.T_cam_body.transform(vertices_m)[faces].mean(axis=1)[:, 2]
    image = np.zeros((view.camera.height_px, view.camera.width_px), np.float32)
    for face in np.argsort(-depth):
        cv2.fillConvexPoly(image, corners[face], float(cosines[face]), shift=8)
    return image


def correlation(first: NDArray[np.generic], second: NDArray[np.generic]) -> float:
    """Return the correlation coefficient of two images."""
    return float(np.corrcoef(first.ravel(), second.ravel())[0, 1])

"""Recognition coupled back to the rendered mesh: whether a pose explains where the image's light is (section 6)."""

from __future__ import annotations

import numpy as np

from estimators.landmark.centroid import Image, MeshView, brightness_centroid
from estimators.landmark.signal import KNOWN_SKY, extract_signal
from scenarios.geometry import Pose


def centroid_residual_px(observed: Image, T_cam_body: Pose, view: MeshView) -> float | None:
    """Distance between the brightness centroids of the image and of the mesh rendered at a pose.

    Parameters
    ----------
    observed
        (H, W) signal of the image, background 0, not black.
    T_cam_body
        The pose to judge.
    view
        Camera, renderer and Sun.

    Returns
    -------
    None where the mesh is out of view or in the dark at that pose.
    """
    signal = extract_signal(view.render(T_cam_body), KNOWN_SKY)
    if signal.empty:
        return None
    return float(np.linalg.norm(brightness_centroid(observed) - brightness_centroid(signal.image)))


def image_correlation(observed: Image, T_cam_body: Pose, view: MeshView) -> float:
    """Correlation of the image with a shape rendered at a pose, over all pixels; -1 where nothing is to be seen of it.

    Both are signals with a background of 0, so that it tells of the outline and of light and shade at once. It needs
    no threshold where two poses are compared: neither was chosen by it.
    """
    rendered = extract_signal(view.render(T_cam_body), KNOWN_SKY)
    if rendered.empty:
        return -1.0
    one, other = (image.ravel() - image.mean(dtype=np.float64) for image in (observed, rendered.image))
    scale = float(np.linalg.norm(one) * np.linalg.norm(other))
    return float(one @ other) / scale if scale > 0.0 else 0.0


def consistency_failure(residual_px: float | None, limit_px: float | None) -> str:
    """Say why a solution is not to be believed; empty where it is, or where no limit is set."""
    if limit_px is None or (residual_px is not None and residual_px <= limit_px):
        return ""
    if residual_px is None:
        return "the mesh rendered at the solution is out of view or in the dark"
    return (
        f"the brightness centroid of the mesh at the solution is {residual_px:.3g} px from the image's:"
        f" more than consistency_max_px {limit_px:g}"
    )

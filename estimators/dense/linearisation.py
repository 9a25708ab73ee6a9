"""The rendered image of a shape as a linear function of the pose."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from estimators.contract import DifferentiableRenderer, ImageRenderer
from estimators.landmark.centroid import MeshView
from scenarios.errors import BoresightError
from scenarios.geometry import Pose

FloatArray = NDArray[np.float64]
Image = NDArray[np.float32]
Gradient = Literal["autodiff", "differences"]


def available_gradient(wanted: Gradient | None, renderer: ImageRenderer) -> Gradient:
    """Choose how images are differentiated: as is wanted, or else through the renderer where that is possible.

    Raises
    ------
    BoresightError
        If the renderer has no derivatives that were asked for.
    """
    able = isinstance(renderer, DifferentiableRenderer) and renderer.differentiable
    if wanted == "autodiff" and not able:
        raise BoresightError(
            "gradient: autodiff: the Mitsuba variant in use gives no derivatives: leave the key out, or see"
            " `boresight doctor`"
        )
    return wanted or ("autodiff" if able else "differences")


def parameter_steps(pose: Pose, pixel_rad: float, size_m: float, motion_px: float) -> FloatArray:
    """Return steps (6,) of the parameters that each move the body's edge in the image by about ``motion_px``."""
    range_m = float(np.linalg.norm(pose.translation_m))
    across_m = motion_px * pixel_rad * range_m
    turn_rad = across_m / size_m
    return np.array([turn_rad, turn_rad, turn_rad, across_m, across_m, across_m * range_m / size_m])


def linearised(view: MeshView, pose: Pose, gradient: Gradient, steps: FloatArray) -> tuple[Image, Image]:
    """Render (H, W), and differentiate by [rotation_rad, translation_m] of ``Pose.perturbed``, (6, H, W).

    Parameters
    ----------
    view
        How the shape is seen; the Sun stands still in the camera.
    pose
        Where.
    gradient
        See `available_gradient`.
    steps
        (6,) for differences.
    """
    renderer = view.renderer
    if gradient == "autodiff" and isinstance(renderer, DifferentiableRenderer):
        return renderer.render_with_derivatives(view.at(pose))
    return view.render(pose), np.stack([_difference(view, pose, steps, axis) for axis in range(len(steps))])


def _difference(view: MeshView, pose: Pose, steps: FloatArray, axis: int) -> Image:
    """Central difference: it holds for silhouettes, cast shadows and facets alike.

    One-sided differences would share the sampling noise of the image in the middle with the residual that they are
    multiplied with, and pull every parameter to one side.
    """
    step = np.zeros(6)
    step[axis] = steps[axis]
    ahead, behind = view.render(pose.perturbed(step[:3], step[3:])), view.render(pose.perturbed(-step[:3], -step[3:]))
    return np.asarray((ahead - behind) / np.float32(2.0 * steps[axis]), dtype=np.float32)

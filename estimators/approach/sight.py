"""The line of sight to a body, from a rendering of it that is shifted onto the image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial.hermite_e import hermegauss
from pydantic import Field

from boresight.estimators.approach.body import RENDERED_PX, BodyView, LitBody, Patch, near
from boresight.estimators.approach.fusion import fuse, grouped_covariance
from boresight.estimators.contract import Estimate, ImageRenderer, Stage, Stopwatch
from boresight.estimators.dense.gauss_newton import reduced_camera
from boresight.estimators.landmark.alignment import AlignmentOptions, translation_update
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import Pose, TriangleMesh
from boresight.scenarios.observation import Observation
from boresight.scenarios.spec.base import SpecModel

_CELLS, _ARCS = 4, 6
_DERIVATIVE_PX = 100.0
_LEAST_STEP = 0.03  # of a turn, rad, and of the range, for a derivative: aliasing of renderings is small next to it
_NODES, _WEIGHTS = hermegauss(6)
_OWN_SAMPLING = 0.1
"""Share of the variance of a sampling error that image and rendering at the same place do not have in common."""


class SightOptions(SpecModel):
    """Options of methods that measure the line of sight."""

    alignment_loop: AlignmentOptions = Field(
        AlignmentOptions(tolerance_px=0.1), description="Done when the rendering is shifted by less than the tolerance"
    )
    blur_px: float = Field(0.5, ge=0, le=20, description="Point spread function with which the rendering is blurred")


Shift = Callable[[Patch, Patch], FloatArray]
"""(observed, rendered) -> (2,) shift, px, that takes the rendering onto the observed body."""
Weights = Callable[[FloatArray, FloatArray], FloatArray]
"""(observed, rendered), both (h, w) and equally bright -> (2, h, w) derivatives of the shift by the observed pixels."""


@dataclass(frozen=True, slots=True)
class Sighting:
    """A way to measure the shift of a rendering: its name, which is the stage's, the shift and its derivatives.

    ``misfit_m`` is the RMS distance of the rendered surface from the onboard shape. Of an ellipsoid it has no waves
    below the third degree. So the outline is moved along its radii by that distance, independently in six arcs.
    ``any_direction`` says that what the derivatives by the pose leave is taken as large in every direction.
    """

    name: str
    shift: Shift
    weights: Weights
    misfit_m: float = 0.0
    any_direction: bool = False


def estimate_sight(
    observation: Observation, view: BodyView, how: Sighting, loop: AlignmentOptions, other: BodyView | None = None
) -> Estimate:
    """Shift the prior across the line of sight until rendering and image coincide, and fuse it with the prior.

    The range and the attitude are those of the prior. What their errors do to the shift is found by renderings that
    differ by such errors, see `_by_pose` and `fuse`. With ``other``, which renders the body by another law of
    reflectance, the light is shared between both as in the image, see `_of_two_laws`.

    The covariance of the shift is that of a linear function of the pixels' errors. These are the difference of image
    and rendering, which errors of shape, reflectance and noise make; they are correlated within the 16 cells of the
    body's box and not between them, see `grouped_covariance`. The noise of the sky and the calibration of the camera
    are added.
    """
    frame, camera, clock = observation.frame, observation.camera, Stopwatch()
    prior = frame.prior_T_cam_body
    with clock(how.name):
        body = view.find_body(frame)
    if isinstance(body, str):
        return Estimate("failed", body, timings_s=clock.seconds)
    told: dict[str, float | int | str] = {
        "extent_px": body.extent_px, "diameter_px": float(np.sqrt(4.0 / np.pi * np.count_nonzero(body.lit))),
    }  # fmt: skip
    if body.cut:
        return Estimate("failed", "the frame cuts the body", diagnostics=told, timings_s=clock.seconds)
    pose, count, shift_px = prior, 0, np.full(2, np.inf)
    while count < loop.max_iterations and np.linalg.norm(shift_px) >= loop.tolerance_px:
        with clock("mesh_rendering"):
            found = _bright_part(view.render(pose), body)
            second = None if other is None else _bright_part(other.render(pose), body)
        if found is None:
            failure = "the rendered body is out of view or in the dark"
            return Estimate("failed", failure, diagnostics=told, timings_s=clock.seconds)
        one_law = rendered = found
        with clock(how.name):
            if second is not None:
                rendered, told["other_law"] = _of_two_laws(one_law, second, body, camera.project(pose.translation_m))
            shift_px, point_px = how.shift(body.patch, rendered), centroid_px(rendered)
        if count == 0:
            names = (f"{how.name}_{part}_px" for part in ("du", "dv", "offset"))
            told |= dict(zip(names, (*shift_px.tolist(), float(np.linalg.norm(shift_px))), strict=True))
        last, pose = pose, translation_update(pose, point_px + shift_px, point_px, camera)
        count += 1
    with clock(how.name):
        if not (body.patch.cut(rendered) * rendered.image).sum() > 0.0:
            failure = f"the rendering does not meet the body in max_iterations {loop.max_iterations}"
            return Estimate("failed", failure, diagnostics=told, timings_s=clock.seconds)
        misfit_px = how.misfit_m / (float(np.linalg.norm(last.translation_m)) * camera.pixel_angle_rad)
        origin_px = camera.project(last.translation_m)
        covariance_px2, correlation = _shift_covariance(body, rendered, how.weights, origin_px, misfit_px)
        told |= {f"{how.name}_iterations": count, "correlation": correlation}
    with clock("mesh_rendering"):
        if view.diameter_px(last) < RENDERED_PX:
            covariance_px2 += _sampling(view, last, one_law, body, how, float(np.linalg.norm(shift_px)))
        by_pose, left_px2 = _by_pose(view, last, body, how, frame.prior_covariance)
    # Each error of the pose is tried alone. The largest errors of the shift are across what that leaves.
    covariance_px2 += np.trace(left_px2) * np.eye(2) if how.any_direction else left_px2
    covariance_px2 += _calibration(observation, pose)
    told["shift_sigma_px"] = float(np.sqrt(0.5 * np.trace(covariance_px2)))
    measured = by_pose[:, 3:] @ (pose.translation_m - prior.translation_m)
    fused = fuse(observation, measured, by_pose, covariance_px2)
    return replace(fused, stages=(Stage(how.name, fused.pose or prior),), diagnostics=told, timings_s=clock.seconds)


class SightEstimator:
    """Base of estimators that shift a rendering of a body: what is rendered, how the shift is measured, the options.

    ``renderer`` draws what is within ``radius_m`` of the body's origin, ``other`` the same by another law of
    reflectance; ``mesh`` is the onboard shape.
    """

    def __init__(
        self,
        renderer: ImageRenderer,
        mesh: TriangleMesh,
        radius_m: float,
        options: SightOptions,
        how: Sighting,
        other: ImageRenderer | None = None,
    ) -> None:
        self._body, self._options, self._how = (renderer, radius_m, mesh.area_vectors_m2), options, how
        self._other = other

    def estimate(self, observation: Observation, *, rng: np.random.Generator) -> Estimate:
        """Estimate the pose by shifting the prior; ``rng`` is not used.

        Diagnostics are, with the stage's name in place of NAME, ``NAME_du_px``, ``NAME_dv_px`` and their length
        ``NAME_offset_px`` (observed minus rendered, both at the prior pose), ``NAME_iterations``, ``extent_px`` (longer
        side of the observed body's bounding box), ``diameter_px`` (of the disc with the observed body's area),
        ``correlation`` of image and rendering, ``shift_sigma_px``, and, where the law of reflectance is fitted,
        ``other_law``, its share.
        """
        del rng
        options, frame = self._options, observation.frame
        view = BodyView(*self._body, observation.camera, frame.sun_dir_cam, options.blur_px)
        other = None if self._other is None else replace(view, renderer=self._other)
        return estimate_sight(observation, view, self._how, options.alignment_loop, other)


def _calibration(observation: Observation, pose: Pose) -> FloatArray:
    """Covariance (2, 2), px^2, of where a body at a pose is seen, by the declared errors of the calibration.

    The range is the prior's, so an error of the focal length shifts the body along its distance from the principal
    point.
    """
    camera, sigma = observation.camera, observation.camera_sigma
    apart_px = camera.project(pose.translation_m) - [camera.cx_px, camera.cy_px]
    return sigma.principal_point_px**2 * np.eye(2) + sigma.focal**2 * np.outer(apart_px, apart_px)


def centroid_px(patch: Patch) -> FloatArray:
    """Centre of brightness (2,), px of the image, of a patch whose background is 0."""
    columns, rows = patch.centres()
    moments = np.array([(patch.image * columns).sum(), (patch.image * rows).sum()])
    return np.asarray(moments / patch.image.sum())  # eq. (12)


def _bright_part(rendered: Patch | None, body: LitBody, reduction: int = 1) -> Patch | None:
    """Return a rendering as bright as the body, with 0 where it is darker than the body's floor, as in the image."""
    if rendered is None:
        return None
    image = rendered.image * (body.patch.image.sum() / (rendered.image.sum() * reduction**2))
    image = near(image, image > body.floor)
    return replace(rendered, image=image) if image.any() else None


def _of_two_laws(first: Patch, second: Patch, body: LitBody, origin_px: FloatArray) -> tuple[Patch, float]:
    """Return the light of two renderings in the shares that fit the image best, and the share of the second, 0 to 1.

    What a shift and another range do to the image is fitted with them. Lambert's law and that of Lommel and Seeliger
    together are the lunar-Lambert law of McEwen (1991), Icarus 92, 298, whose share is not known beforehand here.
    """
    mean = 0.5 * (first.image + second.image)
    u, v = (centre - origin for centre, origin in zip(first.centres(), origin_px, strict=True))
    by_u, by_v = np.gradient(mean, axis=1), np.gradient(mean, axis=0)
    terms = np.stack([first.image, second.image, u * by_u + v * by_v, by_u, by_v]).reshape(5, -1)
    one, two = np.linalg.lstsq(terms.T, body.patch.cut(first).ravel(), rcond=None)[0][:2]
    share = float(np.clip(two / (one + two), 0.0, 1.0)) if one + two > 0.0 else 0.0
    return replace(first, image=(1.0 - share) * first.image + share * second.image), share


def _shift_covariance(
    body: LitBody, rendered: Patch, weights: Weights, origin_px: FloatArray, misfit_px: float
) -> tuple[FloatArray, float]:
    """Return the covariance (2, 2) of the shift, px^2, and the correlation coefficient of image and rendering.

    The part of the difference that the range's error makes, which scales the body about its origin, is fitted and left
    out: what it does to the shift is in the derivatives by the pose.
    """
    observed, model = body.patch.cut(rendered), rendered.image
    u, v = (centre - origin for centre, origin in zip(rendered.centres(), origin_px, strict=True))
    scaled = u * np.gradient(model, axis=1) + v * np.gradient(model, axis=0)
    terms = np.column_stack([model.ravel(), scaled.ravel()])
    fitted = np.linalg.lstsq(terms, observed.ravel(), rcond=None)[0]
    left = observed.ravel() - terms @ fitted
    model = model * fitted[0]
    weight = weights(observed, model).reshape(2, -1)
    rows, columns = np.nonzero(model)
    extent = max(np.ptp(rows), np.ptp(columns)) + 1
    row, column = (np.arange(side) * _CELLS // extent for side in model.shape)
    cell = (row[:, None] * model.size + column).ravel()
    covariance = grouped_covariance((weight * left).T, cell, 4)
    covariance += body.noise**2 * weight @ weight.T
    if misfit_px > 0.0:
        radial = fitted[0] * scaled / np.maximum(np.hypot(u, v), 1.0)
        arc = np.floor(np.arctan2(v, u) * (_ARCS / (2.0 * np.pi))).ravel()
        covariance += misfit_px**2 * grouped_covariance((weight * radial.ravel()).T, arc, 0)
    return covariance, float(np.corrcoef(observed.ravel(), model.ravel())[0, 1])


def _sampling(view: BodyView, pose: Pose, rendered: Patch, body: LitBody, how: Sighting, left_px: float) -> FloatArray:
    """Covariance (2, 2), px^2, of a shift's error by the places in their pixels that a small body falls on.

    If a place x is seen at x + A sin(2 pi x + b), renderings that are moved by a quarter of a pixel to either side are
    measured with errors whose mean square is A^2 for any b: the variance for image and rendering at independent places.
    They are ``left_px`` apart when the iteration ends, and have a share 1 - cos(2 pi left_px) of it, at least what they
    do not have in common. A crescent that is thinner than a pixel looks the same wherever it is in the pixel, until it
    jumps to the next: with 2 pi A at 1 places are no longer told apart. So the share is at least (2 pi A)^2, up to 1.
    """
    found, point_px = np.zeros((2, 2)), view.camera.project(pose.translation_m)
    for step_px in 0.25 * np.vstack([np.eye(2), -np.eye(2)]):
        there = translation_update(pose, point_px + step_px, point_px, view.camera)
        if (moved := _bright_part(view.render(there), body)) is not None:
            error_px = how.shift(moved, rendered) - step_px
            found += 0.5 * np.outer(error_px, error_px)
    steepest = (2.0 * np.pi) ** 2 * float(np.linalg.eigvalsh(found)[-1])
    apart = 1.0 - float(np.cos(2.0 * np.pi * min(left_px, 0.5)))
    return found * min(max(apart, steepest, _OWN_SAMPLING), 1.0)


def _by_pose(
    view: BodyView, pose: Pose, body: LitBody, how: Sighting, covariance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the derivative (2, 6) of the measured pixel by [rotation_rad, translation_m], and what it leaves (2, 2).

    Across the line of sight it is that of the body's origin. Along it, and by the attitude, it is the regression of the
    shift between renderings on errors as the prior has them, at the nodes of Gauss and Hermite: the greatest
    correlation is not linear in the size of a body that is lit from aside. What the line leaves is a covariance of the
    shift, px^2. Both are 0 about axes without an error. Renderings have as few pixels as derivatives need.
    """
    sight = pose.translation_m / np.linalg.norm(pose.translation_m)
    across = view.camera.jacobian(pose.translation_m) @ (np.eye(3) - np.outer(sight, sight))
    found, along = np.hstack([np.zeros((2, 3)), across]), np.concatenate([np.zeros(3), sight])
    left = np.zeros((2, 2))
    reduction = max(1, int(view.diameter_px(pose) / _DERIVATIVE_PX))
    small = replace(view, camera=reduced_camera(view.camera, reduction))
    rendered = _bright_part(small.render(pose), body, reduction)
    for direction in (*np.eye(6)[:3], along):
        sigma = float(np.sqrt(direction @ covariance @ direction))
        if not sigma > 0.0 or rendered is None:
            continue
        scale = max(sigma, _LEAST_STEP * (float(np.linalg.norm(pose.translation_m)) if direction is along else 1.0))
        steps, shifts_px, weights = [], [], []
        for node, weight in zip(_NODES, _WEIGHTS, strict=True):
            step = float(node * scale)
            moved = _bright_part(
                small.render(pose.perturbed(step * direction[:3], step * direction[3:])), body, reduction
            )
            if moved is not None:
                steps.append(step)
                shifts_px.append(reduction * how.shift(moved, rendered))
                weights.append(weight)
        if steps:
            x, y, w = np.array(steps), np.array(shifts_px), np.array(weights) / np.sum(weights)
            slope = (w * x) @ y / (w @ x**2)
            rest = y - np.outer(x, slope)
            found += np.outer(slope, direction)
            left += (sigma / scale) ** 2 * (w[:, None] * rest).T @ rest
    return found, left

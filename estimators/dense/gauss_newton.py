"""Register a rendered shape with an image: a shift, then all six parameters by Gauss-Newton from coarse to fine."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from boresight.estimators.contract import DifferentiableRenderer, ImageRenderer, Stopwatch
from boresight.estimators.landmark.alignment import (
    Alignment,
    AlignmentOptions,
    MeshView,
    align_translation,
    correlation_pair,
    is_cut,
)
from boresight.estimators.landmark.pose.posterior import PosePrior
from boresight.estimators.prior import floor_variances
from boresight.scenarios.arrays import MAD_TO_SIGMA, FloatArray, Image
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Pose
from boresight.scenarios.observation import Frame
from boresight.scenarios.spec.base import SpecModel

_REWEIGHTINGS = 3
_DARK = 1e-3
_MARGIN_PX = 5
# Without a limb around it a body is drawn by the law of reflectance, which is wrong, to where its mean brightness fits.
_CUT_BACKGROUND_PX = 6.0
# Shifts against which a correlation is judged, px: beyond the blur of one pixel into the next.
_APART_PX, _REACH_PX = 8, 64
# A detector is full where so many of the lit pixels lie so near to the brightest, and so many times more than below.
_FULL_SHARE, _FULL_LEVEL, _FULL_TIMES = 0.05, 0.97, 3.0
_UNSATURATED, _UNSATURATED_PX = 0.9, 100
# Derivatives are recomputed after the body has moved farther than this, in pixels of the level.
_STALE_PX = 0.5

Gradient = Literal["autodiff", "differences"]

STAGE = "registration"


class LevelOptions(SpecModel):
    """Options of one level of the pyramid."""

    reduction: Literal[1, 2, 4, 8, 16] = Field(1, description="Side of the square of pixels that are averaged into one")
    blur_px: float = Field(1.0, ge=0, le=20, description="Blur of both images, in pixels of this level")
    background_px: float | None = Field(
        None,
        ge=0,
        le=100,
        description="Blur of the subtracted background, in pixels of this level; 0: none is subtracted; default: none,"
        " or 6 where the frame cuts the body",
    )
    iterations: int = Field(40, ge=1, le=200, description="Steps at most")


class RegistrationOptions(SpecModel):
    """Options of the registration of a rendered shape with the image."""

    alignment_loop: AlignmentOptions = AlignmentOptions()
    levels: tuple[LevelOptions, ...] = Field(
        (
            LevelOptions(reduction=4, blur_px=1.0),
            LevelOptions(reduction=2, blur_px=0.7, background_px=3.0),
            LevelOptions(reduction=1, blur_px=1.0, background_px=4.0),
        ),
        min_length=1,
    )
    gradient: Gradient | None = Field(
        None,
        description="Derivatives by the renderer, or by differences of twelve renderings; default: by the renderer if"
        " the Mitsuba variant supports it",
    )
    difference_px: float = Field(
        0.5, gt=0, le=10, description="Step of the differences, as motion in pixels of the level"
    )
    huber_sigma: float = Field(1.5, gt=0, description="Residuals beyond this many robust sigmas count linearly")
    independent_px: float = Field(
        100.0,
        gt=0,
        description="Pixels that count as one independent residual, as errors of the shape are correlated",
    )
    tolerance_sigma: float = Field(
        0.1, gt=0, description="A level ends when a step is shorter than this, in standard deviations of its pose"
    )
    correlation_min: float = Field(
        0.5, ge=-1, le=1, description="A worse final correlation is a failure, unless the frame cuts the body"
    )
    sharpness_min: float = Field(
        3.5,
        ge=0,
        description="Where the frame cuts the body: the final correlation over the largest one of the images shifted by"
        " 8 to 64 pixels; less is a failure, unless the correlation is correlation_sure",
    )
    correlation_sure: float = Field(
        0.7, ge=-1, le=1, description="Where the frame cuts the body: a correlation that no shifted image can question"
    )


def reduced_camera(camera: Camera, reduction: int) -> Camera:
    """Return the camera whose pixels are squares of ``reduction`` pixels, without incomplete ones."""
    # The corner of the first pixel is at (0, 0) at every reduction, so that the principal point is scaled alone.
    return Camera(
        camera.width_px // reduction,
        camera.height_px // reduction,
        camera.fx_px / reduction,
        camera.fy_px / reduction,
        camera.cx_px / reduction,
        camera.cy_px / reduction,
    )


def reduced_image(image: Image, reduction: int) -> Image:
    """Average squares of ``reduction`` pixels."""
    height, width = (side // reduction for side in image.shape)
    # Incomplete squares at the right and lower edges are cut off, as in the reduced camera.
    whole = np.ascontiguousarray(image[: height * reduction, : width * reduction])
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), dtype=np.float32)


def band_pass(image: Image, level: LevelOptions) -> Image:
    """Band-pass an image: blur it, and subtract the level's background."""
    smooth = cv2.GaussianBlur(image, (0, 0), level.blur_px) if level.blur_px > 0.0 else image
    if level.background_px:
        smooth = smooth - cv2.GaussianBlur(smooth, (0, 0), level.background_px)
    return np.asarray(smooth, dtype=np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class LevelFit:
    """The fit of the pose at one level, and the number of steps taken.

    ``information`` (6, 6) is that of [rotation_rad, translation_m] in camera axes, prior included, and ``correlation``
    that of the two images over the compared pixels; NaN if the rendering is empty. ``masked_share`` is the share of the
    pixels that were not compared because the rendering or its derivative is not finite there. ``sharpness`` is the
    `_sharpness` of a body that the frame cuts, or None.
    """

    T_cam_body: Pose
    information: FloatArray
    correlation: float
    steps: int
    masked_share: float = 0.0
    sharpness: float | None = None


def fit_level(
    observed: Image, full: float, start: Pose, view: MeshView, prior: PosePrior, size_m: float, level: LevelOptions,
    options: RegistrationOptions,
) -> LevelFit:  # fmt: skip
    """Fit the pose at one level of the pyramid.

    The observed image is modelled as gain x rendering; the gain is a seventh parameter, so that the result does not
    depend on the image's unit. Derivatives are those of `linearised`, reused while the body hardly moves. Residuals
    have Huber weights with a robust sigma. As they come from errors of the shape rather than from noise,
    ``independent_px`` neighbouring pixels count as one observation. Where the detector is full, the rendering
    is cut at the same level, and has no derivative.

    ``observed`` (H, W) is a signal of background 0, ``full`` its level from `saturation`, and ``size_m`` the radius of
    the body, which converts rotations to motions of its surface.
    """
    camera = reduced_camera(view.camera, level.reduction)
    reduced = replace(view, camera=camera)
    gradient = available_gradient(options.gradient, view.renderer)
    bright = reduced_image(observed, level.reduction)
    target = band_pass(bright, level)
    steps = parameter_steps(start, view.depth_share * camera.pixel_angle_rad, size_m, options.difference_px)
    pose, fit, jacobian, moved_px = start, None, None, 0.0
    sound: NDArray[np.bool_] = np.ones(target.shape, dtype=np.bool_)
    for count in range(1, level.iterations + 1):
        # Twelve renderings for the differences against one for the residuals: the Jacobian is kept while it is good
        # enough.
        if jacobian is None or moved_px > _STALE_PX:
            image, derivatives = linearised(reduced, pose, gradient, steps)
            ceiling = _ceiling(bright, image, full)
            if np.isfinite(ceiling):
                # What is not finite stays, to be left out below.
                derivatives = np.where(image >= ceiling, np.float32(0.0), derivatives)
            # Where a derivative is not finite the residual cannot be used either.
            sound = np.asarray(np.isfinite(derivatives).all(axis=0))
            jacobian, moved_px = [band_pass(_finite(derivative), level) for derivative in derivatives], 0.0
        else:
            image = reduced.render(pose)
            ceiling = _ceiling(bright, image, full)
        usable = sound & np.isfinite(image)
        rendered = band_pass(np.minimum(_finite(image), ceiling), level)
        if not rendered.any():
            return LevelFit(pose, prior.information, float("nan"), count)
        lit = _compared(target, rendered)
        compared = lit & usable
        if not compared.any():
            return LevelFit(pose, prior.information, float("nan"), count, 1.0)
        # The derivatives may be those of an earlier pose; the residuals are always those of the current one.
        normal, vector, correlation = _normal_equations(target, rendered, jacobian, compared, options)
        normal += prior.information
        vector -= prior.information @ prior.offset(pose)
        # Gauss-Newton for the posterior: the prior adds its information, and a pull back to its mean.
        step = _solve(normal, vector)
        pose = pose.perturbed(step[:3], step[3:])
        fit = LevelFit(pose, normal, correlation, count, float(1.0 - compared.sum() / lit.sum()))
        moved_px += float(np.abs(step / steps).max()) * options.difference_px
        if np.sqrt(step @ normal @ step) < options.tolerance_sigma:
            break
    if fit is None:
        raise ValueError("a level has at least one iteration")
    return replace(fit, sharpness=_sharpness(target, rendered, compared)) if is_cut(observed) else fit


def saturation(observed: Image) -> float:
    """Return the level of a signal (H, W) of background 0 at which the detector is full; infinite if few pixels are.

    Read noise scatters full pixels, so that the level is their median. Up to a tenth of the lit pixels may be full and
    not be noticed. Ground that is flat and of one brightness, as with the Sun behind the camera, and images of a dozen
    grey levels are taken for full; what is then cut has no shape to be fitted.
    """
    lit = observed[observed > 0.0]
    if not len(lit):
        return np.inf
    top = float(np.percentile(lit, 99.9))
    full, below = lit > _FULL_LEVEL * top, lit > (2.0 * _FULL_LEVEL - 1.0) * top
    # Smooth ground that faces the Sun is about as bright over many pixels too, but fades gradually.
    piled = full.mean() > max(_FULL_SHARE, _FULL_TIMES * (below.mean() - full.mean()))
    return float(np.median(lit[full])) if piled else np.inf


def _ceiling(bright: Image, rendered: Image, full: float) -> np.float32:
    """Return the level of the rendering at which the detector is full, by the pixels that are not."""
    below = (bright > _DARK * full) & (bright < _UNSATURATED * full) & (rendered > 0.0)
    if not np.isfinite(full) or np.count_nonzero(below) < _UNSATURATED_PX:
        return np.float32(np.inf)
    return np.float32(full / np.median(bright[below] / rendered[below]))


def available_gradient(wanted: Gradient | None, renderer: ImageRenderer) -> Gradient:
    """Return how images are differentiated: as ``wanted``, or else by the renderer where it can.

    Raise BoresightError if ``autodiff`` is wanted and the renderer cannot differentiate.
    """
    able = isinstance(renderer, DifferentiableRenderer) and renderer.differentiable
    if wanted == "autodiff" and not able:
        raise BoresightError(
            "gradient: autodiff: the Mitsuba variant in use gives no derivatives: leave the key out, or see"
            " `boresight doctor`"
        )
    return wanted or ("autodiff" if able else "differences")


def parameter_steps(pose: Pose, pixel_rad: float, size_m: float, motion_px: float) -> FloatArray:
    """Return steps (6,) of the pose parameters that each move the body's outline by about ``motion_px``.

    ``pixel_rad`` is the angle of a pixel, times `Alignment.depth_share`: low above the ground it moves, not an outline.
    """
    range_m = float(np.linalg.norm(pose.translation_m))
    across_m = motion_px * pixel_rad * range_m
    turn_rad = across_m / size_m
    # Along the boresight the body grows: its outline at size_m moves by size_m / range_m of the translation.
    return np.array([turn_rad, turn_rad, turn_rad, across_m, across_m, across_m * range_m / size_m])


def linearised(view: MeshView, pose: Pose, gradient: Gradient, steps: FloatArray) -> tuple[Image, Image]:
    """Render an image (H, W) and its derivatives (6, H, W) by [rotation_rad, translation_m] of ``Pose.perturbed``.

    The Sun is fixed in camera axes. ``steps`` (6,) are those of the differences; see `available_gradient` for
    ``gradient``.
    """
    renderer = view.renderer
    if gradient == "autodiff" and isinstance(renderer, DifferentiableRenderer):
        return renderer.render_with_derivatives(view.at(pose))
    return view.render(pose), np.stack([_difference(view, pose, steps, axis) for axis in range(len(steps))])


def _difference(view: MeshView, pose: Pose, steps: FloatArray, axis: int) -> Image:
    """Return the central difference along one parameter, valid for silhouettes, cast shadows and facets alike.

    One-sided differences would contain the same sampling noise of the central image as the residual that they are
    multiplied with, which would bias every parameter.
    """
    step = np.zeros(6)
    step[axis] = steps[axis]
    ahead, behind = view.render(pose.perturbed(step[:3], step[3:])), view.render(pose.perturbed(-step[:3], -step[3:]))
    return np.asarray((ahead - behind) / np.float32(2.0 * steps[axis]), dtype=np.float32)


def _finite(image: Image) -> Image:
    """Replace values that are not finite by 0, as filters would spread them; such pixels are not compared."""
    return np.nan_to_num(image, nan=0.0, posinf=0.0, neginf=0.0)


def _compared(target: Image, rendered: Image) -> NDArray[np.bool_]:
    """Mask (H, W) of the pixels on or next to the body in either image."""
    dark = _DARK * max(float(np.abs(target).max()), 1e-30), _DARK * max(float(np.abs(rendered).max()), 1e-30)
    # Empty sky would only lower the robust sigma, as its residuals are zero.
    lit = (np.abs(target) > dark[0]) | (np.abs(rendered) > dark[1])
    grown = cv2.dilate(lit.astype(np.uint8), np.ones((_MARGIN_PX, _MARGIN_PX), dtype=np.uint8))
    return np.asarray(grown > 0)


def _normal_equations(
    target: Image, rendered: Image, jacobian: list[Image], compared: NDArray[np.bool_], options: RegistrationOptions
) -> tuple[FloatArray, FloatArray, float]:
    """Information (6, 6) and gradient (6,) of the pose with the gain eliminated, and the images' correlation."""
    o, i = target[compared].astype(np.float64), rendered[compared].astype(np.float64)
    gain, weight = _gain(o, i, options.huber_sigma)
    residual = o - gain * i
    # The variance of residuals is found from the image itself; independent_px of them count as one.
    variance = float((weight * residual) @ residual / weight.sum()) * options.independent_px
    # Model gain x rendering(pose): its derivatives are gain x Jacobian by the pose, and the rendering by the gain.
    columns = np.stack([gain * column[compared].astype(np.float64) for column in jacobian] + [i], axis=1)
    weighted = columns * (weight / max(variance, 1e-300))[:, None]
    full, right = weighted.T @ columns, weighted.T @ residual
    # The Schur complement eliminates the gain.
    normal = full[:6, :6] - np.outer(full[:6, 6], full[6, :6]) / full[6, 6]
    vector = right[:6] - full[:6, 6] * right[6] / full[6, 6]
    return normal, vector, float(np.corrcoef(o, i)[0, 1])


def _gain(o: FloatArray, i: FloatArray, huber_sigma: float) -> tuple[float, FloatArray]:
    """Factor from the pixels ``i`` to the pixels ``o``, and Huber's weight of each pixel."""
    weight = np.ones_like(o)
    gain = float(i @ o / (i @ i))
    for _ in range(_REWEIGHTINGS):
        residual = np.abs(o - gain * i)
        sigma = MAD_TO_SIGMA * float(np.median(residual))
        # Huber: 1 up to the limit, beyond it the limit over the residual.
        weight = 1.0 / np.maximum(1.0, residual / max(huber_sigma * sigma, 1e-300))
        # Weighted least squares for one factor; with fixed weights it has a closed form.
        gain = float((weight * i) @ o / ((weight * i) @ i))
    return gain, weight


def inverse(normal: FloatArray) -> FloatArray:
    """Invert an information matrix, scaled to a unit diagonal first."""
    scale = 1.0 / np.sqrt(np.diag(normal))
    covariance: FloatArray = np.linalg.inv(normal * np.outer(scale, scale)).astype(np.float64) * np.outer(scale, scale)
    return covariance


def _solve(normal: FloatArray, vector: FloatArray) -> FloatArray:
    """Solve scaled to a unit diagonal: square radians and square metres differ by orders of magnitude."""
    scale = 1.0 / np.sqrt(np.diag(normal))
    solution: FloatArray = scale * np.linalg.solve(normal * np.outer(scale, scale), scale * vector)
    return solution


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """A registration with its stages.

    ``shift`` is the first shift across the line of sight, and ``fits`` are those of the levels, from coarse to fine, up
    to one at which the shape went out of view. ``failure`` is the reason of a failure; empty if the pose is good.
    """

    shift: Alignment
    fits: tuple[LevelFit, ...] = ()
    failure: str = ""

    @property
    def T_cam_body(self) -> Pose:
        """The last pose."""
        return self.fits[-1].T_cam_body if self.fits else self.shift.T_cam_body


def register(
    observed: NDArray[np.float32],
    frame: Frame,
    view: MeshView,
    size_m: float,
    options: RegistrationOptions,
    clock: Stopwatch,
) -> Registration:
    """Estimate the maximum a posteriori pose by registering the rendering of a shape with the image.

    ``observed`` (H, W) is the signal of the image, background 0, not black; the frame's prior is the initial pose.
    ``size_m`` is the radius of the shape, which converts rotations to motions of its surface. ``clock`` records the
    times ``mesh_rendering`` and ``centroid`` of the shift, and ``registration``.
    """
    start = frame.prior_T_cam_body
    shift = align_translation(observed, start, view, correlation_pair, options.alignment_loop, clock)
    if shift.failure:
        return Registration(shift, failure=shift.failure)
    view = replace(view, depth_share=shift.depth_share)
    # The prior is that of the frame, not shifted: the shift comes from the same image.
    prior = PosePrior(start, inverse(floor_variances(frame.prior_covariance)))
    fits: list[LevelFit] = []
    full = saturation(observed)
    default_px = _CUT_BACKGROUND_PX if is_cut(observed) else 0.0
    for wanted in options.levels:
        own_px = wanted.background_px
        level = wanted.model_copy(update={"background_px": default_px if own_px is None else own_px})
        with clock(STAGE):
            begin = fits[-1].T_cam_body if fits else shift.T_cam_body
            fits.append(fit_level(observed, full, begin, view, prior, size_m, level, options))
        if not np.isfinite(fits[-1].correlation):
            break
    return Registration(shift, tuple(fits), _failure(fits[-1], options))


def _failure(fit: LevelFit, options: RegistrationOptions) -> str:
    if not np.isfinite(fit.correlation):
        return "the rendered mesh went out of view or into the dark"
    unlike = f"the rendering does not look like the image: correlation {fit.correlation:.2f}"
    if fit.sharpness is None:
        return "" if fit.correlation >= options.correlation_min else unlike
    if fit.sharpness >= options.sharpness_min or fit.correlation >= options.correlation_sure:
        return ""
    return f"{unlike}, {fit.sharpness:.2g} times that of shifted images"


def _sharpness(target: Image, rendered: Image, compared: NDArray[np.bool_]) -> float:
    """Return the correlation of two images (H, W) over the largest one at shifts of `_APART_PX` to `_REACH_PX`.

    Relief that the shape does not have lowers the correlation at the right pose, and chance raises that at wrong ones:
    no one limit of it suits all bodies. Their ratio is about 1 at a pose that chance has found. Brightness that changes
    over more than the least shift is subtracted, as it is alike there too.
    """
    fine = [image - cv2.GaussianBlur(image, (0, 0), 0.5 * _APART_PX) for image in (target, rendered)]
    first, second = (np.fft.rfft2(np.where(compared, image - image[compared].mean(), 0.0)) for image in fine)
    shifted = np.fft.irfft2(first * second.conj(), s=target.shape)
    rows, columns = (np.fft.fftfreq(side, 1.0 / side) for side in target.shape)
    apart = np.hypot(rows[:, None], columns)
    others = shifted[(apart > _APART_PX) & (apart <= _REACH_PX)]
    return float(shifted[0, 0] / max(others.max(initial=0.0), 1e-300))

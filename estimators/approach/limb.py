"""The estimator ``limb``: the position from points on the lit limb."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from pydantic import Field

from boresight.estimators.approach.body import BODY_SHARE, LitBody, find_body, lit_area_px, row_ends, sphere_px
from boresight.estimators.approach.ellipsoid import ellipsoid_of
from boresight.estimators.approach.fusion import fuse, grouped_covariance
from boresight.estimators.approach.limb_errors import bias_covariance, scatter_covariance
from boresight.estimators.approach.outline import outline_normals, outline_of, ray_directions
from boresight.estimators.approach.profile import (
    ACROSS_PX,
    DEPTHS_PX,
    blurred,
    fit_limb,
    outermost_rise,
    sampled,
    second_law,
)
from boresight.estimators.contract import Assets, Estimate, Stage, Stopwatch
from boresight.estimators.options import parse_options
from boresight.estimators.prior import floor_variances
from boresight.scenarios.arrays import MAD_TO_SIGMA, BoolArray, FloatArray, IndexArray
from boresight.scenarios.geometry import Camera, Pose, TriangleMesh, View
from boresight.scenarios.observation import Frame, Observation
from boresight.scenarios.spec.base import SpecModel

_SPACING_PX = 1.5
_LEAST_RAYS, _MOST_RAYS = 48, 256
_BORDER_PX = 5.0
_SCAN_STEP_PX, _MOST_SAMPLES = 0.5, 256
_MOST_STEPS, _WHOLE_STEPS, _MOVED_PX = 10, 3, 0.02
_HUBER = 1.5
_SIGMAS = 3.0  # of the prior's error, in which the limb is searched
_ARCS = 12
_LIT_PX = 1.0
_LEAST_SEEN = 0.5  # of the lit outline of a body that the frame cuts
_POINT_PX = 0.08
"""Standard deviation of a point in predictions: the mean RMS residual of 100 images of a body 130 px across."""


class LimbOptions(SpecModel):
    """Options of ``limb``."""

    blur_px: float = Field(
        0.5,
        ge=0,
        le=1.3,
        description="Point spread function of the camera; wider ones do not fit into a profile of 8 px",
    )
    bias_px: float = Field(
        0.04,
        ge=0,
        description="Standard deviation of an error of all points along their normals, by point spread and reflectance",
    )
    # An outline is where heights are greatest. In renderings of four bodies, 30 to 300 px across, the shift is 0.6 of
    # the errors outwards where the onboard shape lacks the relief, 0.2 inwards where it has other relief, 0 if exact.
    shift: float = Field(
        0.4,
        ge=0,
        description="The same by unknown relief, over the errors of the points; 0 for a shape that is exact, with a law"
        " of reflectance between Lambert's and that of Lommel and Seeliger, where the errors of points are independent",
    )
    misfit_px: float = Field(
        1.6,
        gt=0,
        description="Where the frame cuts the body, a larger RMS distance of the points from the outline is a failure; "
        "points anywhere on their profiles have 1.7",
    )
    points_min: int = Field(12, ge=6, le=360, description="Fewer points on the lit limb are a failure")


@dataclass(frozen=True, slots=True, eq=False)
class LimbPoints:
    """Points of a shape's lit limb in the image at a pose.

    ``uv_px`` (n, 2) with outward unit normals (n, 2) and the number (n,) of the ray of each; ``by_position`` (n, 3) are
    the derivatives, px / m, of a point along its normal by the translation, ``by_attitude`` (n, 3), px / rad, by the
    attitude.
    """

    uv_px: FloatArray
    normals: FloatArray
    ray: IndexArray
    by_position: FloatArray
    by_attitude: FloatArray

    def __getitem__(self, rows: BoolArray) -> LimbPoints:
        return LimbPoints(*(getattr(self, name)[rows] for name in LimbPoints.__slots__))


@dataclass(frozen=True, slots=True, eq=False)
class _Plan:
    """A frame, the camera, the unit directions (count, 2) of the rays in the image, and the edges of the outline."""

    frame: Frame
    camera: Camera
    rays: FloatArray
    edges: IndexArray


@dataclass(frozen=True, slots=True, eq=False)
class _Scene(_Plan):
    """A plan with the lit body of its image."""

    body: LitBody


class LimbEstimator:
    """Fits the position to sub-pixel points on the lit limb of the onboard shape.

    Rays from the middle of the body find the limb from outside on the side of the Sun, and Christian and Robinson's
    solution for the shape's ellipsoid is the start. Where the frame cuts the body, the limb is searched along the
    normals of the prior's outline, within three of the prior's standard deviations and then ever nearer. The outline of
    the onboard shape is then fitted by robust Gauss-Newton steps: profiles of brightness across it, fitted by the light
    of the shape's facets there, give sub-pixel points, and distances along the normals are minimised. The light is
    shared by Lambert's law and that of Lommel and Seeliger as in the whole image; cast shadows are left out. The three
    coordinates of the position are fused with the prior; the attitude stays that of the prior. The covariance holds the
    errors of the points, whose correlation along the limb is estimated in each image, a bias, and what the errors of
    the prior's attitude and of the calibration do to the position. Of a shape that is known exactly (``shift: 0``) the
    errors of points are taken as independent. Half of the bias's variance is stated as common to all images.

    Use it when
    -----------
    The lit limb is in the image, also where the frame cuts the body, and the range is wanted too.

    It fails when
    -------------
    Fewer than ``points_min`` points of the lit limb are in the image: the body fills the frame, or its mean radius is
    below 4 px; the fit does not settle; or the frame cuts it, and the points are ``misfit_px`` off the outline or at
    less than half of its lit part. The outline must be that of the shape: errors of the shape enter in full. Saturated
    pixels move the limb outwards. Light around the body is left out up to a fifth of its bright level.

    Cost
    ----
    0.015 s an image of 1024 x 1024 pixels and a shape of 50 000 facets, 0.07 s with 800 000, on a quiet machine; on a
    busy one 0.026 s, 2.5 times a Fourier transform of the image (`boresight bench methods`).

    Source
    ------
    Christian and Robinson (2016), Journal of Guidance, Control, and Dynamics 39, 2757, and Christian (2021), IEEE
    Access 9, 19819, for the ellipsoid; the fit of the shape's outline, of the profiles and the covariance are ours.
    """

    name: ClassVar[str] = "limb"
    version: ClassVar[int] = 14
    fuses_prior: ClassVar[bool] = True
    options_model: ClassVar[type[SpecModel]] = LimbOptions

    def __init__(self, mesh: TriangleMesh, options: LimbOptions) -> None:
        self._outline, self._ellipsoid, self._radius_m = outline_of(mesh), ellipsoid_of(mesh), mesh.radius_m
        self._area_vectors_m2, self._options = mesh.area_vectors_m2, options

    @classmethod
    def from_options(cls, options: Mapping[str, object], assets: Assets) -> Self:
        """Build from a campaign's options and the onboard shape."""
        parsed = parse_options(LimbOptions, options, cls.name)
        return cls(assets.shape(), parsed)

    def estimate(self, observation: Observation, *, rng: np.random.Generator) -> Estimate:
        """Estimate the position.

        Diagnostics are ``limb_points``, ``residual_px`` (RMS of the distances along the normals) and ``extent_px``.
        ``rng`` is not used.
        """
        del rng
        frame, camera, clock = observation.frame, observation.camera, Stopwatch()
        prior = frame.prior_T_cam_body
        with clock("limb"):
            size_px = sphere_px(self._radius_m, prior, camera)
            lit = lit_area_px(self._area_vectors_m2, prior, frame.sun_dir_cam, camera)
            body = find_body(frame, camera, size_px, lit, self._options.blur_px)
            if isinstance(body, str):
                return Estimate("failed", body, timings_s=clock.seconds)
            body = body.brighter(BODY_SHARE)
            count = _ray_count(size_px)
            scene = _Scene(frame, camera, ray_directions(count), self._outline.silhouette(prior), body)
            begun = self._search(scene) if body.cut else self._scan(scene, self._place(scene))
            fit = None if begun is None else self._refine(scene, begun)
            stages = () if begun is None else (Stage("horizon", begun),)
            told: dict[str, float | int | str] = {"extent_px": body.extent_px}
            if fit is None or isinstance(fit, str):
                failure = fit or (
                    f"fewer than points_min {self._options.points_min} points of the lit limb are in the image"
                    f", or the body's radius is below {ACROSS_PX[-1]:g} px"
                )
                return Estimate("failed", failure, stages=stages, diagnostics=told, timings_s=clock.seconds)
            pose, points, residual_px, weight, share = fit
            misfit_px = float(np.sqrt((residual_px**2).mean()))
            told |= {"limb_points": len(residual_px), "residual_px": misfit_px}
            if body.cut and misfit_px > self._options.misfit_px:
                failure = f"points of the limb are {misfit_px:.2g} px RMS off the outline: more than misfit_px"
                return Estimate("failed", failure, stages=stages, diagnostics=told, timings_s=clock.seconds)
            # Each point measures g . (t - t_prior) + q . w + noise; the weighted sums of these are all that they tell.
            weighted = weight[:, None] * points.by_position
            by_pose = weighted.T @ np.hstack([points.by_attitude, points.by_position])
            off_m = pose.translation_m - prior.translation_m
            measured = weighted.T @ (share * residual_px + points.by_position @ off_m)
            arc = points.ray * _ARCS // count
            directions = scene.rays[points.ray]
            if self._options.shift > 0.0:
                noise, sigma_px = scatter_covariance(residual_px, points.by_position, directions, points.ray, weight)
            else:
                # Without errors of heights, those of neighbouring points are taken as independent.
                each, sigma_px = np.arange(len(weight)), 0.0
                noise = grouped_covariance(residual_px[:, None] * weighted, each, 3)
            by_bias, common = bias_covariance(self._bias_px(sigma_px), weighted, arc)
            of_camera = observation.calibration_covariance(prior)
            found = fuse(observation, measured, by_pose, noise + by_bias, common, of_camera)
        return replace(found, stages=stages, diagnostics=told, timings_s=clock.seconds)

    def predict(self, planned: Observation) -> FloatArray | None:
        """Predict the covariance (6, 6) by the lit limb at the planned pose; see `Predictor`."""
        found = self.predict_estimate(planned)
        return None if found is None else found.covariance

    def predict_estimate(self, planned: Observation) -> Estimate | None:
        """Predict covariance and common error by the lit limb at the planned pose, which is that of the result.

        The points have errors of `_POINT_PX` that are independent, and the bias that follows. Result None where the
        outline reaches the border of the frame: geometry does not tell which part of the limb is found there.
        """
        frame, camera = planned.frame, planned.camera
        pose = frame.prior_T_cam_body
        count = _ray_count(sphere_px(self._radius_m, pose, camera))
        plan = _Plan(frame, camera, ray_directions(count), self._outline.silhouette(pose))
        centre_px = camera.project(pose.translation_m)
        radius_px, _ = self._outline.at(pose, camera, centre_px, plan.rays, plan.edges)
        met = np.isfinite(radius_px)
        if not camera.contains(centre_px + radius_px[met, None] * plan.rays[met]).all():
            return None
        points = self._limb_at(plan, pose, centre_px)
        if points is None or len(points.ray) < self._options.points_min:
            return None
        by_pose = points.by_position.T @ np.hstack([points.by_attitude, points.by_position])
        by_bias, common = bias_covariance(self._bias_px(_POINT_PX), points.by_position, points.ray * _ARCS // count)
        noise, of_camera = _POINT_PX**2 * by_pose[:, 3:] + by_bias, planned.calibration_covariance(pose)
        return fuse(planned, np.zeros(3), by_pose, noise, common, of_camera)

    def _bias_px(self, sigma_px: float) -> float:
        """Bias by camera and reflectance, and by the relief that gives points their errors."""
        return float(np.hypot(self._options.bias_px, self._options.shift * sigma_px))

    def _limb_at(self, scene: _Plan, pose: Pose, centre_px: FloatArray) -> LimbPoints | None:
        """Points of the lit limb at a pose, on the rays from a centre; None without any."""
        frame, camera = scene.frame, scene.camera
        radius_px, points_m = self._outline.at(pose, camera, centre_px, scene.rays, scene.edges)
        if not np.isfinite(radius_px).any():
            return None
        normals = outline_normals(radius_px, scene.rays)
        uv_px = centre_px + radius_px[:, None] * scene.rays
        by_position = np.einsum("ni,nij->nj", normals, camera.jacobian(points_m))
        # The surface's normal at the limb is across the line of sight: that of the plane through the tangent.
        outward = by_position / np.linalg.norm(by_position, axis=1, keepdims=True)
        sights = points_m / np.linalg.norm(points_m, axis=1, keepdims=True)
        across, along = outward @ frame.sun_dir_cam, sights @ frame.sun_dir_cam
        mean_px = float(np.nanmean(radius_px))
        if mean_px < ACROSS_PX[-1]:
            return None  # the other side of the body is within the reach of a profile
        # Lit from the limb on to a depth at which the normal has turned by this angle, at least a pixel.
        turn = np.minimum(np.arctan2(across, along), 0.5 * np.pi)
        lit = (across > 0.0) & (mean_px * (1.0 - np.cos(turn)) > _LIT_PX)
        lit &= np.isfinite(by_position).all(axis=1) & camera.contains(uv_px, _BORDER_PX)
        if not lit.any():
            return None
        by_attitude = np.cross(points_m - pose.translation_m, by_position)
        parts = uv_px, normals, np.arange(len(scene.rays)), by_position, by_attitude
        return LimbPoints(*(part[lit] for part in parts))

    def _light(self, scene: _Plan, pose: Pose, centre_px: FloatArray, limb: LimbPoints) -> FloatArray:
        """Profiles (rays, 2, k) of the shape's light across a limb, for `fit_limb`; 0 on rays without a point."""
        view = View(scene.camera, pose, pose.rotation.T @ scene.frame.sun_dir_cam)
        light = np.zeros((len(scene.rays), 2, len(DEPTHS_PX)))
        within_px = limb.uv_px[:, None] - DEPTHS_PX[:, None] * limb.normals[:, None]
        light[limb.ray] = self._outline.light(view, within_px).transpose(0, 2, 1)
        radius_px = float(np.linalg.norm(limb.uv_px - centre_px, axis=1).mean())
        return blurred(light, radius_px, self._options.blur_px)

    def _place(self, scene: _Scene) -> Pose:
        """Shift the prior across the line of sight: the outline onto the lit pixels on the side of the Sun."""
        body, camera, prior = scene.body, scene.camera, scene.frame.prior_T_cam_body
        centre_px = camera.project(prior.translation_m)
        radius_px, _ = self._outline.at(prior, camera, centre_px, scene.rays, scene.edges)
        if not np.isfinite(radius_px).any():
            return prior
        outline = centre_px + radius_px[:, None] * scene.rays
        lit = row_ends(body.lit) + np.array([body.patch.column, body.patch.row]) + 0.5
        along = camera.jacobian(prior.translation_m) @ scene.frame.sun_dir_cam
        sun = along / max(float(np.linalg.norm(along)), 1e-300)
        across = np.array([-sun[1], sun[0]])
        along_px = (lit @ sun).max() - np.nanmax(outline @ sun)
        sides, edges = lit @ across, outline @ across
        across_px = 0.5 * (sides.max() + sides.min() - np.nanmax(edges) - np.nanmin(edges))
        ray = camera.unproject(centre_px + along_px * sun + across_px * across)
        return replace(prior, translation_m=ray * np.linalg.norm(prior.translation_m))

    def _scan(self, scene: _Scene, start: Pose) -> Pose | None:
        """Find the limb on rays from outside, solve for the ellipsoid, and fit the outline to the same points."""
        camera = scene.camera
        centre_px = camera.project(start.translation_m)
        limb = self._limb_at(scene, start, centre_px)
        if limb is None:
            return None
        reach_px = 1.5 * float(np.linalg.norm(limb.uv_px - centre_px, axis=1).max()) + 10.0
        step_px = max(_SCAN_STEP_PX, reach_px / _MOST_SAMPLES)
        radius_px, rays = np.arange(0.0, reach_px, step_px), scene.rays[limb.ray]
        samples = sampled(scene.body.patch, centre_px + rays[:, None] * radius_px[:, None])
        seen = np.full(scene.rays.shape, np.nan)
        seen[limb.ray] = centre_px + step_px * outermost_rise(samples, scene.body.floor)[:, None] * rays
        sound = np.isfinite(seen).all(axis=1) & camera.contains(seen, _BORDER_PX)
        limb = limb[sound[limb.ray]]
        if len(limb.ray) < self._options.points_min:
            return None
        pose = self._from_horizon(camera.unproject(seen[limb.ray]), start)
        for _ in range(_MOST_STEPS):
            limb = self._limb_at(scene, pose, centre_px)
            limb = None if limb is None else limb[sound[limb.ray]]
            if limb is None or len(limb.ray) < self._options.points_min:
                return None
            residual_px = np.einsum("ni,ni->n", seen[limb.ray] - limb.uv_px, limb.normals)
            before, (pose, _) = pose, _step(pose, scene.frame, limb.by_position, residual_px)
            if _moved_px(limb, before, pose) < _MOVED_PX:
                break
        return pose

    def _search(self, scene: _Scene) -> Pose | None:
        """Fit the outline from the prior to rises along its normals, first as far as the prior may be off.

        For a body that the frame cuts: on rays from its middle the border of the frame or another part of the body may
        be outermost, and the ellipsoid's horizon by a part of an irregular limb is worse than the prior.
        """
        camera, pose, reach_px = scene.camera, scene.frame.prior_T_cam_body, 0.0
        for step in range(_MOST_STEPS):
            limb = self._limb_at(scene, pose, camera.project(pose.translation_m))
            if limb is None:
                return None
            if step == 0:
                by_pose = np.hstack([limb.by_attitude, limb.by_position])
                variance = np.einsum("ni,ij,nj->n", by_pose, scene.frame.prior_covariance, by_pose)
                reach_px = _SIGMAS * float(np.sqrt(variance.max()))
            reach_px = max(reach_px, ACROSS_PX[-1])
            across_px = np.linspace(-reach_px, reach_px, int(min(4.0 * reach_px + 1.0, _MOST_SAMPLES)))
            samples = sampled(scene.body.patch, limb.uv_px[:, None] + across_px[:, None] * limb.normals[:, None])
            rise = outermost_rise(samples, scene.body.floor)
            residual_px = across_px[0] + rise * (across_px[1] - across_px[0])
            sound = camera.contains(limb.uv_px + residual_px[:, None] * limb.normals, _BORDER_PX) & np.isfinite(rise)
            limb, residual_px = limb[sound], residual_px[sound]
            if len(residual_px) < self._options.points_min:
                return None
            before, (pose, _) = pose, _step(pose, scene.frame, limb.by_position, residual_px)
            if reach_px <= ACROSS_PX[-1] and _moved_px(limb, before, pose) < _SCAN_STEP_PX:
                break
            reach_px *= 0.5
        return pose

    def _from_horizon(self, directions: FloatArray, start: Pose) -> Pose:
        """Return the pose by the ellipsoid's horizon; the start if it has none within half to twice the range."""
        found = self._ellipsoid.from_horizon(directions, start.rotation)
        ratio = 0.0 if found is None else float(np.linalg.norm(found) / np.linalg.norm(start.translation_m))
        return replace(start, translation_m=found) if found is not None and 0.5 < ratio < 2.0 else start

    def _refine(self, scene: _Scene, pose: Pose) -> tuple[Pose, LimbPoints, FloatArray, FloatArray, float] | str | None:
        """Fit the outline to profiles of brightness, from a pose nearby.

        Return the pose, points, their distances at it, px, weights, px^-2, and the share of the last step that is
        taken; a reason if the fit does not settle, None if there are too few points.
        """
        scene = replace(scene, edges=self._outline.silhouette(pose))
        light = np.zeros(0)
        for step in range(_MOST_STEPS):
            centre_px = scene.camera.project(pose.translation_m)
            limb = self._limb_at(scene, pose, centre_px)
            if limb is None:
                return None
            samples = sampled(scene.body.patch, limb.uv_px[:, None] + ACROSS_PX[:, None] * limb.normals[:, None])
            outside = samples[:, -2:].mean(axis=1, keepdims=True)
            samples = samples - np.where(outside < scene.body.floor, outside, 0.0)  # else it is the body again
            rise = outermost_rise(samples, scene.body.floor)
            start_px = np.interp(rise, np.arange(len(ACROSS_PX)), ACROSS_PX)
            if step == 0:
                light = self._light(scene, pose, centre_px, limb)
                second = second_law(samples, light[limb.ray], start_px)
                light = (1.0 - second) * light[:, :1] + second * light[:, 1:]
            place_px, gain = fit_limb(samples, light[limb.ray], start_px)
            sound = (np.abs(place_px) < ACROSS_PX[-1] - 1.0) & (gain[:, 0] > 0.0) & np.isfinite(rise)
            if sound.sum() < self._options.points_min:
                return None
            limb, residual_px = limb[sound], place_px[sound]
            moved, weight = _step(pose, scene.frame, limb.by_position, residual_px)
            # Points come and go with the pose, and steps may cycle between two sets of them: later ones are averaged.
            share = 1.0 / max(step - _WHOLE_STEPS + 2, 1)
            step_m = share * (moved.translation_m - pose.translation_m)
            moved = replace(moved, translation_m=pose.translation_m + step_m)
            fitted = pose, limb, residual_px, weight, share
            if _moved_px(limb, pose, moved) < _MOVED_PX:
                if scene.body.cut and sound.mean() < _LEAST_SEEN:
                    return f"the limb is at {sound.mean():.0%} of the outline's lit points: it is that of another shape"
                return fitted
            pose = moved
        return f"the fit of the limb's points does not settle in {_MOST_STEPS} steps"


def _moved_px(limb: LimbPoints, before: Pose, after: Pose) -> float:
    """RMS of the shifts of points along their normals by a step of the translation, px."""
    return float(np.sqrt(np.mean((limb.by_position @ (after.translation_m - before.translation_m)) ** 2)))


def _ray_count(size_px: float) -> int:
    """Return the number of rays for a body of a diameter in the image."""
    return int(np.clip(np.pi * size_px / _SPACING_PX, _LEAST_RAYS, _MOST_RAYS))


def _step(pose: Pose, frame: Frame, by_position: FloatArray, residual_px: FloatArray) -> tuple[Pose, FloatArray]:
    """Take a robust Gauss-Newton step of the translation with the prior; also return the weights (n,), px^-2."""
    sigma = max(MAD_TO_SIGMA * float(np.median(np.abs(residual_px))), 1e-3)
    weight = 1.0 / np.maximum(1.0, np.abs(residual_px) / (_HUBER * sigma)) / sigma**2
    known = np.linalg.inv(floor_variances(frame.prior_covariance)[3:, 3:])
    off = pose.translation_m - frame.prior_T_cam_body.translation_m
    normal = by_position.T @ (weight[:, None] * by_position) + known
    step = np.linalg.solve(normal, by_position.T @ (weight * residual_px) - known @ off)
    return replace(pose, translation_m=pose.translation_m + step), weight

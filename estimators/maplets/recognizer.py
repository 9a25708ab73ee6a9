"""The estimator ``lmaps``: navigation by maplets that are rendered and matched with the image."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from boresight.estimators.contract import Assets, Estimate, Stage, Stopwatch, Table, typed_product
from boresight.estimators.landmark.alignment import (
    Alignment,
    AlignmentOptions,
    MeshView,
    align_translation,
    correlation_pair,
)
from boresight.estimators.landmark.matching import inverse_2x2, point_columns
from boresight.estimators.landmark.pose.posterior import GaussianPose, Posterior, solve_map
from boresight.estimators.landmark.pose.problem import MIN_LANDMARKS, PoseProblem
from boresight.estimators.landmark.signal import observed_signal
from boresight.estimators.maplets.build import MapletOptions
from boresight.estimators.maplets.database import MapletDatabase
from boresight.estimators.maplets.matching import (
    MapletMatches,
    MapletScene,
    MatchingOptions,
    match_by_correlation,
    match_by_least_squares,
    render_maplets,
)
from boresight.estimators.options import parse_options
from boresight.estimators.prior import calibration_in_posterior
from boresight.scenarios.arrays import FloatArray, Image
from boresight.scenarios.geometry import Camera, Pose
from boresight.scenarios.observation import Frame, Observation
from boresight.scenarios.spec.base import SpecModel

PRODUCT = "maplets"
_ACROSS = slice(3, 5)


@dataclass(frozen=True, slots=True, eq=False)
class MapletFit:
    """One round: the matched maplets and the pose from them."""

    found: MapletMatches
    posterior: Posterior


@dataclass(frozen=True, slots=True, eq=False)
class MapletRecognition:
    """All intermediate results of recognition in one image.

    ``stages`` are poses after alignment, correlation and refinement, as far as they were reached, and ``fits`` the
    rounds of matching and solving: by correlation first, then by least squares. ``failure`` is the reason why there is
    no pose; empty if there is one.
    """

    stages: tuple[Stage, ...]
    fits: tuple[MapletFit, ...]
    timings_s: Mapping[str, float]
    failure: str = ""


def maplet_table(fit: MapletFit, database: MapletDatabase, camera: Camera) -> Table:
    """Return the table of a round's matched maplets, one row each.

    Columns: ``landmark`` (row of the data base), ``u_px, v_px`` (observed position of its anchor), ``correlation``,
    ``d2_px`` (weighted squared distance to the anchor at the estimated pose), ``x_m, y_m, z_m`` (the anchor) and
    ``sxx_m2 ... szz_m2`` (covariance of the surface point at that pixel, about the anchor).
    """
    found = fit.found
    table: dict[str, NDArray[np.generic]] = {
        "landmark": found.maplet,
        "u_px": found.uv_px[:, 0],
        "v_px": found.uv_px[:, 1],
        "correlation": found.correlation,
        "d2_px": fit.posterior.d2,
    }
    return table | point_columns(database.anchors_m[found.maplet], surface_covariances(fit, database, camera))


def surface_covariances(fit: MapletFit, database: MapletDatabase, camera: Camera) -> FloatArray:
    """Covariances (M, 3, 3), body frame, m^2, of the surface points at the observed positions of the anchors.

    A displacement in the image moves the point in the plane of its maplet: across the line of sight by its size, and
    along it according to the slope of the plane. Normal to the plane the variance is that of the heights.
    """
    pose, maplet = fit.posterior.T_cam_body, fit.found.maplet
    points = pose.transform(database.anchors_m[maplet])
    normals = pose.rotate(database.axes[maplet, 2])
    sight = points / np.linalg.norm(points, axis=1, keepdims=True)
    across = np.zeros((len(maplet), 3, 2))
    # Metres per pixel at the depth of the point, along the axes of the image; then along the sight onto the plane.
    across[:, 0, 0], across[:, 1, 1] = points[:, 2] / camera.fx_px, points[:, 2] / camera.fy_px
    slope = np.einsum("ni,nij->nj", normals, across) / np.einsum("ni,ni->n", normals, sight)[:, None]
    in_plane = across - sight[:, :, None] * slope[:, None, :]
    # The covariances of the measurement are calibrated by the factor that the fit has found for them.
    in_image = fit.posterior.scale2 * fit.found.covariances_px2
    height = fit.found.height_sigma_m**2 * normals[:, :, None] * normals[:, None, :]
    in_camera = in_plane @ in_image @ np.swapaxes(in_plane, 1, 2) + height
    covariances: FloatArray = pose.rotation.T @ in_camera @ pose.rotation
    return covariances


class MapletsOptions(SpecModel):
    """Options of ``lmaps``."""

    maplets: MapletOptions = MapletOptions()
    samples_per_pixel: int = Field(4, ge=1, le=64, description="Samples of a rendered pixel, a square number")
    alignment: AlignmentOptions = AlignmentOptions(tolerance_px=1.0)
    alignment_sigma_px: float = Field(3.0, gt=0, description="Standard deviation of the aligned position, each axis")
    matching: MatchingOptions = MatchingOptions()
    tolerance_px: float = Field(0.05, gt=0, description="Done when no maplet moves by more between two renderings")
    max_rounds: int = Field(
        4, ge=1, le=100, description="Most renderings for the refinement, after the one for the correlation"
    )


def recognise(frame: Frame, camera: Camera, scene: MapletScene, options: MapletsOptions) -> MapletRecognition:
    """Run all stages on one image; raise BoresightError if the image does not have the camera's size."""
    clock = Stopwatch()
    stages: list[Stage] = []

    def failed(why: str) -> MapletRecognition:
        return MapletRecognition(tuple(stages), (), clock.seconds, why)

    observed = observed_signal(frame, camera, clock)
    if isinstance(observed, str):
        return failed(observed)
    view = MeshView(camera, scene.quick, frame.sun_dir_cam)
    aligned = align_translation(observed, frame.prior_T_cam_body, view, correlation_pair, options.alignment, clock)
    if aligned.failure:
        return failed(aligned.failure)
    stages.append(Stage("alignment", aligned.T_cam_body))
    return _rounds(observed, frame, aligned, _FitContext(camera, scene, options, clock), stages)


@dataclass(frozen=True, slots=True, eq=False)
class _FitContext:
    """The camera, maplets, options and clock that all rounds share."""

    camera: Camera
    scene: MapletScene
    options: MapletsOptions
    clock: Stopwatch

    def fit(self, observed: Image, frame: Frame, pose: Pose, uncertainty: FloatArray | None) -> MapletFit | str:
        """Render, match and solve once: by correlation within an ``uncertainty``, or by least squares without one."""
        matching = self.options.matching
        with self.clock("mesh_rendering"):
            seen = render_maplets(self.scene, self.camera, pose, frame.sun_dir_cam, matching)
        with self.clock("correlation"):
            if uncertainty is None:
                found = match_by_least_squares(observed, seen, matching)
            else:
                found = match_by_correlation(observed, seen, uncertainty, matching)
        if len(found) < MIN_LANDMARKS:
            return f"{len(found)} of {len(seen.windows)} maplets found, {MIN_LANDMARKS} needed"
        with self.clock("recognition"):
            anchors_m = self.scene.database.anchors_m[found.maplet]
            problem = PoseProblem(anchors_m, found.uv_px, inverse_2x2(found.covariances_px2), self.camera)
            # The original prior in every round: a round's result as the prior of the next would count the image twice.
            prior = GaussianPose(frame.prior_T_cam_body, frame.prior_covariance)
            return MapletFit(found, solve_map(problem, prior, pose, found.shared))

    def motion_px(self, before: Pose, after: Pose) -> float:
        """Return the largest motion of a maplet in the image between two poses."""
        anchors_m = self.scene.database.anchors_m
        motion = self.camera.project(after.transform(anchors_m)) - self.camera.project(before.transform(anchors_m))
        return float(np.nanmax(np.linalg.norm(motion, axis=1)))


def _rounds(
    observed: Image, frame: Frame, aligned: Alignment, context: _FitContext, stages: list[Stage]
) -> MapletRecognition:
    """Match by correlation, then by least squares until the pose no longer changes."""
    uncertainty = np.array(frame.prior_covariance)
    depth_m = aligned.depth_share * float(np.linalg.norm(aligned.T_cam_body.translation_m))
    aligned_m2 = (context.options.alignment_sigma_px * context.camera.pixel_angle_rad * depth_m) ** 2
    # Across the line of sight the alignment replaces the prior where it is more accurate. The correlations stay, or the
    # matrix could lose its positive eigenvalues.
    variances = np.diag(uncertainty).copy()
    smaller = variances.copy()
    smaller[_ACROSS] = np.minimum(variances[_ACROSS], aligned_m2)
    share = np.sqrt(np.divide(smaller, variances, out=np.ones(6), where=variances > 0.0))
    uncertainty *= np.outer(share, share)
    np.fill_diagonal(uncertainty, smaller)
    fits: list[MapletFit] = []
    pose = aligned.T_cam_body
    for _ in range(1 + context.options.max_rounds):
        fit = context.fit(observed, frame, pose, None if fits else uncertainty)
        if isinstance(fit, str):
            return MapletRecognition(tuple(stages), tuple(fits), context.clock.seconds, fit)
        before, pose = pose, fit.posterior.T_cam_body
        fits.append(fit)
        if len(fits) == 1:
            stages.append(Stage("correlation", pose))
        # The least-squares match is linearised about the rendered pose: it is repeated until that is the estimated one.
        elif context.motion_px(before, pose) < context.options.tolerance_px:
            break
    stages.append(Stage("recognition", pose))
    return MapletRecognition(tuple(stages), tuple(fits), context.clock.seconds)


class MapletNavigator:
    """Matches maplets of the onboard shape, rendered at the predicted pose and Sun, with the image.

    Maplets are square patches of heights and albedo, cut from the onboard shape. All are rendered, each is matched in
    its window by correlation and then by least squares, and the pose is the maximum a posteriori with the prior.

    Use it when
    -----------
    Accuracy and a small data base are wanted (268 kB in ``compare-mismatched``), and the onboard shape is known to
    about a pixel.

    It fails when
    -------------
    Fewer than four maplets correlate by ``correlation_min``, or the rendered maplets are out of view or in the dark. Of
    500 images of ``compare-mismatched`` it failed, or was worse than the prior, in none with exact knowledge and in
    2.20 % with that of a mission. The covariance is too small: mean NEES 13.2 and 13.1, 6 expected. See
    ``tuned``.

    Cost
    ----
    0.91 s an image of ``quickstart``.

    Source
    ------
    Maplets after Gaskell et al. (2008); the matching is ours.
    """

    name: ClassVar[str] = "lmaps"
    version: ClassVar[int] = 7
    options_model: ClassVar[type[SpecModel]] = MapletsOptions

    def __init__(self, scene: MapletScene, options: MapletsOptions) -> None:
        self._scene = scene
        self._options = options

    @classmethod
    def from_options(cls, options: Mapping[str, object], assets: Assets) -> Self:
        """Build from a campaign's options and its maplets."""
        parsed = parse_options(MapletsOptions, options, cls.name)
        database = typed_product(assets, PRODUCT, parsed.maplets, MapletDatabase, cls.name)
        mesh = database.mesh()
        renderer = assets.mesh_renderer(mesh, parsed.samples_per_pixel)
        return cls(MapletScene(database, renderer, assets.mesh_renderer(mesh), mesh.vertices_m), parsed)

    def recognise(self, frame: Frame, camera: Camera) -> MapletRecognition:
        """Recognise the maplets of a frame and return all intermediate results."""
        return recognise(frame, camera, self._scene, self._options)

    def estimate(self, observation: Observation, *, rng: np.random.Generator) -> Estimate:
        """Estimate the pose; ``rng`` is not used."""
        del rng
        found = self.recognise(observation.frame, observation.camera)
        reached = Estimate(
            "failed", found.failure, stages=found.stages, diagnostics=_diagnostics(found), timings_s=found.timings_s
        )
        if found.failure:
            return reached
        fit = found.fits[-1]
        covariance = fit.posterior.covariance
        calibration = calibration_in_posterior(observation, fit.posterior.T_cam_body, covariance)
        return replace(
            reached,
            status="ok",
            pose=fit.posterior.T_cam_body,
            covariance=covariance + calibration,
            bound=fit.posterior.bound,
            details={"landmarks": maplet_table(fit, self._scene.database, observation.camera)},
        )


def _diagnostics(result: MapletRecognition) -> dict[str, float | int | str]:
    if not result.fits:
        return {}
    last = result.fits[-1]
    return {
        "n_landmarks": len(last.found),
        "rounds": len(result.fits),
        "correlation": float(np.median(last.found.correlation)),
        "redundancy": float(last.found.shared.sum(axis=1).mean()),
        **last.posterior.quality,
    }

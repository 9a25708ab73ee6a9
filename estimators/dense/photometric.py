"""The estimator ``photometric``: the pose whose rendering is the image."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from estimators.contract import Assets, Estimate, ImageRenderer, Stage
from estimators.dense.gauss_newton import Fit, PriorTerm, fit_level, inverse
from estimators.dense.options import PhotometricOptions
from estimators.landmark.alignment import correlation_pair
from estimators.landmark.centroid import MeshView, align_translation
from estimators.landmark.database import LandmarkDatabase
from estimators.landmark.recognizer import PRODUCT
from estimators.landmark.signal import extract_signal
from estimators.landmark.stopwatch import Stopwatch
from estimators.options import parse_options
from scenarios.errors import BoresightError
from scenarios.geometry import Camera, Pose, TriangleMesh
from scenarios.observation import Frame, Observation

FloatArray = NDArray[np.float64]


class PhotometricEstimator:
    """Aligns renderings of the onboard shape with the image, coarse to fine, maximum a posteriori."""

    name: ClassVar[str] = "photometric"
    version: ClassVar[int] = 1

    def __init__(self, renderer: ImageRenderer, size_m: float, options: PhotometricOptions) -> None:
        self._renderer = renderer
        self._size_m = size_m
        self._options = options

    @classmethod
    def from_options(cls, options: Mapping[str, object], assets: Assets) -> Self:
        """Build from a campaign's options and the onboard shape."""
        parsed = parse_options(PhotometricOptions, options, cls.name)
        mesh = assets.shape() if parsed.shape == "onboard" else _landmark_mesh(parsed, assets)
        size_m = float(np.median(np.linalg.norm(mesh.vertices_m, axis=1)))
        return cls(assets.mesh_renderer(mesh, parsed.samples_per_pixel), size_m, parsed)

    def estimate(self, observation: Observation, *, rng: np.random.Generator) -> Estimate:
        """Estimate the pose of each frame on its own; the first frame that fails fails the whole.

        Stages, diagnostics and timings are those of the last frame; nothing is drawn at random.
        """
        del rng
        if not observation.frames:
            return Estimate("failed", "the observation holds no image")
        clock = Stopwatch()
        fits: list[Fit] = []
        stages: list[Stage] = []
        for frame in observation.frames:
            stages = []
            fit = self._fit(frame, observation.camera, clock, stages)
            if isinstance(fit, str):
                return Estimate("failed", fit, stages=tuple(stages), timings_s=clock.seconds)
            fits.append(fit)
        bounds = tuple(inverse(fit.information) for fit in fits)
        return Estimate(
            "ok",
            poses=tuple(fit.T_cam_body for fit in fits),
            covariances=bounds,
            bounds=bounds,
            stages=tuple(stages),
            diagnostics={"correlation": fits[-1].correlation, "steps": fits[-1].steps},
            timings_s=clock.seconds,
        )

    def _fit(self, frame: Frame, camera: Camera, clock: Stopwatch, stages: list[Stage]) -> Fit | str:
        """Fit one frame, or say why not; the poses on the way are added to ``stages``."""
        if frame.image.shape != (camera.height_px, camera.width_px):
            expected = (camera.height_px, camera.width_px)
            raise BoresightError(f"the image has shape {frame.image.shape}, but the camera's is {expected}")
        if not np.isfinite(frame.image).all():
            return "the image holds NaN or infinite pixels"
        observed = extract_signal(frame.image)
        if observed.empty:
            return "the image is black: nothing above its background"
        view = MeshView(camera, self._renderer, frame.sun_dir_cam)
        start = frame.prior_T_cam_body
        alignment = align_translation(
            observed.image, start, view, correlation_pair, self._options.alignment_loop, clock
        )
        if alignment.failure:
            return alignment.failure
        stages.append(Stage("alignment", alignment.T_cam_body))
        prior = PriorTerm(start, inverse(frame.prior_covariance))
        with clock("photometric"):
            fit = self._levels(observed.image, alignment.T_cam_body, view, prior, stages)
        if not fit.correlation >= self._options.correlation_min:
            return f"the rendering does not look like the image: correlation {fit.correlation:.2f}"
        return fit

    def _levels(
        self, observed: NDArray[np.float32], start: Pose, view: MeshView, prior: PriorTerm, stages: list[Stage]
    ) -> Fit:
        pose, steps, fit = start, 0, None
        for level in self._options.levels:
            fit = fit_level(observed, pose, view, prior, self._size_m, level, self._options)
            pose, steps = fit.T_cam_body, steps + fit.steps
            stages.append(Stage(f"level-{level.reduction}", pose))
        if fit is None:
            raise BoresightError("photometric: levels: there is none")
        return Fit(fit.T_cam_body, fit.information, fit.correlation, steps)


def _landmark_mesh(options: PhotometricOptions, assets: Assets) -> TriangleMesh:
    database = assets.product(PRODUCT, options.database.model_dump(mode="json"))
    if not isinstance(database, LandmarkDatabase):
        raise BoresightError(f"{PhotometricEstimator.name}: the product {PRODUCT!r} is a {type(database).__name__}")
    return database.mesh()

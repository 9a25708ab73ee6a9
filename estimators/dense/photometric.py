"""The estimator ``photometric``: the pose at which a rendering of the shape fits the image."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import Field

from boresight.estimators.contract import Assets, Estimate, ImageRenderer, Stage, Stopwatch
from boresight.estimators.dense.gauss_newton import (
    Registration,
    RegistrationOptions,
    available_gradient,
    inverse,
    register,
)
from boresight.estimators.landmark.alignment import MeshView
from boresight.estimators.landmark.database import DatabaseOptions
from boresight.estimators.landmark.recognizer import landmark_database
from boresight.estimators.landmark.signal import observed_signal
from boresight.estimators.options import parse_options
from boresight.scenarios.geometry import Camera
from boresight.scenarios.observation import Frame, Observation
from boresight.scenarios.spec.base import SpecModel


class PhotometricOptions(RegistrationOptions):
    """Options of ``photometric``."""

    shape: Literal["onboard", "landmark-mesh"] = Field(
        "onboard", description="The full shape that the spacecraft carries, or the mesh of its landmark data base"
    )
    database: DatabaseOptions = DatabaseOptions()
    samples_per_pixel: Literal[1, 4, 9, 16] = Field(4, description="Samples of a rendered pixel, on a regular grid")


class PhotometricEstimator:
    """Registers renderings of the onboard shape with the image, from coarse to fine, maximum a posteriori.

    Gauss-Newton steps minimise the difference of both band-passed images, with Huber's loss and the prior. The
    derivatives are those of the renderer, or differences of renderings.

    Use it when
    -----------
    The onboard shape is good, no landmarks are wanted, and a second of processor time an image is available.

    It fails when
    -------------
    The rendering goes out of view or into the dark, or correlates with the image by less than ``correlation_min``. Of
    500 images of ``compare-mismatched`` it failed, or was worse than the prior, in none with exact knowledge and in
    4.20 % with that of a mission. The covariance is too small: mean NEES 42.0 and 40.6, 6 expected.

    Cost
    ----
    0.77 s an image of ``quickstart``.

    Source
    ------
    Ours.
    """

    name: ClassVar[str] = "photometric"
    version: ClassVar[int] = 3
    options_model: ClassVar[type[SpecModel]] = PhotometricOptions

    def __init__(self, renderer: ImageRenderer, size_m: float, options: PhotometricOptions) -> None:
        self._renderer = renderer
        self._size_m = size_m
        self._options = options

    @classmethod
    def from_options(cls, options: Mapping[str, object], assets: Assets) -> Self:
        """Build from a campaign's options and the onboard shape."""
        parsed = parse_options(PhotometricOptions, options, cls.name)
        if parsed.shape == "onboard":
            mesh = assets.shape()
        else:
            mesh = landmark_database(parsed.database, assets, cls.name).mesh()
        size_m = float(np.median(np.linalg.norm(mesh.vertices_m, axis=1)))
        renderer = assets.mesh_renderer(mesh, parsed.samples_per_pixel)
        available_gradient(parsed.gradient, renderer)
        return cls(renderer, size_m, parsed)

    def estimate(self, observation: Observation, *, rng: np.random.Generator) -> Estimate:
        """Estimate the pose; ``rng`` is not used."""
        del rng
        clock = Stopwatch()
        found = self._register(observation.frame, observation.camera, clock)
        if isinstance(found, str):
            return Estimate("failed", found, timings_s=clock.seconds)
        if found.failure:
            return Estimate("failed", found.failure, stages=self._stages(found), timings_s=clock.seconds)
        last = found.fits[-1]
        bound = inverse(last.information)
        calibration = observation.calibration_covariance(last.T_cam_body)
        return Estimate(
            "ok",
            pose=last.T_cam_body,
            covariance=bound + calibration,
            bound=bound,
            stages=self._stages(found),
            diagnostics={
                "correlation": last.correlation,
                "steps": sum(fit.steps for fit in found.fits),
                "masked_share": last.masked_share,
            },
            timings_s=clock.seconds,
        )

    def _register(self, frame: Frame, camera: Camera, clock: Stopwatch) -> Registration | str:
        """Register the frame, or return the reason why it cannot be registered."""
        observed = observed_signal(frame, camera)
        if isinstance(observed, str):
            return observed
        view = MeshView(camera, self._renderer, frame.sun_dir_cam)
        return register(observed, frame, view, self._size_m, self._options, clock)

    def _stages(self, found: Registration) -> tuple[Stage, ...]:
        if found.shift.failure:
            return ()
        levels = zip(self._options.levels, found.fits, strict=False)  # a failure may have ended it early
        fitted = (Stage(f"level-{level.reduction}", fit.T_cam_body) for level, fit in levels)
        return (Stage("alignment", found.shift.T_cam_body), *fitted)

"""The estimators by registration of a rendering with the whole image.

``photometric`` returns the pose at which a rendering of the shape fits the image; ``whole-image`` starts the
recognition of landmarks there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from boresight.estimators.contract import Assets, Estimate, ImageRenderer, Stage, Stopwatch
from boresight.estimators.dense.gauss_newton import (
    STAGE,
    LevelOptions,
    Registration,
    RegistrationOptions,
    available_gradient,
    inverse,
    register,
)
from boresight.estimators.landmark.alignment import Alignment, MeshView
from boresight.estimators.landmark.recognizer import (
    LandmarkRecognizer,
    MeshAligner,
    PoseOptions,
    RecognitionOptions,
    ShapeOptions,
    landmark_database,
    rendered_mesh,
    shape_renderer,
)
from boresight.estimators.landmark.signal import observed_signal
from boresight.estimators.options import parse_options
from boresight.estimators.prior import calibration_in_posterior
from boresight.scenarios.geometry import Camera
from boresight.scenarios.observation import Frame, Observation
from boresight.scenarios.spec.base import SpecModel


class PhotometricOptions(ShapeOptions, RegistrationOptions):
    """Options of ``photometric``."""

    samples_per_pixel: Literal[1, 4, 9, 16] = Field(4, description="Samples of a rendered pixel, on a regular grid")


class PhotometricEstimator:
    """Registers renderings of the onboard shape with the image, from coarse to fine, maximum a posteriori.

    Gauss-Newton steps minimise the difference of both band-passed images, with Huber's loss and the prior. The
    derivatives are those of the renderer, or differences of renderings. Renderings are cut where the detector is full.

    Use it when
    -----------
    The onboard shape is good, no landmarks are wanted, and a second of processor time an image is available.

    It fails when
    -------------
    The rendering goes out of view or into the dark, or correlates with the image by less than ``correlation_min``; or
    the frame cuts the body, and shifted images correlate nearly as well (``sharpness_min``, ``correlation_sure``). Of
    500 images of ``compare-mismatched`` it failed, or was worse than the prior, in none with exact knowledge and in
    3.80 % with that of a mission. The covariance is too large with exact knowledge, and too small with that of a
    mission: mean NEES 1.2 and 9.3, 6 expected. See ``tuned``.

    Cost
    ----
    0.77 s an image of ``quickstart``.

    Source
    ------
    Ours.
    """

    name: ClassVar[str] = "photometric"
    version: ClassVar[int] = 13
    options_model: ClassVar[type[SpecModel]] = PhotometricOptions

    def __init__(self, renderer: ImageRenderer, size_m: float, options: PhotometricOptions) -> None:
        self._renderer = renderer
        self._size_m = size_m
        self._options = options

    @classmethod
    def from_options(cls, options: Mapping[str, object], assets: Assets) -> Self:
        """Build from a campaign's options and the onboard shape."""
        parsed = parse_options(PhotometricOptions, options, cls.name)
        mesh = rendered_mesh(parsed, assets, cls.name)
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
        calibration = calibration_in_posterior(observation, last.T_cam_body, bound)
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
                **({} if last.sharpness is None else {"sharpness": last.sharpness}),
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


_SAMPLES_PER_PIXEL = 4
# The facets of the mesh are a dozen pixels wide: finer levels improve the rotation little and double the time.
_MESH_REGISTRATION = RegistrationOptions(
    levels=(
        LevelOptions(reduction=8),
        LevelOptions(reduction=4, background_px=6.0),
    ),
    correlation_min=0.0,
    sharpness_min=0.0,
)


class WholeImageOptions(RecognitionOptions):
    """Options of ``whole-image``."""

    registration: RegistrationOptions = _MESH_REGISTRATION
    pose: PoseOptions = Field(
        PoseOptions(match_d2_max=16.0),
        description="As in landmark-harris, but with a narrower search of 4 sigma, as the initial pose is better",
    )


class WholeImageRecognizer(LandmarkRecognizer):
    """The recognition of ``landmark-harris``, started from the pose at which the rendered mesh fits the whole image.

    The mesh of the landmarks is translated and rotated until its rendering fits the image. Landmarks are then first
    predicted with the estimated attitude instead of the prior's.

    Use it when
    -----------
    The data base is that of ``landmark-harris``, and the prior's attitude error moves landmarks by more than their
    spacing.

    It fails when
    -------------
    As ``landmark-harris``; and the mesh goes out of view or into the dark during the registration. Of 500 images of
    ``compare-mismatched`` it failed, or was worse than the prior, in 10.6 % with exact knowledge and in 54.8 % with
    that of a mission.

    Cost
    ----
    0.29 s an image of ``quickstart``.

    Source
    ------
    Rowell et al. (2015), section 6, propose to align the whole image; the registration is ours, the recognition that of
    their section 3.
    """

    name: ClassVar[str] = "whole-image"
    version: ClassVar[int] = 10
    options_model: ClassVar[type[SpecModel]] = WholeImageOptions

    @classmethod
    def from_options(cls, options: Mapping[str, object], assets: Assets) -> Self:
        """Build from a campaign's options and its landmark data base."""
        parsed = parse_options(WholeImageOptions, options, cls.name)
        database = landmark_database(parsed.database, assets, cls.name)
        mesh = database.mesh()
        size_m = float(np.median(np.linalg.norm(mesh.vertices_m, axis=1)))
        renderer = assets.mesh_renderer(mesh, _SAMPLES_PER_PIXEL)
        available_gradient(parsed.registration.gradient, renderer)
        shape = shape_renderer(parsed, assets)
        return cls(database, renderer, parsed, registration_aligner(parsed.registration, size_m), shape)


def registration_aligner(options: RegistrationOptions, size_m: float) -> MeshAligner:
    """Return the alignment that registers the rendering of a mesh of radius ``size_m`` with the image."""

    def align(observed: NDArray[np.float32], frame: Frame, view: MeshView, clock: Stopwatch) -> Alignment:
        found = register(observed, frame, view, size_m, options, clock)
        failure = found.shift.failure or found.failure
        return replace(found.shift, T_cam_body=found.T_cam_body, failure=failure)

    return MeshAligner(STAGE, align)

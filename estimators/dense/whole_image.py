"""The estimator ``whole-image``: the paper's recognition, from the pose at which the rendered mesh fits the image."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from boresight.estimators.contract import Assets, Stopwatch
from boresight.estimators.dense.gauss_newton import (
    STAGE,
    LevelOptions,
    RegistrationOptions,
    available_gradient,
    register,
)
from boresight.estimators.landmark.alignment import Alignment, MeshView
from boresight.estimators.landmark.recognizer import (
    LandmarkRecognizer,
    MeshAligner,
    PoseOptions,
    RecognitionOptions,
    landmark_database,
    shape_renderer,
)
from boresight.estimators.options import parse_options
from boresight.scenarios.observation import Frame
from boresight.scenarios.spec.base import SpecModel

_SAMPLES_PER_PIXEL = 4
# The facets of the mesh are a dozen pixels wide: finer levels improve the rotation little and double the time.
_MESH_REGISTRATION = RegistrationOptions(
    levels=(
        LevelOptions(reduction=8, iterations=6),
        LevelOptions(reduction=4, background_px=6.0, iterations=6),
    ),
    correlation_min=0.0,
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
    ``compare-mismatched`` it failed, or was worse than the prior, in 14.0 % with exact knowledge and in 54.8 % with
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
    version: ClassVar[int] = 3
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

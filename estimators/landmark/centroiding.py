"""The estimator ``centroid``: brightness centroiding alone, section 3.2 without landmark recognition."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Self

import numpy as np

from boresight.estimators.contract import Assets, Estimate, ImageRenderer, Stage, Stopwatch
from boresight.estimators.landmark.alignment import (
    Alignment,
    AlignmentOptions,
    MeshView,
    align_translation,
    centroid_pair,
)
from boresight.estimators.landmark.database import DatabaseOptions
from boresight.estimators.landmark.recognizer import landmark_database
from boresight.estimators.landmark.signal import observed_signal
from boresight.estimators.options import parse_options
from boresight.scenarios.geometry import Camera
from boresight.scenarios.observation import Frame, Observation
from boresight.scenarios.spec.base import SpecModel


class CentroidOptions(SpecModel):
    """Options of ``centroid``."""

    database: DatabaseOptions = DatabaseOptions()
    alignment_loop: AlignmentOptions = AlignmentOptions()


class CentroidAligner:
    """Shifts the prior until the brightness centroids of the rendered landmark mesh and of the image coincide.

    The position across the line of sight is corrected. Attitude and range stay those of the prior, and there is no
    covariance.

    Use it when
    -----------
    The whole body is in the image, and the position across the line of sight is enough; or to measure the first stage
    of ``landmark-harris`` by itself.

    It fails when
    -------------
    The image holds no signal, or the rendered mesh is out of view or in the dark. The centroid is biased where the
    onboard reflectance or direction to the Sun is wrong, where much of the body is dark, and where part of it is
    outside the image.

    Cost
    ----
    0.05 s an image of ``quickstart``.

    Source
    ------
    Rowell et al. (2015), section 3.2, equations (11) to (13).
    """

    name: ClassVar[str] = "centroid"
    version: ClassVar[int] = 2
    options_model: ClassVar[type[SpecModel]] = CentroidOptions

    def __init__(self, renderer: ImageRenderer, options: CentroidOptions) -> None:
        self._renderer = renderer
        self._options = options

    @classmethod
    def from_options(cls, options: Mapping[str, object], assets: Assets) -> Self:
        """Build from a campaign's options and its landmark data base."""
        parsed = parse_options(CentroidOptions, options, cls.name)
        database = landmark_database(parsed.database, assets, cls.name)
        return cls(assets.mesh_renderer(database.mesh()), parsed)

    def estimate(self, observation: Observation, *, rng: np.random.Generator) -> Estimate:
        """Estimate the pose by shifting the prior.

        Diagnostics are ``centroid_du_px``, ``centroid_dv_px`` and their length ``centroid_offset_px`` (observed minus
        rendered, both at the prior pose), ``extent_px`` (longer side of the observed body's bounding box),
        ``diameter_px`` (of the disc with the observed body's area) and ``centroid_iterations``. ``rng`` is not used.
        """
        del rng
        clock = Stopwatch()
        alignment, extent = self.align(observation.frame, observation.camera, clock)
        ok = not alignment.failure
        offset: dict[str, float] = {}
        if alignment.steps:
            du, dv = (float(value) for value in alignment.steps[0].observed_px - alignment.steps[0].rendered_px)
            offset = {"centroid_du_px": du, "centroid_dv_px": dv, "centroid_offset_px": float(np.hypot(du, dv))}
            offset["centroid_iterations"] = float(len(alignment.steps))
        return Estimate(
            status="ok" if ok else "failed",
            reason=alignment.failure,
            pose=alignment.T_cam_body if ok else None,
            stages=(Stage("centroid", alignment.T_cam_body),) if ok else (),
            diagnostics={**offset, **extent},
            timings_s=clock.seconds,
        )

    def align(self, frame: Frame, camera: Camera, clock: Stopwatch) -> tuple[Alignment, dict[str, float]]:
        """Align the frame; also return the diagnostics of the observed body's size.

        Raise BoresightError if the image is not of the camera's size.
        """
        prior = frame.prior_T_cam_body
        observed = observed_signal(frame, camera, clock)
        if isinstance(observed, str):
            return Alignment(prior, (), observed), {}
        view = MeshView(camera, self._renderer, frame.sun_dir_cam)
        options = self._options.alignment_loop
        alignment = align_translation(observed, prior, view, centroid_pair, options, clock)
        rows, columns = np.nonzero(observed)
        extent_px = float(max(np.ptp(rows), np.ptp(columns)) + 1)
        return alignment, {"extent_px": extent_px, "diameter_px": float(np.sqrt(4.0 / np.pi * len(rows)))}

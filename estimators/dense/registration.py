"""Register a rendered shape with an image: a shift, then all six parameters from coarse to fine."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.estimators.contract import Stopwatch
from boresight.estimators.dense.gauss_newton import LevelFit, RegistrationOptions, fit_level, inverse
from boresight.estimators.landmark.alignment import Alignment, MeshView, align_translation, correlation_pair
from boresight.estimators.landmark.pose.posterior import PosePrior
from boresight.estimators.prior import floor_variances
from boresight.scenarios.geometry import Pose
from boresight.scenarios.observation import Frame

STAGE = "registration"


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
    # The prior is that of the frame, not shifted: the shift comes from the same image.
    prior = PosePrior(start, inverse(floor_variances(frame.prior_covariance)))
    fits: list[LevelFit] = []
    for level in options.levels:
        with clock(STAGE):
            begin = fits[-1].T_cam_body if fits else shift.T_cam_body
            fits.append(fit_level(observed, begin, view, prior, size_m, level, options))
        if not np.isfinite(fits[-1].correlation):
            break
    return Registration(shift, tuple(fits), _failure(fits[-1].correlation, options.correlation_min))


def _failure(correlation: float, least: float) -> str:
    if not np.isfinite(correlation):
        return "the rendered mesh went out of view or into the dark"
    if correlation >= least:
        return ""
    return f"the rendering does not look like the image: correlation {correlation:.2f}"

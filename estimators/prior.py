"""The control: what the prior alone is worth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Self

import numpy as np

from estimators.contract import Assets, Estimate
from estimators.options import parse_options
from scenarios.observation import Observation
from scenarios.spec.base import SpecModel


class PriorOptions(SpecModel):
    """The prior has no options."""


class PriorEstimator:
    """Returns each frame's prior pose and covariance as they are, whatever the image shows."""

    name: ClassVar[str] = "prior"
    version: ClassVar[int] = 1

    @classmethod
    def from_options(cls, options: Mapping[str, object], assets: Assets) -> Self:
        """Build; any option is refused."""
        del assets
        parse_options(PriorOptions, options, cls.name)
        return cls()

    def estimate(self, observation: Observation, *, rng: np.random.Generator) -> Estimate:
        """Return the prior of each frame."""
        del rng
        return Estimate(
            "ok",
            poses=tuple(frame.prior_T_cam_body for frame in observation.frames),
            covariances=tuple(frame.prior_covariance for frame in observation.frames),
        )

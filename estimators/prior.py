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
    """Returns the prior pose and its covariance as they are, whatever the image shows."""

    name: ClassVar[str] = "prior"
    version: ClassVar[int] = 1

    @classmethod
    def from_options(cls, options: Mapping[str, object], assets: Assets) -> Self:
        """Build; any option is refused."""
        del assets
        parse_options(PriorOptions, options, cls.name)
        return cls()

    def estimate(self, observation: Observation, *, rng: np.random.Generator) -> Estimate:
        """Return the prior."""
        del rng
        frame = observation.frame
        return Estimate("ok", pose=frame.prior_T_cam_body, covariance=frame.prior_covariance)

"""Artefacts of a camera, each a section of ``detector``. All are absent by default."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from boresight.scenarios.spec.base import SpecModel, optional, rule
from boresight.scenarios.spec.vectors import Vector3


class WingSpec(SpecModel):
    """A further Gaussian of the point spread function, wider than ``psf_sigma_px``."""

    share: float = Field(gt=0, lt=1, description="Share of the light of a point")
    sigma_px: float = Field(gt=0, le=100, description="Standard deviation")


class StrayLightSpec(SpecModel):
    """Light beside the image: a share of that in the frame, and a linear background."""

    veil_share: float = Field(
        0.0, ge=0, lt=1, description="Share of the light in the frame that is spread evenly over it"
    )
    gradient_e_per_s: float = Field(
        0.0,
        ge=0,
        le=1e9,
        description="Linear background: electrons a second at the edge or corner of the frame on the side of the Sun,"
        " 0 at the opposite one. The level does not depend on the angle to the Sun",
    )

    @rule
    def _something(self) -> None:
        if not self.veil_share and not self.gradient_e_per_s:
            raise ValueError("both are 0: give veil_share or gradient_e_per_s, or leave the section out")


class MotionSpec(SpecModel):
    """Motion of the camera during the exposure, at constant rates: it smears the image.

    The true pose of an image is that at the middle of the exposure of the middle row.
    """

    rate_deg_s: Vector3 | None = optional("Angular velocity of the camera in camera axes, drawn for each image")
    trajectory: bool = Field(
        False,
        description="Whether the camera also moves with the velocity of viewpoint.trajectory, its attitude inertially"
        " fixed but for rate_deg_s",
    )
    row_delay_s: float | None = optional(
        "Rolling shutter: time between the exposures of a row and of the next", gt=0, le=10
    )

    @rule
    def _something(self) -> None:
        still = self.rate_deg_s is None or not np.any(self.rate_deg_s.second_moment)
        if still and not self.trajectory:
            raise ValueError(
                "nothing moves: give rate_deg_s other than 0, or trajectory: true, or leave the section out"
            )


class PixelsSpec(SpecModel):
    """Differences of pixels, drawn once from a seed: all images of a camera have the same."""

    seed: int = Field(0, ge=0, le=2**32 - 1, description="Seed of all that differs")
    response_sigma: float = Field(0.0, ge=0, le=0.3, description="Flat field: RMS of the relative response of pixels")
    vignetting: float = Field(
        0.0,
        ge=0,
        le=1,
        description="Flat field: share of the light that the corners lose. The loss grows with the square of the"
        " distance from the middle of the frame",
    )
    dead_share: float = Field(0.0, ge=0, le=1, description="Share of pixels that no light reaches")
    hot_share: float = Field(0.0, ge=0, le=1, description="Share of pixels with a further dark current")
    hot_e_per_s: float = Field(
        10_000.0, gt=0, le=1e9, description="Mean dark current of hot pixels, exponentially distributed"
    )

    @rule
    def _something(self) -> None:
        if not self.stated("response_sigma", "vignetting", "dead_share", "hot_share"):
            raise ValueError(
                "all pixels are alike: give response_sigma, vignetting, dead_share or hot_share,"
                " or leave the section out"
            )
        if self.stated("hot_e_per_s") and not self.hot_share:
            raise ValueError("hot_e_per_s: there are no hot pixels: give hot_share too, or leave it out")
        if self.stated("seed") and not self.stated("response_sigma", "dead_share", "hot_share"):
            raise ValueError("seed: vignetting is not drawn: leave the seed out")
        if self.dead_share + self.hot_share > 1.0:
            raise ValueError(f"dead_share {self.dead_share:g} and hot_share {self.hot_share:g} are above 1 together")


class CosmicRaysSpec(SpecModel):
    """Straight tracks of charged particles, at random places and in random directions, in each image anew."""

    hits_per_s: float = Field(gt=0, le=1e6, description="Mean number of tracks a second whose middle is in the frame")
    e_per_px: float = Field(1000.0, gt=0, le=1e9, description="Electrons on each pixel length of a track")
    length_px: float = Field(5.0, ge=0.01, le=1000, description="Mean length of a track, exponentially distributed")

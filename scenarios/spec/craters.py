"""Craters section: a population whose every member is known, on a surface that is fine where a camera looks."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from scenarios.spec.body import RoughnessSpec, SizesSpec


class CratersSpec(SizesSpec):
    """Craters on a smoothed shape; their cumulative number follows N(>D) ~ D**-exponent, the same seed gives the same.

    The defaults lie within what is known of Eros: depth over diameter 0.13 with a spread of 0.03 (Robinson et al. 2002,
    Meteorit. Planet. Sci. 37, 1651), 0.2 for a fresh simple crater and a rim of 0.036 diameters (Pike 1977, Impact and
    Explosion Cratering, 489).
    """

    seed: int = Field(0, ge=0)
    count: int = Field(12_000, ge=1, le=100_000)
    min_diameter_m: float = Field(80.0, gt=0, description="Smallest diameter")
    max_diameter_m: float = Field(5000.0, gt=0, description="Largest diameter")
    exponent: float = Field(2.0, gt=0, lt=10, description="Slope of the cumulative size distribution")
    depth_ratio: tuple[float, float] = Field(
        (0.08, 0.2), description="Depth over diameter, rim to floor: of the most degraded and of the freshest"
    )
    rim_ratio: float = Field(0.036, ge=0, le=0.1, description="Height of a fresh rim over the diameter")
    known_diameter_m: float = Field(150.0, gt=0, description="Smallest diameter of which a rim is listed in the truth")
    edge_m: float = Field(10.0, gt=0, description="Longest edge of the facets where a camera looks, before the relief")
    roughness: RoughnessSpec | None = Field(
        RoughnessSpec(rms_m=8.0, hurst=0.9, max_wavelength_m=1200.0, min_wavelength_m=40.0),
        description="Relief without craters, on top of them",
    )

    @model_validator(mode="after")
    def _depths_in_order(self) -> Self:
        low, high = self.depth_ratio
        if not 0.0 < low <= high <= 0.4:
            raise ValueError(f"depth_ratio {[low, high]} is not [least, most] within 0 to 0.4")
        return self

    @model_validator(mode="after")
    def _mesh_carries_craters(self) -> Self:
        if self.edge_m > 0.25 * self.min_diameter_m:
            raise ValueError(f"edge_m {self.edge_m:g} is too coarse for craters of min_diameter_m: at most a quarter")
        return self

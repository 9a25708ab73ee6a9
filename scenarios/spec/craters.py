"""Crater sections: known populations on a cratered surface, and pairs of views with crater detections."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from boresight.scenarios.spec.base import SpecModel, deviation, length, rule
from boresight.scenarios.spec.body import RoughnessSpec, SizesSpec
from boresight.scenarios.spec.distribution import Uniform

LISTED_PX = 6.0
"""Diameter of the smallest listed crater by default: detectors find craters from 9 px on, and a match may be smaller by
0.36 in the logarithm of the radius, which is 6.3 px."""


class PlaneCratersSpec(SizesSpec):
    """Plane rims on the shape, uniform over its area; cumulative number N(>D) ~ D**-exponent."""

    count: int = Field(ge=1, le=100_000, description="Craters on the whole body")
    min_diameter_m: float = length(230.0, "Smallest diameter", body=0.007, gt=0)
    max_diameter_m: float = length(5000.0, "Largest diameter", body=0.15, gt=0)
    exponent: float = Field(1.8, gt=0, lt=10, description="Slope of the cumulative size distribution")
    seed: int = Field(0, ge=0, description="Seed of their places and sizes")


class DetectionErrorSpec(SpecModel):
    """Error model of a simulated detector; standard deviations."""

    centre_px: float = deviation(0.35, "a coordinate of a rim's centre", ge=0)
    centre_radii: float = Field(0.04, ge=0, description="Part of that error that grows with the radius, in radii")
    axes_px: float = deviation(0.0, "a semi-axis", ge=0)
    axes_ratio: float = deviation(0.05, "the logarithm of a semi-axis", ge=0)
    recall: float = Field(0.8, gt=0, le=1, description="Probability that a visible crater is detected")
    false_share: float = Field(0.05, ge=0, lt=1, description="Share of the detections that are no crater")
    least_radius_px: float = Field(6.0, ge=0, description="Radius of the smallest crater that is detected")
    height_m: float = length(
        20.0, "Standard deviation of a crater's height above the a priori shape", body=0.0006, ge=0
    )


class RenderedLooksSpec(SpecModel):
    """Rendered images of the scenario's craters for crater detectors."""

    most_detections: int = Field(20, ge=1, description="Detections of an image at most, the most confident ones")


class CraterPairsSpec(SpecModel):
    """Two views of one place of the body from one range, each with the pose error of the scenario.

    Either craters are drawn here and detected by geometry, or images of the scenario's ``craters`` are rendered and
    each matcher gets the detections of the detector named in its options.
    """

    alternatives: ClassVar = (("craters", "images"),)

    range_m: float = Field(gt=0, description="Distance of both cameras from the place")
    view_deg: Uniform = Field(description="Between the directions to the two cameras")
    sun_deg: Uniform = Field(description="Between the two directions of the Sun")
    emission_deg: Uniform = Field(Uniform(uniform=(0.0, 35.0)), description="Emission angle at the place, first look")
    incidence_deg: Uniform = Field(
        Uniform(uniform=(25.0, 65.0)), description="Incidence angle at the place, first look"
    )
    aim_sigma_m: float = length(
        1000.0, "Standard deviation of each coordinate of the point that a camera points at", px=50, ge=0
    )
    craters: PlaneCratersSpec | None = Field(None, description="Plane rims, detected by geometry without any image")
    errors: DetectionErrorSpec = Field(DetectionErrorSpec(), description="Errors of detections by geometry")
    images: RenderedLooksSpec | None = Field(None, description="Rendered looks, {} for the defaults")

    @rule
    def _angles(self) -> None:
        for key in ("view_deg", "sun_deg", "emission_deg", "incidence_deg"):
            low, high = getattr(self, key).uniform
            if low < 0.0 or high > 90.0:
                raise ValueError(f"{key} {[low, high]} is not within [0, 90]")


class CraterReliefSpec(RoughnessSpec):
    """Fractal relief on top of craters."""

    rms_m: float = length(8.0, "RMS height of the whole field", body=0.00024, ge=0)
    hurst: float = Field(0.9, gt=0, lt=1, description="Hurst exponent: the larger, the smoother at small scales")
    max_wavelength_m: float = length(1200.0, "Longest scale of the relief", body=0.035, gt=0)
    min_wavelength_m: float = length(40.0, "Shortest scale of the relief", body=0.0012, gt=0)


class CratersSpec(SizesSpec):
    """Craters on a smoothed shape; their cumulative number follows N(>D) ~ D**-exponent, the same seed gives the same.

    The defaults are consistent with Eros: depth over diameter 0.13 with a spread of 0.03 (Robinson et al. 2002,
    Meteorit. Planet. Sci. 37, 1651), 0.2 for a fresh simple crater and a rim of 0.036 diameters (Pike 1977, Impact and
    Explosion Cratering, 489).
    """

    seed: int = Field(0, ge=0, description="Seed of the population")
    count: int = Field(12_000, ge=1, le=100_000, description="Craters on the whole body")
    min_diameter_m: float = length(80.0, "Smallest diameter", body=0.0024, gt=0)
    max_diameter_m: float = length(5000.0, "Largest diameter", body=0.15, gt=0)
    exponent: float = Field(2.0, gt=0, lt=10, description="Slope of the cumulative size distribution")
    depth_ratio: tuple[float, float] = Field(
        (0.08, 0.2), description="Depth over diameter, rim to floor: of the most degraded and of the freshest"
    )
    rim_ratio: float = Field(0.036, ge=0, le=0.1, description="Height of a fresh rim over the diameter")
    known_diameter_m: float | None = Field(
        None,
        gt=0,
        description="Smallest diameter of which a rim is listed in the truth; left out: 6 px at the range of the views",
    )
    edge_m: float = length(
        10.0, "Longest edge of the facets where a camera looks, before the relief", body=0.0003, gt=0
    )
    roughness: CraterReliefSpec | None = Field(CraterReliefSpec(), description="Relief without craters, on top of them")

    @property
    def listed_from_m(self) -> float:
        """Smallest diameter of which a rim is listed in the truth, m; a scenario fills it in."""
        if self.known_diameter_m is None:
            raise ValueError("craters.known_diameter_m: missing, and there is no range of views that it follows from")
        return self.known_diameter_m

    def share_from(self, diameter_m: float) -> float:
        """Return the expected share of the population that has a diameter or more."""
        least, most, at = (d**-self.exponent for d in (self.min_diameter_m, self.max_diameter_m, diameter_m))
        return float(min(max((at - most) / (least - most), 0.0), 1.0))

    def unlisted_share(self, diameter_m: float) -> float:
        """Return the expected share of the craters of a diameter or more that are not listed."""
        whole = self.share_from(diameter_m)
        return max(1.0 - self.share_from(self.listed_from_m) / whole, 0.0) if whole else 0.0

    @rule
    def _depths_in_order(self) -> None:
        low, high = self.depth_ratio
        if not 0.0 < low <= high <= 0.4:
            raise ValueError(f"depth_ratio {[low, high]} is not [least, most] within 0 to 0.4")

    @rule
    def _mesh_carries_craters(self) -> None:
        if self.edge_m > 0.25 * self.min_diameter_m:
            raise ValueError(f"edge_m {self.edge_m:g} is too coarse for craters of min_diameter_m: at most a quarter")

"""Orbit section: orbit determination by crater sightings and radiometry, with a priori knowledge."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import Field

from boresight.scenarios.spec.base import SpecModel, deviation, optional, rule
from boresight.scenarios.spec.craters import DetectionErrorSpec, PlaneCratersSpec
from boresight.scenarios.spec.distribution import Direction


class ApproachArcSpec(SpecModel):
    """State at the epoch of a spacecraft that comes nearer; the angles of the arc turn the plane of its motion."""

    range_m: float = Field(gt=0, description="Distance from the centre of mass at the epoch")
    speed_m_s: float = Field(gt=0, description="Speed at the epoch")
    miss_m: float = Field(gt=0, description="Distance at which a straight line would pass the centre of mass")

    @rule
    def _passes_nearer(self) -> None:
        if self.miss_m >= self.range_m:
            raise ValueError(f"miss_m: {self.miss_m:g} is not less than range_m, {self.range_m:g}")

    @property
    def along_m(self) -> float:
        """Distance from the epoch to the closest approach along the straight line."""
        return math.sqrt(self.range_m**2 - self.miss_m**2)


class ArcSpec(SpecModel):
    """Keplerian orbit at the epoch, and length of the arc; inertial axes are the body axes at the epoch."""

    approach: ApproachArcSpec | None = optional(
        "An approach, in place of the semi-major axis, eccentricity and anomaly"
    )

    semi_major_axis_m: float = Field(200_000.0, gt=0, description="NEAR's of March 2000 in Cheng et al. (2003)")
    eccentricity: float = Field(0.02, ge=0, lt=1, description="Eccentricity of the orbit")
    inclination_deg: float = Field(37.0, ge=0, le=180, description="Inclination to the body's equator")
    node_deg: float = Field(60.0, description="Right ascension of the ascending node")
    pericentre_deg: float = Field(0.0, description="From the node to the pericentre")
    anomaly_deg: float = Field(0.0, description="Mean anomaly at the epoch")
    days: float = Field(20.5, gt=0, le=365, description="Length of the arc with data")
    predicted_days: float = Field(3.0, ge=0, le=60, description="Length of the prediction after the arc")

    @rule
    def _has_one_form(self) -> None:
        senseless = self.stated("semi_major_axis_m", "eccentricity", "anomaly_deg")
        if self.approach is not None and senseless:
            raise ValueError(f"{senseless[0]} has no meaning beside approach: leave it out")

    @rule
    def _ends_before_closest_approach(self) -> None:
        if self.approach is not None and 86_400.0 * self.days * self.approach.speed_m_s > self.approach.along_m:
            most = self.approach.along_m / self.approach.speed_m_s / 86_400.0
            digits = 5 - math.floor(math.log10(most))
            raise ValueError(
                f"days: {self.days:.10g} is later than the closest approach: give at most"
                f" {math.floor(most * 10.0**digits) / 10.0**digits:.10g}"  # rounded down, so that it is accepted
            )

    @property
    def ranges_m(self) -> tuple[float, float, float]:
        """Shortest, typical and longest distance of the arc from the centre of mass, m; without gravity on approach."""
        if self.approach is None:
            axis_m = self.semi_major_axis_m
            return axis_m * (1.0 - self.eccentricity), axis_m, axis_m * (1.0 + self.eccentricity)
        left_m = self.approach.along_m - 86_400.0 * self.days * self.approach.speed_m_s
        nearest_m = math.hypot(left_m, self.approach.miss_m)
        return nearest_m, math.sqrt(nearest_m * self.approach.range_m), self.approach.range_m


class AsteroidSpec(SpecModel):
    """Gravity and rotation of the scenario's body, which rotates about its z axis."""

    gm_m3_s2: float = Field(4.463e5, gt=0, description="Gravity parameter; that of Eros")
    gravity_degree: int = Field(
        8, ge=2, le=16, description="Degree of the harmonics: those of the shape at one density, and anomalies"
    )
    anomaly_sigma: float = deviation(
        1e-3, "normalised coefficients of degree 2 and 3 about those of one density", ge=0, lt=1
    )
    rotation_h: float = Field(5.27, gt=0, description="Period of the rotation")


class SunEarthSpec(SpecModel):
    """Constant directions to Sun and Earth, and solar radiation pressure (cannonball model without shadow)."""

    sun_dir: Direction = Field((0.6, 0.0, 0.8), description="Towards the Sun, inertial axes")
    sun_distance_au: float = Field(1.75, gt=0, description="Distance of the body from the Sun")
    earth_dir: Direction = Field((0.75, -0.45, 0.48), description="Towards the Earth, inertial axes")
    area_to_mass_m2_kg: float = Field(0.02, ge=0, description="Area over mass of the spacecraft")
    reflectivity: float = Field(1.3, ge=1, le=2, description="1 where all light is absorbed, 2 where it is thrown back")
    noise_share: float = deviation(0.0, "a coordinate of what nothing models, in solar pressures", ge=0, lt=1)
    noise_days: float = Field(1.0, gt=0, description="Time over which that changes: its autocorrelation falls to 1 / e")


class CraterSightingSpec(SpecModel):
    """Simulated crater sightings in images, with the errors of detection and matching."""

    images: int = Field(963, ge=2, le=5000, description="Spread at random over the arc; 963 in Cheng et al. (2003)")
    craters: int = Field(1600, ge=4, le=20_000, description="Craters on the whole body, uniform over its area")
    per_image: float = Field(
        10.3, gt=0, description="Mean number that is found in an image where as many are in view; 9.6 over all images"
    )
    per_image_shape: float = Field(
        1.2, gt=0, description="Shape of the gamma law of that number: at 1.2 half the images have 7 or fewer"
    )
    emission_max_deg: float = Field(60.0, gt=0, le=90, description="Largest emission angle of a crater that is found")
    incidence_max_deg: float = Field(75.0, gt=0, le=90, description="Largest incidence angle of the same")
    margin_px: float = Field(
        12.0, ge=0, description="Least distance of a sighted crater's centre from the edge of the image"
    )
    noise_px: float = deviation(0.7, "a coordinate of its centre", gt=0)
    wrong_share: float = Field(0.01, ge=0, lt=1, description="Sightings that carry the number of another crater near")
    wrong_within_px: float = Field(
        60.0, gt=0, description="Scale of the distance in the image between a crater and the one whose number it gets"
    )
    merged_share: float = Field(0.0, ge=0, lt=1, description="Craters that share their number with a neighbour")


class PointingSpec(SpecModel):
    """Errors of attitude and camera, drawn once per trial; attitude errors are drawn for each image."""

    attitude_urad: float = deviation(100.0, "an image's attitude about each camera axis", gt=0)
    misalignment_urad: float = deviation(200.0, "the camera's mounting about each axis", ge=0)
    focal_error: float = Field(0.0, ge=0, lt=0.1, description="Relative standard deviation of the focal length")


class RadiometrySpec(SpecModel):
    """Range and Doppler from the Earth, corrected for light time and the station's motion."""

    interval_h: float = Field(1.0, gt=0, description="Time between two records")
    range_sigma_m: float = deviation(10.0, "a range", gt=0)
    range_rate_sigma_m_s: float = deviation(2e-4, "a range rate", gt=0)
    range_bias_sigma_m: float = deviation(50.0, "the bias that all ranges of a trial share", ge=0)


class OrbitKnowledgeSpec(SpecModel):
    """Standard deviations of the a priori knowledge; errors are drawn once per trial."""

    position_m: float = Field(
        1000.0,
        gt=0,
        description="Length of the error of the position at the epoch; that of the velocity is its product with the"
        " mean motion, or on an approach with the speed over the range",
    )
    gm_sigma: float = Field(1e-3, ge=0, lt=1, description="Relative standard deviation of GM")
    light_sigma: float = Field(0.1, ge=0, lt=1, description="Relative standard deviation of the solar pressure")
    pole_sigma_deg: float = deviation(0.0, "the spin axis about each of two axes across it", ge=0, le=90)
    spin_sigma: float = Field(0.0, ge=0, lt=1, description="Relative standard deviation of the spin rate")
    shape_degree: int = Field(
        34, ge=2, le=34, description="Degree of the spherical harmonics of the a priori shape's radius"
    )


class ImagingSpec(SpecModel):
    """Images in which craters are detected and matched, or on an approach the body, instead of numbered sightings."""

    epochs: int = Field(
        240,
        ge=2,
        le=5000,
        description="Epochs at even steps over the arc, on an approach of the logarithm of the range; each has an"
        " image, of craters if lit ground is in view",
    )
    detections: Literal["rendered", "drawn"] = Field(
        "rendered", description="Images of the scenario's craters, or rims of drawn ones projected by geometry"
    )
    control_urad: float = deviation(300.0, "the pointing about the plan, about each axis; telemetry contains it", ge=0)
    craters: PlaneCratersSpec = Field(PlaneCratersSpec(count=600), description="Craters of detections that are drawn")
    errors: DetectionErrorSpec = Field(DetectionErrorSpec(), description="Errors of detections that are drawn")


class OrbitSpec(SpecModel):
    """Orbit determination by craters, or on an approach by the body: true world, measurements, a priori knowledge."""

    arc: ArcSpec = ArcSpec()
    asteroid: AsteroidSpec = AsteroidSpec()
    light: SunEarthSpec = SunEarthSpec()
    sightings: CraterSightingSpec = CraterSightingSpec()
    pointing: PointingSpec = PointingSpec()
    radiometry: RadiometrySpec | None = Field(RadiometrySpec(), description="null for optical data alone")
    knowledge: OrbitKnowledgeSpec = OrbitKnowledgeSpec()
    imaging: ImagingSpec | None = optional("Images that are planned and taken, in place of sightings")

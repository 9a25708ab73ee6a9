"""Reflectance section: BRDF models with the parameters of their sources."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from boresight.scenarios.spec.base import SpecModel


class LambertSpec(SpecModel):
    """Perfectly diffuse reflection: f = albedo / pi."""

    kind: Literal["lambert"] = Field("lambert", description="Name of the law")
    albedo: float = Field(0.3, gt=0, le=1, description="Reflectance of the surface, 0 to 1")


class OrenNayarSpec(SpecModel):
    """Oren and Nayar (1994): rough Lambertian V-cavities."""

    kind: Literal["oren-nayar"] = Field(description="Name of the law")
    albedo: float = Field(0.3, gt=0, le=1, description="Reflectance of a cavity's facets, 0 to 1")
    sigma_deg: float = Field(20.0, ge=0, le=60, description="Standard deviation of the facets' slope")
    form: Literal["full", "qualitative"] = Field(
        "full", description="The paper's full model with interreflection, or its simplified form"
    )


class HapkeSpec(SpecModel):
    """Hapke's bidirectional reflectance with opposition surge and macroscopic roughness.

    The defaults are Itokawa's by Kitazato et al. (2008, Icarus 194, 137), from the near-infrared spectrometer of
    Hayabusa: w = 0.42, asymmetry -0.35 (that is b = 0.35, all backward), B0 = 0.87, h = 0.01, theta_bar = 26 deg.
    """

    kind: Literal["hapke"] = Field(description="Name of the law")
    w: float = Field(0.42, gt=0, lt=1, description="Single scattering albedo")
    b: float = Field(0.35, ge=-1, le=1, description="Asymmetry of each Henyey-Greenstein lobe")
    c: float = Field(1.0, ge=-1, le=1, description="Weight of the lobes: 1 all backward, -1 all forward")
    B0: float = Field(0.87, ge=0, description="Amplitude of the opposition surge")
    h: float = Field(0.01, gt=0, description="Angular width of the opposition surge")
    theta_bar_deg: float = Field(26.0, ge=0, lt=60, description="Mean slope of the macroscopic roughness (1984)")
    H_function: Literal["2002", "1981"] = Field("2002", description="Approximation of Chandrasekhar's H function")


class LommelSeeligerSpec(SpecModel):
    """Lommel and Seeliger: single scattering, I/F = w/4 P(g) mu0 / (mu0 + mu)."""

    kind: Literal["lommel-seeliger"] = Field(description="Name of the law")
    w: float = Field(0.42, gt=0, le=1, description="Single scattering albedo; I/F at the zenith is w/8 P(0)")
    b: float = Field(0.0, gt=-1, lt=1, description="Asymmetry of the Henyey-Greenstein lobes of P; 0 is isotropic")
    c: float = Field(1.0, ge=-1, le=1, description="Weight of the lobes: 1 all backward, -1 all forward")


class McEwenSpec(SpecModel):
    """McEwen's lunar-Lambert law: I/F = A [2 L mu0 / (mu0 + mu) + (1 - L) mu0], L = 1 + L1 g + L2 g^2 + L3 g^3."""

    kind: Literal["mcewen"] = Field(description="Name of the law")
    albedo: float = Field(0.3, gt=0, le=1, description="A: I/F at normal incidence and emission")
    L1_per_deg: float = Field(
        -0.019, description="Coefficient of the phase angle in the weight of the lunar part; the Moon's by default"
    )
    L2_per_deg2: float = Field(2.42e-4, description="Coefficient of the square of the phase angle")
    L3_per_deg3: float = Field(-1.46e-6, description="Coefficient of the cube of the phase angle")


BrdfSpec = Annotated[
    LambertSpec | OrenNayarSpec | HapkeSpec | LommelSeeligerSpec | McEwenSpec, Field(discriminator="kind")
]

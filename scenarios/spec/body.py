"""Body section: shape, surface detail and height errors."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from boresight.scenarios.spec.base import SpecModel, length, optional, rule

EMBEDDED_NAMES = (
    "contact-binary", "sphere", "apophis-sphere", "eros-like", "itokawa-like", "apophis-like", "bennu-like",
    "vesta-like", "didymos-like", "dimorphos-like", "ryugu-like",
)  # fmt: skip
"""Names of the built-in bodies of `scenarios.bodies.embedded`."""

STAND_INS = {
    "itokawa_gaskell_q64.ply": "itokawa-like",
    "itokawa_radar.obj": "contact-binary",
    "eros022540.tab": "eros-like",
    "apophis_lightcurve.obj": "apophis-like",
    "bennu_radar.obj": "bennu-like",
    "images/dawn_fc_vesta/vesta_5002.ply": "vesta-like",
}
"""Built-in bodies that ``--embedded`` takes in place of shape files."""


MOST_FACETS = 21_000_000
"""Facets of a body with its detail, site and local shapes, at most."""

SITE_FACETS = 14.0
"""Facets of a site whose radius is its longest edge; their number grows with the square of the ratio.

Bisection ends between this edge and half of it, so that there may be half as many or twice as many."""


class SizesSpec(SpecModel):
    """A range of diameters."""

    min_diameter_m: float = Field(gt=0, description="Smallest diameter")
    max_diameter_m: float = Field(gt=0, description="Largest diameter")

    @rule
    def _check(self) -> None:
        if self.min_diameter_m > self.max_diameter_m:
            raise ValueError("min_diameter_m is above max_diameter_m")


class BoulderSpec(SizesSpec):
    """Boulders whose cumulative number follows N(>D) ~ D**-exponent."""

    count: int = Field(ge=0, le=2_000_000, description="Boulders on the whole body")
    exponent: float = Field(3.0, gt=0, lt=10, description="Slope of the cumulative size distribution")
    height_ratio: float = Field(0.35, gt=0, le=1, description="Typical height over diameter of the part above ground")


class CraterSpec(SizesSpec):
    """Bowl-shaped craters with raised rims; cumulative number N(>D) ~ D**-exponent."""

    count: int = Field(ge=0, le=200_000, description="Craters on the whole body")
    exponent: float = Field(2.5, gt=0, lt=10, description="Slope of the cumulative size distribution")
    depth_ratio: float = Field(0.12, gt=0, le=0.4, description="Depth over diameter")
    rim_ratio: float = Field(0.03, ge=0, le=0.1, description="Rim height over diameter")


class RoughnessSpec(SpecModel):
    """Fractal relief: a band-limited random field with a Hurst exponent."""

    rms_m: float = Field(ge=0, description="RMS height of the whole field")
    hurst: float = Field(0.8, gt=0, lt=1, description="Hurst exponent: the larger, the smoother at small scales")
    max_wavelength_m: float = length(100.0, "Longest scale of the relief", body=0.2, gt=0)
    min_wavelength_m: float = length(2.0, "Shortest scale of the relief", body=0.004, gt=0)

    @rule
    def _check(self) -> None:
        if self.min_wavelength_m > self.max_wavelength_m:
            raise ValueError("min_wavelength_m is above max_wavelength_m")


class AlbedoSpec(SpecModel):
    """Spatial variation of the albedo: factor 1 + field, clipped to 0.2 to 2."""

    sigma: float = Field(ge=0, le=1, description="RMS of the relative variation")
    wavelength_m: float = length(40.0, "Longest scale of the variation", body=0.08, gt=0)


class RedrawnSpec(SpecModel):
    """Unknown small-scale relief: features of the same statistics at other places."""

    below_m: float = Field(
        gt=0, description="Boulders, craters and wavelengths of the roughness below this are redrawn"
    )
    seed: int = Field(ge=0, description="Seed of these features, instead of the seed of the detail")


class SiteSpec(SpecModel):
    """A place of finer facets, with the relief that they resolve; it fades over the outer fifth of the radius."""

    direction: tuple[float, float, float] = Field(description="From the body's origin to the centre, body frame")
    radius_m: float = Field(gt=0, description="Distance from the centre at which it ends")
    edge_m: float = Field(gt=0, description="Longest edge of its facets, before the relief")

    @rule
    def _check(self) -> None:
        if not any(self.direction):
            raise ValueError("direction has no length")
        if self.radius_m > 1000.0 * self.edge_m:
            raise ValueError("radius_m is above 1000 edge_m, which makes 14 million facets")

    @property
    def facets(self) -> int:
        """About how many facets it has."""
        return round(SITE_FACETS * (self.radius_m / self.edge_m) ** 2)


class DetailSpec(SpecModel):
    """Subdivision of a coarse shape with added relief; the same seed gives the same body."""

    facets: int = Field(
        ge=4,
        le=MOST_FACETS,
        description="At least this many facets, and less than four times as many; 21 million are made at most",
    )
    seed: int = Field(0, ge=0, description="Seed of all relief and albedo of this section")
    boulders: BoulderSpec | None = None
    craters: CraterSpec | None = None
    roughness: RoughnessSpec | None = None
    albedo: AlbedoSpec | None = None
    # Excluded from digests if not given: keeps the digests of bodies without it.
    redrawn: RedrawnSpec | None = optional("Small relief from another seed")
    site: SiteSpec | None = optional("A place, as a landing site, that has finer facets")


class HeightErrorSpec(RoughnessSpec):
    """Random height error: a fractal field along the normals, typical of stereo and shape-from-shading models."""

    rms_m: float = Field(ge=0, description="RMS of the error")
    max_wavelength_m: float = length(30.0, "Longest scale of the error", body=0.06, gt=0)
    min_wavelength_m: float = length(5.0, "Shortest scale of the error", body=0.01, gt=0)
    seed: int = Field(0, ge=0, description="Seed of the error")


class LocalSpec(SpecModel):
    """A finer shape of a part of the surface: an open mesh in the body's frame, onto which the facets are moved."""

    shape: str = Field(description="A file name")
    unit: Literal["m", "km"] = Field("m", description="Unit of the numbers in the file; dsk files are in km")
    format: Literal["auto", "obj", "ply", "pds-plates", "dsk"] = Field("auto", description="Format of the file")
    blend_m: float | None = Field(
        None, gt=0, description="Width within its edge where it fades into the body; left out: a tenth of its own width"
    )
    edge_m: float | None = Field(
        None, gt=0, description="Longest edge of the body's facets there; left out: the mean of its own edges"
    )


class AlbedoMapSpec(SpecModel):
    """Albedo by a grey image of 360 x 180 deg, north up, longitude growing eastward from left to right."""

    file: str = Field(description="PNG or TIFF, 8 or 16 bit, twice as wide as high")
    left_deg: float = Field(-180.0, ge=-360, le=360, description="East longitude of the left edge")
    unity: float | None = Field(
        None, gt=0, description="Pixel value of factor 1 on the reflectance; left out: the mean over the sphere"
    )


class FurtherHeightErrorSpec(HeightErrorSpec):
    """Error of a surface whose heights have an error already; made by rehearsals, no key of a scenario."""

    on: HeightErrorSpec


class BodySpec(SpecModel):
    """A shape file (in the scenario's folder or under BORESIGHT_DATA), or an embedded body by name."""

    shape: str = Field("contact-binary", description="A file name, or an embedded body: contact-binary")
    unit: Literal["m", "km"] = Field("m", description="Unit of the numbers in the shape file; dsk files are in km")
    format: Literal["auto", "obj", "ply", "pds-plates", "pds-grid", "icq", "dsk"] = Field(
        "auto", description="Format of the shape file; auto goes by its content and suffix"
    )
    longitude: Literal["east", "west"] = Field("east", description="Direction of longitudes in a pds-grid file")
    expected_diameter_m: tuple[float, float] = Field(
        (1.0, 2_000_000.0), description="The body's extent must lie in this range: guards against a wrong unit"
    )
    shading: Literal["flat", "smooth"] = Field("flat", description="Normals of the facets, or interpolated ones")
    even_facets: int | None = optional(
        "Resample the shape to at least so many facets of similar size before the detail is added", ge=20, le=1_000_000
    )
    detail: DetailSpec | None = None
    height_error: HeightErrorSpec | None = Field(None, description="Random error of the heights, after the detail")
    local: tuple[LocalSpec, ...] | None = optional(
        "Finer shapes of parts of the surface, in place of the body's after its detail; later ones over earlier ones"
    )
    albedo_map: AlbedoMapSpec | None = optional("Map of the albedo, a factor beside detail.albedo")

    @property
    def files(self) -> tuple[str, ...]:
        """Names of the files that the body is made from; an embedded shape is none."""
        shape = () if self.shape in EMBEDDED_NAMES else (self.shape,)
        maps = () if self.albedo_map is None else (self.albedo_map.file,)
        return (*shape, *(one.shape for one in self.local or ()), *maps)

    def embedded(self) -> BodySpec:
        """Return the body with the built-in replacement of its shape file; the same body if there is none."""
        if self.shape not in STAND_INS:
            return self
        reading = {key: BodySpec.model_fields[key].default for key in ("unit", "format", "longitude")}
        return self.model_copy(update={**reading, "shape": STAND_INS[self.shape], "local": None, "albedo_map": None})


ADDED_TO_SHAPE = ("detail", "height_error", "even_facets", "local", "albedo_map")
"""Keys of what is made of the shape in a file."""


def without_detail(body: BodySpec) -> BodySpec:
    """Return a body as its shape file has it."""
    return body.model_copy(update=dict.fromkeys(ADDED_TO_SHAPE))

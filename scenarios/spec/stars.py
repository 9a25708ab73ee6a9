"""Section of the stars in rendered images: which catalogue, how bright, and what a star tracker knows."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, ClassVar, Self

import numpy as np
from pydantic import Field, ValidationInfo, model_validator

from boresight.scenarios.data import find_data_file
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera
from boresight.scenarios.spec.base import SpecModel, optional, rule
from boresight.scenarios.spec.camera import DetectorSpec
from boresight.scenarios.spec.trajectory import RotationSpec
from boresight.scenarios.stars import (
    STARS_OF_I311,
    StarCatalog,
    artificial_sky,
    file_digest,
    hipparcos_file,
    read_hipparcos,
    read_stars,
)

ARTIFICIAL, HIPPARCOS = "artificial", "hipparcos"
_SUN_MAG = -26.76  # V at 1 au, Willmer (2018)

Sigma = Annotated[float, Field(gt=0, le=180)]


class StarsSpec(SpecModel):
    """Stars behind the body, as points of light through the blur of the detector; those behind the body are hidden.

    Directions are those of the catalogue: aberration and parallax are left out, and all stars have the colour of the
    Sun.
    """

    prose: ClassVar = frozenset({"catalog"})

    catalog: str = Field(
        ARTIFICIAL,
        min_length=1,
        description="hipparcos (the extra ``stars`` of the installation), artificial (drawn by the counts of"
        " Hipparcos, uniform over the sky), or a CSV table with the columns ra_deg, dec_deg, mag",
    )
    seed: int = Field(0, ge=0, description="Seed of the artificial sky")
    year: float = Field(2000.0, ge=1900, le=2200, description="Julian year up to which stars of Hipparcos move")
    faintest_mag: float = Field(7.0, ge=-2, le=10, description="Magnitude of the faintest stars")
    zero_point_e_per_s: float | None = Field(
        None,
        gt=0,
        le=1e15,
        description="Electrons a second from a star of magnitude 0; left out: it follows from"
        " detector.white_e_per_s, the size of a pixel and sun_distance_au",
    )
    sun_distance_au: float = Field(1.0, gt=0, le=100, description="Distance of the body from the Sun")
    rotation: RotationSpec | None = optional(
        "Rotation of the body; left out: that of viewpoint.trajectory, else its attitude is drawn in each trial"
    )
    tracker_sigma_deg: tuple[Sigma, Sigma, Sigma] | None = Field(
        None,
        description="Standard deviations of a star tracker's error about the camera's axes x, y, z; left out: no star"
        " tracker, estimators are lost in space",
    )
    read_sha256: str | None = optional("Digest of the catalogue's file; filled in, not written by hand")

    @rule
    def _each_key_has_a_part(self) -> None:
        idle = {"seed": self.catalog != ARTIFICIAL, "year": self.catalog != HIPPARCOS}
        for key in (key for key, has_none in idle.items() if has_none and self.stated(key)):
            raise ValueError(f"{key} has no part beside catalog: {self.catalog}: leave it out")
        if self.zero_point_e_per_s is not None and self.stated("sun_distance_au"):
            raise ValueError("sun_distance_au has no part beside zero_point_e_per_s: leave it out")

    @model_validator(mode="after")
    def _read(self, info: ValidationInfo) -> Self:
        context = info.context or {}
        if self.read_sha256 is not None and context:  # of a file; a stored scenario has it
            raise ValueError("read_sha256 is filled in: leave it out")
        if self.catalog == ARTIFICIAL or self.read_sha256 is not None:
            return self
        try:
            folders = context.get("folders", ())
            _read_catalog(self, folders)
            return self.model_copy(update={"read_sha256": file_digest(_file(self, folders))})
        except (BoresightError, OSError) as error:
            raise ValueError(str(error)) from None

    def zero_point(self, camera: Camera, detector: DetectorSpec) -> float:
        """Return the electrons a second from a star of magnitude 0.

        A white plate of a pixel's solid angle W sends W / pi of the Sun's light at its distance.
        """
        if self.zero_point_e_per_s is not None:
            return self.zero_point_e_per_s
        pixel_sr = 1.0 / (camera.fx_px * camera.fy_px)
        sun_e_per_s = detector.white_e_per_s * np.pi / pixel_sr * self.sun_distance_au**2
        return float(sun_e_per_s * 10.0 ** (0.4 * _SUN_MAG))


def open_stars(spec: StarsSpec, folders: Sequence[Path]) -> StarCatalog:
    """Open the catalogue of a scenario, down to its faintest magnitude.

    Raise BoresightError if its file is missing, cannot be read, or is not the one that the scenario was read with.
    """
    if spec.catalog != ARTIFICIAL and spec.read_sha256 != file_digest(path := _file(spec, folders)):
        raise BoresightError(f"{path}: the catalogue of stars has changed since the scenario was read")
    return _read_catalog(spec, folders)


def _file(spec: StarsSpec, folders: Sequence[Path]) -> Path:
    if spec.catalog == HIPPARCOS:
        return hipparcos_file()
    return find_data_file(spec.catalog, folders, "tables", "catalog")


def _read_catalog(spec: StarsSpec, folders: Sequence[Path]) -> StarCatalog:
    if spec.catalog == ARTIFICIAL:
        catalog = artificial_sky(spec.seed, spec.faintest_mag)
    elif spec.catalog == HIPPARCOS:
        path = _file(spec, folders)
        catalog = read_hipparcos(path, spec.year)
        if len(catalog) != STARS_OF_I311:
            raise BoresightError(f"{path}: {len(catalog)} stars, not {STARS_OF_I311} as in I/311: is it cut short?")
    else:
        catalog = read_stars(_file(spec, folders))
    catalog = catalog.down_to(spec.faintest_mag)
    if not len(catalog):
        raise BoresightError(f"faintest_mag: {spec.faintest_mag:g}: no star of {spec.catalog} is as bright")
    return catalog

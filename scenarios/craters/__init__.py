"""Cratered surfaces with a known population: relief on a smooth body, and the true craters of an image."""

from boresight.scenarios.craters.relief import Craters, draw_craters
from boresight.scenarios.craters.surface import (
    CrateredSurface,
    build_surfaces,
    cratered_surface,
    shape_digest,
    surface_digest,
)
from boresight.scenarios.craters.tiles import Tiling, check_size
from boresight.scenarios.craters.truth import CraterTruth, Rims, crater_truth

__all__ = [
    "CraterTruth",
    "CrateredSurface",
    "Craters",
    "Rims",
    "Tiling",
    "build_surfaces",
    "check_size",
    "crater_truth",
    "cratered_surface",
    "draw_craters",
    "shape_digest",
    "surface_digest",
]

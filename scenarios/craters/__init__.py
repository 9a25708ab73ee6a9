"""Cratered surfaces with a known population: relief on a smooth body, and the true craters of an image."""

from boresight.scenarios.craters.surface import (
    CrateredSurface,
    build_surfaces,
    cratered_surface,
    shape_digest,
)
from boresight.scenarios.craters.tiles import check_size
from boresight.scenarios.craters.truth import CraterTruth, crater_truth

__all__ = [
    "CraterTruth",
    "CrateredSurface",
    "build_surfaces",
    "check_size",
    "crater_truth",
    "cratered_surface",
    "shape_digest",
]

"""Perfectly diffuse reflection."""

from __future__ import annotations

from math import pi

from renderers.brdf.arrays import Array


def lambert(albedo: Array) -> Array:
    """Lambert's BRDF, 1/sr: the same in every direction, so that the hemisphere reflects ``albedo``."""
    return albedo / pi

"""What another tracer of rays does to images, on a machine without one: rays are turned and shifted by a last bit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from boresight.renderers.mitsuba3 import wavefront

ROUNDING = 1.2e-7  # of a number in single precision


def round_rays_otherwise(patch: pytest.MonkeyPatch, sign: float) -> None:
    """Turn and shift the rays of all images from now on, one way or the other."""
    rounded, by = wavefront.ray_bundle, 1.0 + sign * ROUNDING * np.array([1.0, -1.0, 0.5])

    def otherwise(*arguments):
        rays = rounded(*arguments)
        return replace(rays, direction=rays.direction * by, origin_m=rays.origin_m / by)

    patch.setattr(wavefront, "ray_bundle", otherwise)

"""Bodies, views and Mitsuba variants that several tests of the renderers share."""

from collections.abc import Callable

import numpy as np
import pytest
import trimesh
from variants import variant_or_skip

from boresight.renderers.mitsuba3 import Variant, choose_variant
from boresight.scenarios.geometry import Camera, TriangleMesh, View, look_at


@pytest.fixture(scope="session")
def scalar() -> Variant:
    return choose_variant("scalar_rgb")


@pytest.fixture(scope="session")
def llvm() -> Variant:
    return variant_or_skip("llvm_ad_mono")


@pytest.fixture(scope="session")
def cuda() -> Variant:
    return variant_or_skip("cuda_ad_mono")


@pytest.fixture(scope="session")
def rock() -> TriangleMesh:
    """A lobed body of 20,480 facets and about 600 m: it shadows itself."""
    sphere = trimesh.creation.icosphere(subdivisions=5)
    x, y, z = sphere.vertices.T
    radius = 200.0 * (1.0 + 0.35 * np.sin(3.0 * x + 1.0) * np.cos(4.0 * y) + 0.2 * np.sin(7.0 * z - 2.0 * x))
    stretched = sphere.vertices * radius[:, None] * [1.4, 0.8, 0.7]
    return TriangleMesh(stretched, sphere.faces)


@pytest.fixture(scope="session")
def ball() -> TriangleMesh:
    """A sphere of 250 m in 81,920 facets."""
    sphere = trimesh.creation.icosphere(subdivisions=6, radius=250.0)
    return TriangleMesh(sphere.vertices, sphere.faces)


@pytest.fixture(scope="session")
def looking() -> Callable[..., View]:
    """Make a view: a camera at a position, pointed past the origin, and a Sun."""

    def make(camera: Camera, position_m: list[float], sun: list[float], turn_rad: float = 0.01) -> View:
        pose = look_at(np.array(position_m), 0.4).perturbed(
            np.array([turn_rad, -turn_rad, 0.0]), np.array([6.0, -9.0, 0])
        )
        return View(camera, pose, np.array(sun))

    return make

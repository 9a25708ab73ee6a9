"""The scene of the comparisons of images: a body with relief, one Sun, cameras about the lit side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.renderers.mitsuba3 import MitsubaRenderer, Variant
from boresight.renderers.mitsuba3.rays import PixelWindow, body_window
from boresight.scenarios.bodies import load_body
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, TriangleMesh, View, look_at
from boresight.scenarios.spec.body import BodySpec
from boresight.scenarios.spec.brdf import LambertSpec

RANGE_M = 2000.0
SIZE_PX = 512
FOV_RAD = float(np.radians(18.3))
ALBEDO = 0.3
SAMPLES = 4
SUN_DIR_BODY = np.array([0.8, 0.5, np.sqrt(0.11)])
_PHASE_RAD = float(np.radians(60.0))
_SEED = 20150709


@dataclass(frozen=True, slots=True, eq=False)
class SpeedScene:
    """A body and views of it; the Sun stands still in the body's axes, as Cycles then keeps the body between images."""

    mesh: TriangleMesh
    views: tuple[View, ...]

    def window(self, view: int) -> PixelWindow:
        """Return the part of a view that we trace, and that peers are asked for."""
        found = body_window(self.views[view], self.mesh.vertices_m)
        if found is None:
            raise BoresightError(f"view {view} of the scene of the comparisons: the body is out of sight")
        return found

    def renderer(self, variant: Variant, samples: int = SAMPLES) -> MitsubaRenderer:
        """Return our renderer of the body, in Lambert's reflectance."""
        return MitsubaRenderer(self.mesh, LambertSpec(kind="lambert", albedo=ALBEDO), samples, variant=variant)


def speed_body(facets: int) -> BodySpec:
    """Return the embedded contact binary with so many facets of boulders, craters and rough ground."""
    return BodySpec.model_validate(
        {
            "shape": "contact-binary",
            "detail": {
                "facets": facets,
                "seed": 7,
                "boulders": {"count": 4000, "min_diameter_m": 3, "max_diameter_m": 40},
                "craters": {"count": 30, "min_diameter_m": 15, "max_diameter_m": 80},
                "roughness": {"rms_m": 0.6, "max_wavelength_m": 40},
            },
        }
    )


def speed_scene(facets: int, views: int) -> SpeedScene:
    """Build the body of the comparisons with so many facets, and draw views of it."""
    rng = np.random.default_rng(_SEED)
    return SpeedScene(load_body(speed_body(facets), ()).mesh, tuple(_view(rng) for _ in range(views)))


def agreement(ours: NDArray[np.float32], theirs: NDArray[np.float32]) -> float:
    """Correlation of two images (H, W) over the pixels that either has light in."""
    lit = (ours > 0.0) | (theirs > 0.0)
    return float(np.corrcoef(ours[lit], theirs[lit])[0, 1])


def _view(rng: np.random.Generator) -> View:
    """Draw a camera from which the phase angle is below 60 deg, uniform over the solid angle."""
    while True:
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        if direction @ SUN_DIR_BODY > np.cos(_PHASE_RAD):
            return View(Camera.from_fov(SIZE_PX, SIZE_PX, FOV_RAD), look_at(RANGE_M * direction), SUN_DIR_BODY)

"""What a camera sees of craters at a true view: a rendered image, or rims that geometry gives a detector."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from campaign.imaging.image_store import Imager
from campaign.trial.crater_score import match_detections
from estimators.craters.contract import CraterDetections
from renderers.mitsuba3 import TiledRenderer, choose_variant
from scenarios.bodies import load_body
from scenarios.craters import Rims, crater_truth, cratered_surface
from scenarios.craters.pairs import LIMITS_DEG, draw_plane_craters
from scenarios.craters.simulated import (
    NO_CRATER,
    DetectionErrors,
    PlaneCraters,
    detect_simulated,
    in_view,
    raise_craters,
)
from scenarios.draw import Stream, generator
from scenarios.errors import BoresightError
from scenarios.geometry import Ellipses, View
from scenarios.load import LoadedScenario
from scenarios.sequences.ground import MeshGround
from scenarios.spec.orbit import ImagingSpec

Image = NDArray[np.float32]
IndexArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Address:
    """Which image of which trial; streams of its own follow from it."""

    seed: int
    trial: int
    image: int

    def stream(self, stream: Stream, images: int) -> np.random.Generator:
        """Return the generator of one of at most ``images`` images of a trial."""
        return generator(self.seed, stream, self.trial * images + self.image)


class CraterSights(Protocol):
    """Gives images, and says which craters detections are."""

    def image(self, view: View, address: Address) -> Image:
        """Expose an image."""
        ...

    def drawn(self, view: View, address: Address) -> tuple[CraterDetections, IndexArray] | None:
        """Give detections without a detector, and the crater that each is; None where a detector has to look."""
        ...

    def which(self, found: Ellipses, view: View) -> IndexArray:
        """Tell for a detector's detections which crater each is; ``NO_CRATER`` where it is none."""
        ...

    def flush(self) -> None:
        """Keep what was rendered."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class DrawnSights:
    """Rims of drawn craters, projected by geometry; images are black."""

    spec: ImagingSpec
    ground: MeshGround
    craters: PlaneCraters

    def image(self, view: View, address: Address) -> Image:
        """Expose nothing."""
        return np.zeros((view.camera.height_px, view.camera.width_px), dtype=np.float32)

    def drawn(self, view: View, address: Address) -> tuple[CraterDetections, IndexArray] | None:
        """Project the craters in view and let a simulated detector err; heights are the same in all images."""
        errors = DetectionErrors(**self.spec.errors.model_dump())
        real = raise_craters(self.craters, errors.height_m, generator(address.seed, Stream.LANDMARKS, address.trial))
        rng = address.stream(Stream.ORBIT_DETECTIONS, self.spec.epochs)
        found = detect_simulated(real, in_view(self.craters, self.ground, view, LIMITS_DEG), view, errors, rng)
        return CraterDetections(found.ellipses, np.ones(len(found.crater))), found.crater

    def which(self, found: Ellipses, view: View) -> IndexArray:
        """Do nothing: drawn detections carry their craters."""
        raise TypeError("drawn detections carry their craters")

    def flush(self) -> None:
        """Do nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class RenderedSights:
    """Rendered images of the scenario's craters."""

    spec: ImagingSpec
    renderer: TiledRenderer
    rims: Rims
    imager: Imager

    def image(self, view: View, address: Address) -> Image:
        """Render an image, or take it from the store, and expose it."""
        number = address.trial * self.spec.epochs + address.image
        noise = address.stream(Stream.DETECTOR, self.spec.epochs)
        return self.imager.image(view, address.seed, number, noise)[0]

    def drawn(self, view: View, address: Address) -> tuple[CraterDetections, IndexArray] | None:
        """Leave it to a detector."""
        return None

    def which(self, found: Ellipses, view: View) -> IndexArray:
        """Match detections with all craters that the view shows."""
        truth = crater_truth(self.rims, view, self.renderer)
        # The last of the numbers is that of no crater, which is row -1 as well.
        numbers = np.append(truth.crater, NO_CRATER).astype(np.int64)
        return np.asarray(numbers[match_detections(found, truth.ellipses).crater])

    def flush(self) -> None:
        """Keep what was rendered."""
        self.imager.flush()


def open_sights(scenario: LoadedScenario, spec: ImagingSpec, variant: str) -> CraterSights:
    """Make ready what the section asks for.

    Raises
    ------
    BoresightError
        If images are to be rendered of a body without craters.
    """
    whole = scenario.spec
    if spec.detections == "drawn":
        ground = MeshGround(load_body(whole.body, scenario.search_dirs).mesh)
        return DrawnSights(spec, ground, draw_plane_craters(ground, spec.craters))
    if whole.craters is None or whole.orbit is None:
        raise BoresightError(
            f"{scenario.path}: craters: missing, but orbit.imaging.detections is rendered: add the section, or choose"
            " drawn"
        )
    surface = cratered_surface(whole.body, whole.craters, scenario.search_dirs)
    renderer = TiledRenderer(surface, whole.brdf, whole.rendering.samples_per_pixel, choose_variant(variant))
    imager = Imager.open(scenario, variant, renderer, Stream.ORBIT_IMAGES, whole.orbit.arc, spec)
    return RenderedSights(spec, renderer, surface.rims, imager)

"""Images of a scenario at given views: rendered or taken from the store, then exposed by its detector."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from campaign.imaging.image_store import ImageStore
from renderers.detector import Detector
from renderers.mitsuba3 import BodyRenderer, MitsubaRenderer, TiledRenderer, choose_variant
from scenarios.bodies import load_body
from scenarios.craters import cratered_surface
from scenarios.draw import Stream
from scenarios.geometry import View
from scenarios.load import LoadedScenario
from scenarios.spec.base import SpecModel

Image = NDArray[np.float32]


def open_renderer(scenario: LoadedScenario, variant: str) -> BodyRenderer:
    """Build the renderer of a scenario's true body, with its craters if it has some."""
    spec = scenario.spec
    samples, chosen = spec.rendering.samples_per_pixel, choose_variant(variant)
    if spec.craters is not None:
        surface = cratered_surface(spec.body, spec.craters, scenario.search_dirs)
        return TiledRenderer(surface, spec.brdf, samples, chosen)
    mesh = load_body(spec.body, scenario.search_dirs).mesh
    return MitsubaRenderer(mesh, spec.brdf, samples, spec.body.shading, chosen)


@dataclass(frozen=True, slots=True, eq=False)
class Imager:
    """The camera of a scenario; ``detector`` is None where images stay radiance factors."""

    renderer: BodyRenderer
    detector: Detector | None
    store: ImageStore

    @classmethod
    def open(
        cls, scenario: LoadedScenario, variant: str, renderer: BodyRenderer, stream: Stream, *laws: SpecModel
    ) -> Imager:
        """Make ready to image views that are drawn from a stream by some laws."""
        detector = None if scenario.spec.detector is None else Detector(scenario.spec.detector)
        return cls(renderer, detector, ImageStore.open(scenario, variant, stream, *laws))

    def image(self, view: View, seed: int, index: int, noise: np.random.Generator) -> tuple[Image, bool]:
        """Image a view.

        Parameters
        ----------
        view
            Camera, pose and Sun.
        seed, index
            Of the image in the store.
        noise
            Of the detector.

        Returns
        -------
        image, from_store
            (H, W), and whether it was rendered in an earlier run.
        """
        radiance, from_store = self.store.image(seed, index, view, self.renderer.render)
        return (radiance if self.detector is None else self.detector.expose(radiance, noise)), from_store

    def flush(self) -> None:
        """Keep what was rendered."""
        self.store.flush()

"""Where pairs of looks at craters come from: drawn by geometry, or rendered and seen by a detector."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from campaign.crater_score import match_detections
from estimators.craters.contract import CraterDetector
from estimators.craters.registry import crater_detector_class
from renderers.detector import Detector
from renderers.mitsuba3 import TiledRenderer, choose_variant
from scenarios.bodies import load_body
from scenarios.craters import Rims, crater_truth, cratered_surface
from scenarios.craters.pairs import CraterLook, CraterPair, draw_pair, draw_views, known_frame, population
from scenarios.craters.simulated import NO_CRATER, LabelledDetections, PlaneCraters
from scenarios.draw import Stream, generator
from scenarios.errors import BoresightError
from scenarios.geometry import Camera, View
from scenarios.load import LoadedScenario
from scenarios.sequences.ground import MeshGround
from scenarios.spec.crater_pairs import CraterPairsSpec
from scenarios.spec.world import PoseErrorSpec


class PairSource(Protocol):
    """Gives the two looks of a trial."""

    def pair(self, seed: int, trial: int) -> CraterPair:
        """Draw the pair of a trial."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedPairs:
    """Looks whose rims are projected by geometry."""

    spec: CraterPairsSpec
    pose_error: PoseErrorSpec
    camera: Camera
    ground: MeshGround
    craters: PlaneCraters

    def pair(self, seed: int, trial: int) -> CraterPair:
        """Draw the pair of a trial."""
        return draw_pair(self.spec, self.pose_error, self.camera, self.ground, self.craters, (seed, trial))


@dataclass(frozen=True, slots=True, eq=False)
class RenderedPairs:
    """Looks that are rendered; a detector finds the craters, and the truth says which they are."""

    spec: CraterPairsSpec
    pose_error: PoseErrorSpec
    camera: Camera
    ground: MeshGround
    renderer: TiledRenderer
    rims: Rims
    detector: Detector | None
    finder: CraterDetector

    def pair(self, seed: int, trial: int) -> CraterPair:
        """Draw the pair of a trial, render it and look for craters."""
        views, angles = draw_views(self.spec, self.camera, self.ground, generator(seed, Stream.TRUTH, trial))
        priors, noise = generator(seed, Stream.POSE_ERROR, trial), generator(seed, Stream.DETECTOR, trial)
        looks = [self._look(view, priors, noise, float(number)) for number, view in enumerate(views)]
        return CraterPair(looks[0], looks[1], *angles)

    def _look(self, view: View, priors: np.random.Generator, noise: np.random.Generator, time_s: float) -> CraterLook:
        image = self.renderer.render(view)
        if self.detector is not None:
            image = self.detector.expose(image, noise)
        frame = known_frame(view, image, self.pose_error, priors, time_s)
        rims = self.finder.detect(frame, self.camera).ellipses[: self.spec.most_detections]
        truth = crater_truth(self.rims, view, self.renderer)
        # The last of the numbers is that of no crater, which is row -1 as well.
        numbers = np.append(truth.crater, NO_CRATER).astype(np.int64)
        which = match_detections(rims, truth.ellipses).crater
        return CraterLook(view, LabelledDetections(rims, numbers[which]), frame)


def open_pairs(scenario: LoadedScenario, section: CraterPairsSpec, variant: str) -> PairSource:
    """Make ready what the section asks for.

    Raises
    ------
    BoresightError
        If a detector is to look at a body without craters, or is unknown.
    """
    spec = scenario.spec
    camera = spec.camera.camera().pinhole
    ground = MeshGround(load_body(spec.body, scenario.search_dirs).mesh)
    if section.craters is not None:
        return SimulatedPairs(section, spec.pose_error, camera, ground, population(ground, section.craters))
    if spec.craters is None or section.detector is None:
        raise BoresightError(f"{scenario.path}: craters: missing, but crater_pairs.detector looks for them")
    surface = cratered_surface(spec.body, spec.craters, scenario.search_dirs)
    renderer = TiledRenderer(surface, spec.brdf, spec.rendering.samples_per_pixel, choose_variant(variant))
    finder = crater_detector_class(section.detector).from_options({})
    exposed = None if spec.detector is None else Detector(spec.detector)
    return RenderedPairs(section, spec.pose_error, camera, ground, renderer, surface.rims, exposed, finder)

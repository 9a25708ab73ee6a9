"""Where pairs of looks at craters come from: drawn by geometry, or rendered and seen by a detector."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

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
from scenarios.geometry import Camera, Ellipses, View
from scenarios.load import LoadedScenario
from scenarios.sequences.ground import MeshGround
from scenarios.spec.crater_pairs import CraterPairsSpec
from scenarios.spec.world import PoseErrorSpec

IndexArray = NDArray[np.int64]

_CENTRE_RADII, _CENTRE_PX, _LOG_RADIUS = 0.3, 1.5, 0.36


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
        numbers = np.append(truth.crater, NO_CRATER).astype(np.int64)
        return CraterLook(view, LabelledDetections(rims, numbers[nearest_rims(rims, truth.ellipses)]), frame)


def nearest_rims(found: Ellipses, true: Ellipses) -> IndexArray:
    """(n,) which true rim each detection is, one to one; ``NO_CRATER`` where it is none.

    The centre lies within max(0.3 r, 1.5 px), and the logarithm of the ratio of radii within 0.36.
    """
    rows = np.full(len(found), NO_CRATER, dtype=np.int64)  # -1: also the last of the numbers, which is none
    if len(found) == 0 or len(true) == 0:
        return rows
    distance = np.linalg.norm(found.centre_px[:, None] - true.centre_px[None], axis=2)
    near = distance <= np.maximum(_CENTRE_RADII * true.radius_px, _CENTRE_PX)[None]
    near &= np.abs(np.log(found.radius_px[:, None] / true.radius_px[None])) < _LOG_RADIUS
    cost = np.where(near, distance / true.radius_px[None], 1e3)
    one, other = linear_sum_assignment(cost)
    sure = near[one, other]
    rows[one[sure]] = other[sure]
    return rows


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

"""The images of a revolution or a trajectory, what is found in them, and what is true of it."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from boresight.campaign.imaging.image_store import Imager
from boresight.estimators.slam.vision.matching import ImageFeatures, find_features, match_descriptors
from boresight.renderers.rectify import rectify
from boresight.scenarios.arrays import BoolArray, FloatArray, Image, IndexArray
from boresight.scenarios.bodies import load_body
from boresight.scenarios.draw import Stream, generator
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, View
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.sequences import CameraTrajectory, MeshGround, camera_trajectory, nominal_trajectory
from boresight.scenarios.sequences.track_table import WRONG_PX
from boresight.scenarios.spec.sequence import ImageVisionSpec, SequenceSpec

REPEATED_PX = 2.0
_SAME_POINT = 1e-3  # of the distance: a point that the next camera sees too is met within this


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """Features of an image, their true surface points (M, 3) (NaN off the body), and the computing time."""

    features: ImageFeatures
    points_m: FloatArray
    seconds: float


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Matches of two images: (K, 2) rows of their features, (K,) which are right in truth, and the time it took."""

    rows: IndexArray
    right: BoolArray
    seconds: float


@dataclass(slots=True, eq=False)
class OrbitImages:
    """Images every step of one revolution about a body at rest, the Sun along the orbit's normal, or of a trajectory.

    The exposures of one realisation at a time are held, with their features. ``views`` are those of the images by their
    slot, with the camera's lens; images are resampled to the pinhole ``camera``. ``seed`` is that of the detector's
    noise. ``spec`` is the vision layer of the ``section`` of the scenario, with one start on a trajectory.
    """

    section: SequenceSpec
    ground: MeshGround
    spec: ImageVisionSpec
    views: tuple[View, ...]
    camera: Camera
    imager: Imager
    seed: int
    _realisation: int = -1
    _images: dict[int, Image] = field(default_factory=dict)
    _found: dict[int, Found] = field(default_factory=dict)
    _pairs: dict[tuple[int, int], Pairs] = field(default_factory=dict)
    _repeated: dict[tuple[int, int], float] = field(default_factory=dict)

    @classmethod
    def open(cls, scenario: LoadedScenario, variant: str, seed: int) -> OrbitImages:
        """Build the body and its renderer; images are made when they are asked for."""
        spec, section = scenario.spec, scenario.spec.sequence
        if section is None or section.images is None:
            raise BoresightError(f"{scenario.path}: sequence.images: missing, so there is no image to render")
        ground, camera = MeshGround(load_body(spec.body, scenario.search_dirs).mesh), spec.camera.camera()
        if section.trajectory is not None:
            path = nominal_trajectory(section, ground)
            imager = Imager.open(scenario, variant, Stream.TRUTH, section.trajectory)
            alike = section.images.model_copy(update={"starts": 1})  # every trial begins at the first state
            return cls(section, ground, alike, path.views(camera), camera.pinhole, imager, seed)
        circle = section.orbit.model_copy(update={"revolutions": 1.0})
        path = camera_trajectory(section.model_copy(update={"orbit": circle}), ground, np.zeros((circle.frames - 1, 3)))
        imager = Imager.open(scenario, variant, Stream.TRUTH, circle)
        return cls(section, ground, section.images, path.views(camera)[:-1], camera.pinhole, imager, seed)

    def path(self, start: int) -> CameraTrajectory:
        """Return the way of the camera from a start."""
        if self.section.trajectory is not None:
            return nominal_trajectory(self.section, self.ground)
        orbit = self.section.orbit
        turned = orbit.model_copy(update={"start_deg": orbit.start_deg + 360.0 * start / self.spec.starts})
        still = np.zeros((orbit.frames - 1, 3))
        return camera_trajectory(self.section.model_copy(update={"orbit": turned}), self.ground, still)

    def image(self, realisation: int, slot: int) -> Image:
        """(H, W) exposure of a slot, resampled to the pinhole."""
        self._turn_to(realisation)
        if slot not in self._images:
            view = self.views[slot]
            noise = generator(self.seed, Stream.DETECTOR, realisation * len(self.views) + slot)
            exposed, _ = self.imager.image(view, 0, slot, noise)
            self._images[slot] = rectify(exposed, view.camera)
        return self._images[slot]

    def found(self, realisation: int, slot: int) -> Found:
        """Find the features of a slot."""
        self._turn_to(realisation)
        if slot not in self._found:
            image = self.image(realisation, slot)
            started = time.perf_counter()
            features = find_features(image, self.spec.detector, self.spec.features)
            seconds = time.perf_counter() - started
            self._found[slot] = Found(features, self.points_m(slot, features.uv_px), seconds)
        return self._found[slot]

    def pairs(self, realisation: int, before: int, after: int) -> Pairs:
        """Match the features of two slots by their descriptors."""
        first, second = self.found(realisation, before), self.found(realisation, after)
        if (before, after) not in self._pairs:
            started = time.perf_counter()
            rows = match_descriptors(first.features, second.features, self.spec.ratio_max)
            seconds = time.perf_counter() - started
            places = self.places_px(after, first.points_m[rows[:, 0]])
            right = np.linalg.norm(places - second.features.uv_px[rows[:, 1]], axis=1) <= WRONG_PX
            self._pairs[before, after] = Pairs(rows, right, seconds)
        return self._pairs[before, after]

    def points_m(self, slot: int, uv_px: FloatArray) -> FloatArray:
        """(n, 3) true surface points at pixels of the pinhole; NaN off the body."""
        view = self.views[slot]
        return self.imager.renderer.surface(view, view.camera.distorted(uv_px)).points_body_m

    def places_px(self, slot: int, points_m: FloatArray) -> FloatArray:
        """(n, 2) where the pinhole of a slot has points."""
        return self.camera.project(self.views[slot].T_cam_body.transform(points_m))

    def repeatability(self, realisation: int, before: int, after: int) -> float:
        """Share of the features of a slot, of those in sight from another, that are found there within 2 px."""
        first, second = self.found(realisation, before), self.found(realisation, after)
        if (before, after) not in self._repeated:
            places, share = self.places_px(after, first.points_m), 0.0
            seen = self._in_sight(after, first.points_m, places)
            if seen.any() and len(second.features):
                apart, _ = cKDTree(second.features.uv_px).query(places[seen])
                share = float(np.mean(apart <= REPEATED_PX))
            self._repeated[before, after] = share
        return self._repeated[before, after]

    def flush(self) -> None:
        """Keep what was rendered."""
        self.imager.flush()

    def _in_sight(self, slot: int, points_m: FloatArray, places_px: FloatArray) -> BoolArray:
        seen = self.camera.contains(places_px) & np.isfinite(points_m).all(axis=1)
        met = self.points_m(slot, places_px[seen])
        distance = np.linalg.norm(points_m[seen] - self.views[slot].T_cam_body.camera_position_m, axis=1)
        seen[seen] = np.linalg.norm(met - points_m[seen], axis=1) < _SAME_POINT * distance
        return seen

    def _turn_to(self, realisation: int) -> None:
        if realisation != self._realisation:
            self._realisation = realisation
            self._images.clear()
            self._found.clear()
            self._pairs.clear()
            self._repeated.clear()

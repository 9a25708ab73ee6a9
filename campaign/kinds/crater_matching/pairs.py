"""Sources of pairs of crater views: drawn by geometry, or rendered and detected."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from boresight.campaign.handles import Handle, own_copy, target_of
from boresight.campaign.imaging.image_store import Imager
from boresight.campaign.trial.runner import Unbuilt, require_built, try_build
from boresight.campaign.trial.score import check_detections, identified
from boresight.estimators.craters.contract import CraterDetector
from boresight.estimators.registry import crater_detector_class
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.bodies import load_body
from boresight.scenarios.craters import CraterTruth
from boresight.scenarios.craters.simulated import (
    NO_CRATER,
    CraterPair,
    CraterView,
    LabelledDetections,
    PlaneCraters,
    draw_pair,
    draw_plane_craters,
    draw_views,
    observed_frame,
)
from boresight.scenarios.draw import Stream, generator
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Ellipses, View
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.observation import Frame
from boresight.scenarios.sequences.ground import MeshGround
from boresight.scenarios.spec.campaign import EstimatorSpec
from boresight.scenarios.spec.craters import CraterPairsSpec, RenderedLooksSpec
from boresight.scenarios.spec.world import PoseErrorSpec

BY_GEOMETRY = ""
"""Stands for the name of a detector where rims are projected and there is no image to look at."""


class MatcherGround(Handle):
    """The a priori shape as a matcher gets it: a handle, as all matchers share the `MeshGround` with its tree."""

    __slots__ = ()

    def intersect(self, origin_body_m: FloatArray, directions_body: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (n, 3) points and (n, 3) outward normals where (n, 3) rays meet the body; NaN where they miss it."""
        ground: MeshGround = target_of(self)
        return ground.intersect(origin_body_m, directions_body)


@dataclass(frozen=True, slots=True, eq=False)
class ImagePairDraw:
    """A trial before any detector has seen it: the first of the two true views, and a function of a detector's name.

    ``seen_by`` lets that detector look for craters in both images; what it raises is raised.
    """

    first: View
    seen_by: Callable[[str], CraterPair]


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedPairs:
    """Looks whose rims are projected by geometry."""

    spec: CraterPairsSpec
    pose_error: PoseErrorSpec
    camera: Camera
    ground: MeshGround
    craters: PlaneCraters

    def looks(self, seed: int, trial: int) -> ImagePairDraw:
        """Draw the pair of a trial."""
        pair = draw_pair(self.spec, self.pose_error, self.camera, self.ground, self.craters, (seed, trial))
        return ImagePairDraw(pair.first.view, lambda detector: pair)

    def flush(self) -> None:
        """Do nothing: no image was rendered."""


@dataclass(frozen=True, slots=True, eq=False)
class RenderedPairs:
    """Image pairs that are rendered or taken from the store; detectors find the craters, the truth identifies them.

    The truth lists craters with diameters of ``listed_from_m`` (m) and more.
    """

    spec: CraterPairsSpec
    images: RenderedLooksSpec
    pose_error: PoseErrorSpec
    camera: Camera
    ground: MeshGround
    listed_from_m: float
    imager: Imager
    finders: Mapping[str, CraterDetector | Unbuilt]

    def looks(self, seed: int, trial: int) -> ImagePairDraw:
        """Draw the views of a trial and render them once."""
        views, angles = draw_views(self.spec, self.camera, self.ground, generator(seed, Stream.TRUTH, trial))
        priors, noise = generator(seed, Stream.POSE_ERROR, trial), generator(seed, Stream.DETECTOR, trial)
        seen = []
        for number, view in enumerate(views):
            image, _ = self.imager.image(view, seed, 2 * trial + number, noise)
            frame = observed_frame(view, image, self.pose_error, priors, float(number))
            seen.append((view, frame, self.imager.craters(view)))

        def seen_by(detector: str) -> CraterPair:
            first, second = (self._look(require_built(self.finders[detector]), *one) for one in seen)
            return CraterPair(first, second, *angles)

        # Matchers that share a detector see the same craters, which are looked for once.
        return ImagePairDraw(views[0], cache(seen_by))

    def _look(self, finder: CraterDetector, view: View, frame: Frame, truth: CraterTruth) -> CraterView:
        rims = _found(finder, frame, self.camera)[: self.images.most_detections]
        crater = identified(rims, truth)
        unlisted = (crater == NO_CRATER) & (diameters_m(rims, view, self.ground) < self.listed_from_m)
        return CraterView(view, LabelledDetections(rims, crater, unlisted), frame)

    def flush(self) -> None:
        """Keep what was rendered."""
        self.imager.flush()


PairSource = SimulatedPairs | RenderedPairs


def diameters_m(rims: Ellipses, view: View, ground: MeshGround) -> FloatArray:
    """(n,) m, diameters of the craters with these rims, from the longer axes; NaN for rims centred off the body."""
    pose, camera = view.T_cam_body, view.camera
    directions_body = camera.unproject(rims.centre_px) @ pose.rotation
    points_m, _ = ground.intersect(np.broadcast_to(pose.camera_position_m, directions_body.shape), directions_body)
    depth_m = pose.transform(points_m)[:, 2]
    # A slanted circle is foreshortened along its shorter axis alone.
    return np.asarray(2.0 * rims.semi_axes_px[:, 0] * camera.pixel_angle_rad * depth_m, dtype=np.float64)


def _found(finder: CraterDetector, frame: Frame, camera: Camera) -> Ellipses:
    """Detect rims; an image in which a detector can see nothing, black or saturated, has none."""
    try:
        found = finder.detect(own_copy(frame), own_copy(camera))
    except BoresightError:
        return Ellipses.none()
    check_detections(found)
    return found.ellipses


def check_detector(scenario: LoadedScenario, section: CraterPairsSpec, label: str, name: str) -> None:
    """Refuse a matcher, by its label, whose detector ``name`` cannot see the looks of a scenario.

    Raise BoresightError if a detector is to look where nothing is rendered, or none where something is, or is unknown.
    """
    if section.images is None and name != BY_GEOMETRY:
        raise BoresightError(
            f"{label}.detector: {name} has no image to look at: {scenario.path} draws detections by geometry"
            " (crater_pairs.craters); leave the option out"
        )
    if section.images is not None:
        if name == BY_GEOMETRY:
            raise BoresightError(
                f"{label}.detector: missing, but the looks of {scenario.path} are rendered: name one, for example"
                f" {{{label}: {{detector: crater-classic}}}}"
            )
        crater_detector_class(name)


def open_pairs(
    scenario: LoadedScenario, section: CraterPairsSpec, variant: str, detectors: Collection[str]
) -> PairSource:
    """Make ready what the section asks for, checked before by ``check_detector``."""
    spec = scenario.spec
    camera = spec.camera.camera().pinhole
    ground = MeshGround(load_body(spec.body, scenario.search_dirs).mesh)
    if section.craters is not None:
        return SimulatedPairs(section, spec.pose_error, camera, ground, draw_plane_craters(ground, section.craters))
    if spec.craters is None or section.images is None:
        raise BoresightError(f"{scenario.path}: craters: missing, but crater_pairs.images renders them")
    listed_from_m, imager = spec.craters.listed_from_m, Imager.open(scenario, variant, Stream.TRUTH, section)
    finders = {
        name: try_build(EstimatorSpec(name=name, label=name), spec.name, partial(_finder, name)) for name in detectors
    }
    return RenderedPairs(section, section.images, spec.pose_error, camera, ground, listed_from_m, imager, finders)


def _finder(name: str) -> CraterDetector:
    return crater_detector_class(name).from_options({})

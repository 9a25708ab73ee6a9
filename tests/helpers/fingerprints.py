"""What trials of a scenario show to an estimator, the truth that they are scored against and what is lent, as bytes."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np

from boresight.campaign.imaging.image_store import Imager
from boresight.campaign.imaging.observe import observe
from boresight.campaign.imaging.real_images import open_tracks
from boresight.campaign.imaging.world import believed, open_world
from boresight.campaign.kinds.approach_orbit import ApproachOrbitTrials
from boresight.campaign.kinds.crater_matching.pairs import BY_GEOMETRY, open_pairs
from boresight.campaign.kinds.crater_navigation.images import Address, NavigationTrial, open_sights
from boresight.campaign.kinds.orbit_determination import open_orbit_world
from boresight.campaign.kinds.pose_convergence import draw_landmarks
from boresight.campaign.kinds.sequence import ground_of
from boresight.campaign.kinds.sequence.images import OrbitImages, Watch
from boresight.campaign.products import BuiltAssets
from boresight.campaign.products.databases import database_images
from boresight.estimators.craters.navigation.rounds import CraterNavigation, StageFiles
from boresight.estimators.landmark.database import LandmarkDatabase
from boresight.estimators.registry import sequence_estimator_class
from boresight.renderers.mitsuba3 import choose_variant
from boresight.scenarios.bodies import load_body
from boresight.scenarios.craters import crater_truth
from boresight.scenarios.draw import Stream
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import View, look_at
from boresight.scenarios.load import LoadedScenario, load_scenario
from boresight.scenarios.onboard import onboard_spec
from boresight.scenarios.orbits.draw import draw_orbit
from boresight.scenarios.orbits.true_orbit import imaging_of
from boresight.scenarios.sequences import draw_real_sequence, draw_sequence


def fingerprint(file: Path, overrides: tuple[str, ...] = (), kind: str = "") -> Iterator[bytes]:
    """Yield what some trials show to an estimator, the truth that they are scored against and what is lent.

    Of a ``kind`` of trial, by default that of the scenario's sections. Each part is made when it is asked for: of two
    scenarios that differ, the first difference is enough.
    """
    scenario = load_scenario(str(file), overrides)
    spec, variant = scenario.spec, choose_variant().name
    if kind in _OF_KINDS:
        shown = _OF_KINDS[kind](scenario, variant)
    elif spec.sequence is not None:
        shown = _sequences(scenario, variant)
    elif spec.crater_pairs is not None:
        shown = _pairs(scenario, variant)
    elif spec.orbit is None:
        shown = _images(scenario, variant, file.parent / "products")
    elif spec.orbit.imaging is not None:
        shown = _navigation(scenario, variant)
    else:
        shown = iter([draw_orbit(open_orbit_world(scenario, 3), 3, 0)])
    for part in shown:
        yield from _parts(part)


def _parts(value: object) -> Iterator[bytes]:
    """Yield all numbers and texts in a value, but no sizes of errors: an error that is told must be made as well."""
    if isinstance(value, np.ndarray | np.generic):
        yield np.ascontiguousarray(value).tobytes()
    elif value is None or isinstance(value, str | int | float):
        yield repr(value).encode()
    elif isinstance(value, Mapping):
        yield from _parts(list(value.items()))
    elif isinstance(value, list | tuple):
        for one in value:
            yield from _parts(one)
    elif is_dataclass(value):
        for field in fields(value):
            if "sigma" not in field.name and "covariance" not in field.name:
                yield from _parts(getattr(value, field.name))


def _images(scenario: LoadedScenario, variant: str, products: Path) -> Iterator[object]:
    """Three images, and what estimators borrow: the camera, the shape, and an image of it in the believed BRDF."""
    assets = BuiltAssets(scenario, products, None, variant)
    shape = assets.shape()
    yield assets.camera, shape.vertices_m
    world = open_world(scenario, variant)
    if world.ground is not None:
        yield world.ground.rims.crest_m
    for trial in range(3):
        try:
            image = world.source.trial_image(3, trial)
            observation = observe(world, image, 3, trial)
            prior = observation.frame.prior_T_cam_body
            told = observation.frame.prior_covariance, observation.calibration_covariance(prior)
            yield image.image, image.view.T_cam_body, image.further, observation, told
        except BoresightError as error:
            yield str(error)
    view = View(assets.camera, look_at(6.0 * shape.radius_m * np.array([0.9, 0.4, 0.2])), np.array([1.0, 0.0, 0.0]))
    yield assets.mesh_renderer(shape).render(view)


def _navigation(scenario: LoadedScenario, variant: str) -> Iterator[object]:
    world = open_orbit_world(scenario, 3)
    with tempfile.TemporaryDirectory() as folder:
        stages = StageFiles(Path(folder))
        taken = NavigationTrial.take(world, open_sights(scenario, imaging_of(world), variant), 3, 0, stages)
        yield taken.flown.image_states, taken.task.shape.ground.mesh.vertices_m, taken.views, taken.task.radiometry
        yield from taken.search(CraterNavigation.from_options({}), taken.task)


def _sequences(scenario: LoadedScenario, variant: str) -> Iterator[object]:
    spec, ground = scenario.spec, ground_of(scenario)
    if (table := open_tracks(scenario)) is not None:
        for trial in range(2):
            camera = spec.camera.camera().pinhole
            truth, sequence = draw_real_sequence(spec.sequence, table, camera, ground, (3, trial))
            yield truth.points_m, truth.poses, sequence, sequence.frames[0].sigma_px
        return
    if spec.sequence.images is None:
        for trial in range(2):
            truth, sequence = draw_sequence(spec.sequence, spec.camera.camera().pinhole, ground, 3, trial)
            yield truth.points_m, truth.poses, sequence
        return
    images = OrbitImages.open(scenario, variant, 3)
    for trial in range(2):
        watch = Watch(images, 3, trial)
        sequence_estimator_class("ba-slam").from_options({"connectivity": 2}).follow(watch.sequence)
        seen = watch.seen()
        yield seen.truth.points_m, seen.sequence, seen.sequence.frames[0].sigma_px


def _pairs(scenario: LoadedScenario, variant: str) -> Iterator[object]:
    detector = BY_GEOMETRY if scenario.spec.crater_pairs.images is None else "crater-classic"
    source = open_pairs(scenario, scenario.spec.crater_pairs, variant, [detector])
    yield load_body(onboard_spec(scenario.spec).body, scenario.search_dirs).mesh.vertices_m
    for trial in range(2):
        pair = source.looks(3, trial).seen_by(detector)
        for one in (pair.first, pair.second):
            yield one.detections, one.frame, one.view.T_cam_body


def _survey(scenario: LoadedScenario, variant: str) -> Iterator[object]:
    world = open_orbit_world(scenario, 3)
    sights = open_sights(scenario, imaging_of(world), variant)
    with tempfile.TemporaryDirectory() as folder:
        taken = NavigationTrial.take(world, sights, 3, 0, StageFiles(Path(folder)))
    yield taken.flown.image_states, taken.task.shape.ground.mesh.vertices_m, taken.views
    yield from (sights.drawn(view, Address(3, 0, number)) for number, view in enumerate(taken.views))


def _approach(scenario: LoadedScenario, variant: str) -> Iterator[object]:
    world = open_orbit_world(scenario, 3)
    imager = Imager.open(scenario, variant, Stream.ORBIT_IMAGES, world.spec.arc, imaging_of(world))
    drawn = ApproachOrbitTrials(scenario="", methods={}, seed=3, database={}, world=world, imager=imager).draw(0)
    yield drawn.truth, drawn.images, drawn.task


def _detections(scenario: LoadedScenario, variant: str) -> Iterator[object]:
    world = open_world(scenario, variant)
    for trial in range(2):
        try:
            image = world.source.trial_image(3, trial)
        except BoresightError as error:
            yield str(error)
            continue
        observation = observe(world, image, 3, trial)
        yield observation.frame, observation.frame.prior_covariance, observation.camera
        yield crater_truth(world.ground.rims, image.view, world.renderer)


def _databases(scenario: LoadedScenario, variant: str) -> Iterator[object]:
    """Two of the images that data bases are made of, and their ground."""
    for image in database_images(believed(scenario), range(2), (0.0, 60.0), 3, variant):
        yield image.pixels, image.view.T_cam_body, image.deproject(np.array([[20.0, 20.0], [24.0, 20.0], [20.0, 25.0]]))


def _convergence(scenario: LoadedScenario, variant: str) -> Iterator[object]:
    """A data base of the vertices of the believed body, and the landmarks of two trials."""
    mesh = load_body(onboard_spec(scenario.spec).body, scenario.search_dirs).mesh
    n = len(mesh.vertices_m)
    database = LandmarkDatabase(mesh.vertices_m, np.tile(np.eye(3), (n, 1, 1)), np.full(n, 9), mesh.faces)
    yield from (draw_landmarks(scenario.spec, database, 3, trial) for trial in range(2))
    yield from _databases(scenario, variant)


_OF_KINDS = {
    "image-survey": _survey,
    "approach-orbit": _approach,
    "crater-detection": _detections,
    "landmark-database": _databases,
    "pose-convergence": _convergence,
}

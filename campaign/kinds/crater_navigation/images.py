"""The images of a trial of crater navigation: planned by what is known, taken in truth, searched for craters."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

import numpy as np

from boresight.campaign.handles import own_copy
from boresight.campaign.imaging.image_store import Imager
from boresight.campaign.pool.steps import report_progress
from boresight.campaign.trial.score import check_detections, identified
from boresight.estimators.craters.contract import CraterDetections
from boresight.estimators.craters.database.files import ImageDetections, read_detections, write_detections
from boresight.estimators.craters.navigation.rounds import CraterNavigation, StageFiles
from boresight.estimators.craters.navigation.trajectory import AprioriShape, Exposure, NavigationTask
from boresight.estimators.craters.planning import PlannedImage, plan_arc, read_plan, with_telemetry, write_plan
from boresight.scenarios.arrays import Image, IndexArray
from boresight.scenarios.atomic import write_atomically
from boresight.scenarios.bodies import load_body
from boresight.scenarios.craters.simulated import (
    LIMITS_DEG,
    PlaneCraters,
    detect_simulated,
    draw_plane_craters,
    in_view,
    raise_craters,
)
from boresight.scenarios.draw import Stream, generator
from boresight.scenarios.dynamics.field import UniformRotation
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Ellipses, Pose, TriangleMesh, View
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.observation import Frame
from boresight.scenarios.orbits.draw import draw_knowledge, draw_radiometry
from boresight.scenarios.orbits.true_orbit import (
    TrueOrbit,
    control_errors,
    epochs_s,
    propagate_truth,
    true_views,
)
from boresight.scenarios.orbits.world import OrbitWorld
from boresight.scenarios.sequences.ground import MeshGround
from boresight.scenarios.spec.orbit import ImagingSpec


@dataclass(frozen=True, slots=True)
class Address:
    """Seed, trial and image number, from which the random streams of an image are derived."""

    seed: int
    trial: int
    image: int

    def stream(self, stream: Stream, images: int) -> np.random.Generator:
        """Return the generator of one of at most ``images`` images of a trial."""
        return generator(self.seed, stream, self.trial * images + self.image)


@dataclass(frozen=True, slots=True, eq=False)
class DrawnSights:
    """Rims of drawn craters, projected by geometry; images are black."""

    spec: ImagingSpec
    ground: MeshGround
    craters: PlaneCraters

    def image(self, view: View, address: Address) -> Image:
        """Expose nothing."""
        return np.zeros((view.camera.height_px, view.camera.width_px), dtype=np.float32)

    def drawn(self, view: View, address: Address) -> tuple[CraterDetections, IndexArray]:
        """Project the craters in view and let a simulated detector err: detections, and the crater that each is.

        Heights are the same in all images.
        """
        errors = self.spec.errors
        real = raise_craters(self.craters, errors.height_m, generator(address.seed, Stream.LANDMARKS, address.trial))
        rng = address.stream(Stream.ORBIT_DETECTIONS, self.spec.epochs)
        found = detect_simulated(real, in_view(self.craters, self.ground, view, LIMITS_DEG), view, errors, rng)
        return CraterDetections(found.ellipses, np.ones(len(found.crater))), found.crater

    def flush(self) -> None:
        """Do nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class RenderedSights:
    """Rendered images of the scenario's craters."""

    spec: ImagingSpec
    imager: Imager

    def image(self, view: View, address: Address) -> Image:
        """Render an image, or take it from the store, and expose it."""
        number = address.trial * self.spec.epochs + address.image
        noise = address.stream(Stream.DETECTOR, self.spec.epochs)
        return self.imager.image(view, address.seed, number, noise)[0]

    def which(self, found: Ellipses, view: View) -> IndexArray:
        """Return the crater of each detection; ``NO_CRATER`` where it is none."""
        return identified(found, self.imager.craters(view))

    def flush(self) -> None:
        """Keep what was rendered."""
        self.imager.flush()


CraterSights = DrawnSights | RenderedSights
"""Gives images, and detections with their craters, or which craters a detector has found."""


def open_sights(scenario: LoadedScenario, spec: ImagingSpec, variant: str) -> CraterSights:
    """Make ready what the section asks for.

    Raise BoresightError if images are to be rendered of a body without craters.
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
    return RenderedSights(spec, Imager.open(scenario, variant, Stream.ORBIT_IMAGES, whole.orbit.arc, spec))


@dataclass(frozen=True, slots=True, eq=False)
class SearchedImage:
    """An image as the chain gets it, why nothing could be seen in it, and, for the score alone, what its craters are.

    ``crater`` is (n,): that of each detection, ``NO_CRATER`` where it is none.
    """

    exposure: Exposure
    reason: str
    crater: IndexArray


@dataclass(eq=False)
class NavigationTrial:
    """One arc: the ``task`` of the chain, and its images, as planned and as telemetry reports them.

    The true motion ``flown``, the true view of each image and the true ``rotation`` of the body are for the sights and
    the score alone. ``address`` is that of the trial; its ``image`` has no meaning. The stages of its chains leave
    their files in ``stages``.
    """

    task: NavigationTask
    plan: tuple[PlannedImage, ...]
    flown: TrueOrbit
    views: tuple[View, ...]
    rotation: UniformRotation
    sights: CraterSights
    address: Address
    stages: StageFiles
    _images: dict[int, Image] = field(default_factory=dict)

    @classmethod
    def take(
        cls, world: OrbitWorld, sights: CraterSights, seed: int, trial: int, stages: StageFiles
    ) -> NavigationTrial:
        """Plan the images by the a priori orbit, and fly the true one.

        Raise `OrbitLostError` if one of the two leads into the body, `BoresightError` if no ground is lit and in sight
        at any epoch.
        """
        start = propagate_truth(world, np.zeros(0), seed, trial)
        knowledge, shape = draw_knowledge(world, start.wanted_states[0], seed, trial), apriori_shape(world)
        sun, times = world.sun_dir, epochs_s(world)

        def write(path: Path) -> None:
            planned = plan_arc(knowledge, sun, times, shape.ground, shape.centre_of_mass_m)
            write_plan(path, with_telemetry(planned, control_errors(world, len(planned), seed, trial)))

        plan = stages.cached("plan.txt", "planning", write, read_plan)
        if len(plan) < 2:
            raise BoresightError(
                f"{len(plan)} of {len(times)} epochs have lit ground in sight: there is nothing to plan"
            )
        flown = propagate_truth(world, np.array([image.time_s for image in plan]), seed, trial)
        reported = np.stack([image.actual_R_cam_inertial for image in plan])
        views = true_views(world, flown, reported, seed, trial)
        task = NavigationTask(knowledge, shape, draw_radiometry(world, flown, seed, trial), flown.wanted_s)
        return cls(task, plan, flown, views, world.rotation, sights, Address(seed, trial, 0), stages)

    def search(self, navigator: CraterNavigation, task: NavigationTask) -> list[SearchedImage]:
        """Look for craters in all images, or read what was found before; ``task`` is the chain's own copy."""
        found = []
        for number in range(len(self.plan)):
            found.append(self._searched(number, navigator, task))
            report_progress("images of a trial", number + 1, len(self.plan))
        self.sights.flush()
        return found

    def _searched(self, number: int, navigator: CraterNavigation, task: NavigationTask) -> SearchedImage:
        planned, view, own = self.plan[number], self.views[number], searched_in(navigator, self.stages)
        address = Address(self.address.seed, self.address.trial, number)
        if number not in self._images:
            with self.stages.timed("imaging"):
                self._images[number] = self.sights.image(view, address)
                self._images[number].setflags(write=False)
        pixels, attitude = self._images[number], planned.actual_R_cam_inertial.copy()
        turn = self.rotation.at(np.array([planned.time_s]))[0]
        sun_dir_cam = attitude @ turn.T @ view.sun_dir_body
        drawn = self.sights.drawn(view, address) if isinstance(self.sights, DrawnSights) else None

        def detect(path: Path) -> None:
            frame = Frame(pixels, sun_dir_cam, Pose(attitude, np.zeros(3)), np.eye(6), planned.time_s)
            if drawn is None:
                detections, reason = navigator.detect(own_copy(frame), task)
                check_detections(detections)
            else:
                detections, reason = navigator.most_confident(drawn[0]), ""
            write_detections(path, ImageDetections(planned.number, planned.time_s, detections, reason))

        name = f"{planned.number:05d}"
        found = own.cached(f"{name}.txt", "detection", detect, read_detections)
        exposure = Exposure(planned.number, planned.time_s, attitude, sun_dir_cam, pixels, found.detections)
        if drawn is not None:
            return SearchedImage(exposure, found.reason, drawn[1][: len(found.detections.ellipses)])

        def tell(path: Path) -> None:
            which = cast("RenderedSights", self.sights).which(found.detections.ellipses, view)
            write_atomically(path, lambda place: _save(place, which))

        return SearchedImage(exposure, found.reason, own.cached(f"{name}-truth.npy", "scoring", tell, np.load))


def searched_in(navigator: CraterNavigation, stages: StageFiles) -> StageFiles:
    """Return the folder of what a chain's detector finds: chains with the same one share it."""
    return stages.subfolder(f"detections-{navigator.options.detector}-{navigator.options.most_detections}")


def apriori_shape(world: OrbitWorld) -> AprioriShape:
    """Return the believed shape, in the axes that the true one came with."""
    believed, centre = world.onboard.shape, world.asteroid.centre_m
    mesh = believed.mesh()
    ground = MeshGround(TriangleMesh(mesh.vertices_m + centre, mesh.faces))
    return AprioriShape(ground, centre, believed.rms_m)


def _save(path: Path, which: IndexArray) -> None:
    with path.open("wb") as file:
        np.save(file, which, allow_pickle=False)

"""Simulated or real world of a scenario in this process: body, renderer, and the source of its images."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from boresight.campaign.imaging.image_store import Imager, open_ground, open_renderer
from boresight.campaign.imaging.ranges import longest_m, ranges_m, typical_range_m
from boresight.campaign.imaging.real_images import images_digest, open_images
from boresight.renderers.images import ImageSet, keep_clear_violation
from boresight.renderers.mitsuba3 import BodyRenderer, outlines_m
from boresight.renderers.stars import point_sources, star_pixels
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.bodies import Body, load_body
from boresight.scenarios.craters import CrateredSurface, check_size, shape_digest
from boresight.scenarios.draw import Stream, body_attitude, draw_aimed_view, drawn_together, generator, state_of_trial
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, TriangleMesh, View
from boresight.scenarios.geometry.mesh import winding_number
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.load.lengths import Scale, body_sides_m
from boresight.scenarios.onboard import onboard_spec
from boresight.scenarios.spec.body import BodySpec
from boresight.scenarios.spec.stars import open_stars
from boresight.scenarios.spec.trajectory import StatesSpec
from boresight.scenarios.spec.world import ViewpointSpec
from boresight.scenarios.stars import StarCatalog

_KEY_OF_BODY = re.compile(rf"(?<!\S)body(\.(?:{'|'.join(BodySpec.model_fields)})\b)")
_MOST_DRAWS = 1000
_CHECKED_STATES = 100
_LEAST_PX = 3.0
"""Body across in the image at the median range: no method finds anything in less."""


@dataclass(frozen=True, slots=True, eq=False)
class TrialImage:
    """Image (H, W) of one trial with its true view. Only experiments may use it, never an estimator.

    The view of a real image is that of the reference pose; ``further`` has those of other poses to score against, by
    name, ``covariance`` (6, 6) is that of the reference pose, [rotation_rad, translation_m] in camera axes, if it is
    known, and ``image_name`` is its file, else ''. ``time_s`` is the epoch of a real image or of a state of a
    trajectory, else 0, and ``velocity_m_s`` (3,) the velocity of the camera about the body, body axes, of a trajectory
    that has it. ``from_store`` says whether the image was rendered in an earlier run. ``R_body_inertial`` (3, 3) is
    the body's attitude if the image has stars.
    """

    image: NDArray[np.float32]
    view: View
    further: dict[str, View]
    image_name: str = ""
    time_s: float = 0.0
    from_store: bool = False
    velocity_m_s: FloatArray | None = None
    covariance: FloatArray | None = None
    R_body_inertial: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class RenderedImageSource:
    """Source of images of random views, rendered or read from the store."""

    scenario: LoadedScenario
    viewpoint: ViewpointSpec
    camera: Camera
    shape: TriangleMesh
    imager: Imager
    stars: StarCatalog | None = None

    def trial_image(self, seed: int, trial: int) -> TrialImage:
        """Draw a view, render it and expose the detector."""
        view, spec = self.view(seed, trial), drawn_together(self.scenario.spec, seed, trial)
        imager = self.imager if spec.correlated is None else self.imager.of(spec)
        states, state = self.viewpoint.states, state_of_trial(self.viewpoint, seed, trial)
        time_s = 0.0 if states is None else states.time_s[state]
        R_body_inertial = None if spec.stars is None else body_attitude(spec.stars, seed, trial, time_s)
        points_e_per_s = self._stars_e_per_s(view, R_body_inertial)
        velocity_m_s = None if states is None else states.velocity(state)
        noise = generator(seed, Stream.DETECTOR, trial)
        image, from_store = imager.image(view, seed, trial, noise, points_e_per_s, velocity_m_s)
        return TrialImage(image, view, {}, "", time_s, from_store, velocity_m_s, R_body_inertial=R_body_inertial)

    def _stars_e_per_s(self, view: View, R_body_inertial: FloatArray | None) -> FloatArray | None:
        """Return the light of the stars that the body does not hide, (H, W); None in a scenario without stars."""
        spec = self.scenario.spec
        if spec.stars is None or spec.detector is None or self.stars is None or R_body_inertial is None:
            return None
        uv, rates = star_pixels(view.camera, view.T_cam_body.rotation @ R_body_inertial, self.stars)
        rates *= spec.stars.zero_point(spec.camera.camera(), spec.detector)
        seen = ~self.imager.renderer.surface(view, uv).hit
        return point_sources(view.camera, uv[seen], rates[seen], spec.detector.psf_sigma_px)

    def flush(self) -> None:
        """Write rendered images to the store."""
        self.imager.flush()

    def view(self, seed: int, trial: int) -> View:
        """Draw views until the bodies are clear of the rectangles of the detector that must stay clear."""
        rng, clear = generator(seed, Stream.TRUTH, trial), self.viewpoint.keep_clear_px
        state, spec = state_of_trial(self.viewpoint, seed, trial), drawn_together(self.scenario.spec, seed, trial)
        viewpoint, surface = spec.viewpoint or self.viewpoint, self.imager.ground
        rng_second = generator(seed, Stream.SECOND_BODY, trial)
        second = None if spec.second_body is None else spec.second_body.draw(rng_second)
        for _ in range(_MOST_DRAWS):
            view = draw_aimed_view(viewpoint, spec.lighting, self.camera, self.shape, rng, state, surface)
            view = view if second is None else replace(view, T_body_second=second)
            outlines = outlines_m(self.imager.renderer, view) if clear else []
            if not any(keep_clear_violation(view, one, clear) for one in outlines):
                return view
        raise BoresightError(
            f"{self.scenario.path}: viewpoint.keep_clear_px: the body reached into it in {_MOST_DRAWS} views of trial"
            f" {trial}: make it smaller, or the range larger"
        )


@dataclass(frozen=True, slots=True, eq=False)
class ImageSetSource:
    """Source of the images of a set: trial t has image t modulo their number, so that few trials cover many images.

    ``poses`` names all poses to score against. With an ``imager`` views are rendered in place of reading images.
    """

    images: ImageSet
    realisations: int
    poses: tuple[str, ...] = ()
    imager: Imager | None = None

    def trial_image(self, seed: int, trial: int) -> TrialImage:
        """Read the trial's image, or render its view and expose the detector."""
        if trial >= len(self.images) * self.realisations:
            raise BoresightError(
                f"trial {trial}: the image set has {len(self.images)} images x {self.realisations} noise"
                f" realisations: ask for at most {len(self.images) * self.realisations} trials"
            )
        index, from_store = trial % len(self.images), False
        view = self.images.view(index)
        if self.imager is None:
            image = self.images.image(index)
        else:
            # One rendering of a view serves all its trials.
            noise = generator(seed, Stream.DETECTOR, trial)
            image, from_store = self.imager.image(view, seed, index, noise)
        further = {name: self.images.view(index, name) for name in self.poses}
        # The pose of a rendered view is exact.
        covariance = self.images.covariance(index) if self.imager is None else None
        name, time_s = self.images.names[index], self.images.time_s(index)
        return TrialImage(image, view, further, name, time_s, from_store, covariance=covariance)

    def view(self, seed: int, trial: int) -> View:
        """Return the view of the trial's image, with the reference pose."""
        del seed
        return self.images.view(trial % len(self.images))

    def flush(self) -> None:
        """Write rendered images to the store."""
        if self.imager is not None:
            self.imager.flush()


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """A scenario with its body, renderer and image source; ``ground`` is the surface of a cratered body."""

    scenario: LoadedScenario
    camera: Camera
    body: Body
    renderer: BodyRenderer
    source: RenderedImageSource | ImageSetSource
    ground: CrateredSurface | None = None


def believed(scenario: LoadedScenario) -> LoadedScenario:
    """Return a scenario as the spacecraft believes it to be."""
    return replace(scenario, spec=onboard_spec(scenario.spec))


def trial_limit(scenario: LoadedScenario) -> int | None:
    """Return the number of trials that a set of real images or their views allows; None without a set.

    Every image that is shown is read once, so that a damaged one is found before a campaign starts.
    """
    spec = scenario.spec
    if spec.images is None:
        return None
    images = open_images(scenario)
    if spec.real:
        images.check_images()
    return len(images) * spec.images.noise_realisations


def check_views(scenario: LoadedScenario) -> None:
    """Refuse a scenario that has neither simulated nor real images of single views."""
    if scenario.spec.viewpoint is None and scenario.spec.images is None:
        raise BoresightError(f"{scenario.path}: give either viewpoint or images")


def check_bodies(scenario: LoadedScenario) -> tuple[Body, Body]:
    """Refuse bodies that cannot be read, craters too many for this machine's memory, and views from inside the body.

    Otherwise everything built from them would fail, and the failure would be attributed to the method that needs it.
    Return the true and the onboard body: as long as a caller holds them, they are not read again.
    """
    spec = scenario.spec
    body = _loaded(scenario, "body", spec.body)
    believed = "body" if spec.onboard.body is None else "onboard.body"
    onboard = _loaded(scenario, believed, onboard_spec(spec).body)
    if spec.second_body is not None:
        _loaded(scenario, "second_body.body", spec.second_body.body)
    try:
        if spec.craters is not None:
            check_size(body.mesh, spec.craters)
    except BoresightError as error:
        raise BoresightError(f"{scenario.path}: {error}") from error
    _check_range(scenario, body.mesh)
    _check_second_body(scenario, body.mesh)
    if spec.viewpoint is not None and spec.viewpoint.states is not None:
        # Here and not for every process that opens the world: a hundred states take the whole mesh a hundred times.
        check_outside(scenario, body.mesh, spec.viewpoint.states, "viewpoint")
    return body, onboard


def _loaded(scenario: LoadedScenario, section: str, body: BodySpec) -> Body:
    """Load the body of a section; errors name its keys in the scenario, and the location of the first."""
    try:
        return load_body(body, scenario.search_dirs)
    except BoresightError as error:
        told = _KEY_OF_BODY.sub(lambda key: section + key[1], str(error))
        found = _KEY_OF_BODY.search(str(error))
        place = str(scenario.path) if found is None else scenario.place_of(section + found[1])
        raise BoresightError(f"{place}: {told}") from error


def scale_of(scenario: LoadedScenario) -> Scale:
    """Return what lengths that follow from a scenario are measured by."""
    spec = scenario.spec

    def m_per_px() -> float:
        known = spec.m_per_px
        return typical_range_m(scenario) / spec.camera.camera().fx_px if known is None else known

    frame_px2 = float(spec.camera.width_px * spec.camera.height_px)
    return Scale(m_per_px, partial(body_sides_m, spec.body, scenario.search_dirs), frame_px2)


def open_world(scenario: LoadedScenario, variant: str) -> World:
    """Open a scenario's world, cached per process: scenes cannot be pickled, so every worker builds its own."""
    # The digests are part of the cache's key, as a file may change under the same name.
    return _built(scenario, variant, shape_digest(scenario.spec, scenario.search_dirs), images_digest(scenario))


@lru_cache(maxsize=1)
def _built(scenario: LoadedScenario, variant: str, *_content: str) -> World:
    spec = scenario.spec
    camera = spec.camera.camera()
    body = load_body(spec.body, scenario.search_dirs)
    if spec.images is not None and spec.images.rendered:
        imager = Imager.open(scenario, variant, Stream.TRUTH, spec.images)
        views = ImageSetSource(open_images(scenario), spec.images.noise_realisations, imager=imager)
        return World(scenario, camera, body, imager.renderer, views, imager.ground)
    if spec.images is not None:
        real, ground = spec.images, open_ground(scenario)
        renderer = open_renderer(scenario, variant, ground)
        source = ImageSetSource(open_images(scenario), real.noise_realisations, (real.truth, *real.also_score))
        return World(scenario, camera, body, renderer, source, ground)
    if spec.viewpoint is None:
        raise BoresightError(f"{scenario.path}: give either viewpoint or images")
    _check_range(scenario, body.mesh)
    _check_second_body(scenario, body.mesh)
    together = () if spec.correlated is None else (spec.correlated,)
    imager = Imager.open(scenario, variant, Stream.TRUTH, spec.viewpoint, spec.lighting, *together)
    stars = None if spec.stars is None else open_stars(spec.stars, scenario.search_dirs)
    drawn = RenderedImageSource(scenario, spec.viewpoint, camera, body.mesh, imager, stars)
    return World(scenario, camera, body, imager.renderer, drawn, imager.ground)


_RANGE_KEYS = {
    "viewpoint": "viewpoint",
    "images": "images",
    "sequence": "sequence",
    "crater_pairs": "crater_pairs.range_m",
    "orbit": "orbit.arc.semi_major_axis_m",
}
"""Key that decides about the range, by the section of a scenario that has it."""


def _inner_radius_m(mesh: TriangleMesh) -> float:
    """Return the least distance of the surface from the body's origin, m."""
    from trimesh.triangles import closest_point  # only where a range decides whether an orbit is possible

    nearest = closest_point(mesh.corners_m, np.zeros((len(mesh.faces), 3)))
    return float(np.linalg.norm(nearest, axis=1).min())


def _check_range(scenario: LoadedScenario, mesh: TriangleMesh) -> None:
    """Refuse a range from which the body is a few pixels, or at which a view that has no state could be inside it."""
    spec, size_m = scenario.spec, longest_m(scenario, mesh)
    key = next(key for section, key in _RANGE_KEYS.items() if getattr(spec, section) is not None)
    shortest_m, range_m, _ = ranges_m(scenario, mesh)
    where = ""
    if spec.orbit is not None and spec.orbit.arc.approach is not None:
        key, where = "orbit.arc.approach.range_m", "in the middle of the approach, "
    across_px = size_m / range_m * spec.camera.camera().fx_px
    if across_px < _LEAST_PX:
        raise BoresightError(
            f"{scenario.path}: {key}: {where}at {range_m:g} m the body is {across_px:.2g} px long: choose a"
            f" shorter range, or a narrower camera.fov_deg; the body is {size_m:.4g} m long (if wrong: body.unit)"
        )
    sequence = spec.sequence
    about = sequence is not None and (sequence.sphere_radius_m, sequence.trajectory, sequence.tracks) == (None,) * 3
    if (spec.orbit is not None or about) and shortest_m <= (inner_m := _inner_radius_m(mesh)):
        raise BoresightError(
            f"{scenario.path}: {key}: the camera comes to {shortest_m:g} m from the origin of the body, all of whose"
            f" surface is {inner_m:.6g} m or more from it: choose a longer range"
        )
    viewpoint = spec.viewpoint
    if viewpoint is None or viewpoint.range_m is None:
        return
    x, y, z = mesh.vertices_m.T
    latitudes_deg = np.degrees(np.arctan2(z, np.hypot(x, y)))
    south_deg, north_deg = viewpoint.latitude_deg.uniform
    below = (latitudes_deg >= south_deg) & (latitudes_deg <= north_deg)
    reach_m = float(np.linalg.norm(mesh.vertices_m[below], axis=1).max(initial=0.0))
    if viewpoint.range_bounds_m[0] <= reach_m:
        raise BoresightError(
            f"{scenario.path}: viewpoint.range_m: {viewpoint.range_bounds_m[0]:g} m leads into the body, which reaches"
            f" {reach_m:.6g} m from its origin at those latitudes: choose a larger range"
        )


def _check_second_body(scenario: LoadedScenario, mesh: TriangleMesh) -> None:
    """Refuse a second body that reaches the first, and ranges at which the camera may be inside it."""
    second = scenario.spec.second_body
    if second is None:
        return
    axis_m, reach_m = second.semi_major_axis_m, load_body(second.body, scenario.search_dirs).mesh.radius_m
    if axis_m <= mesh.radius_m + reach_m:
        raise BoresightError(
            f"{scenario.path}: second_body.semi_major_axis_m: at {axis_m:g} m the second body, with a radius of"
            f" {reach_m:.6g} m, reaches the first, with one of {mesh.radius_m:.6g} m: choose a longer axis"
        )
    shortest_m, _, longest_m = ranges_m(scenario, mesh)
    if shortest_m <= axis_m + reach_m and longest_m >= axis_m - reach_m:
        raise BoresightError(
            f"{scenario.path}: viewpoint: ranges from {shortest_m:g} to {longest_m:g} m may lead into the second body,"
            f" {axis_m - reach_m:.6g} to {axis_m + reach_m:.6g} m from the origin: choose other ranges"
        )


def check_outside(scenario: LoadedScenario, mesh: TriangleMesh, states: StatesSpec, key: str) -> None:
    """Refuse states of a section's trajectory that are inside the body; the lowest are looked at."""
    positions_m = np.array(states.position_m)
    ranges_m = np.linalg.norm(positions_m, axis=1)
    lowest = np.argsort(ranges_m, kind="stable")[:_CHECKED_STATES]
    for row in lowest[ranges_m[lowest] <= mesh.radius_m]:
        if winding_number(mesh, positions_m[row]) > 0.5:
            raise BoresightError(
                f"{scenario.path}: {key}: row {row} (from 0) of the trajectory is inside the body: check its units"
                " and axes"
            )

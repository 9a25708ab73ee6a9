"""Simulated crater detections without images, and pairs of views of one place with them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.draw import Stream, degrade, generator, prior_covariance, turn_direction
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Ellipses, Pose, View, look_at, project_circles
from boresight.scenarios.observation import Frame
from boresight.scenarios.sequences.ground import MeshGround, faces_camera
from boresight.scenarios.spec.craters import CraterPairsSpec, DetectionErrorSpec, PlaneCratersSpec
from boresight.scenarios.spec.world import PoseErrorSpec

NO_CRATER = -1


@dataclass(frozen=True, slots=True, eq=False)
class PlaneCraters:
    """Craters as circles in planes tangent to the shape: centres (n, 3), outward unit normals (n, 3) and radii (n,)."""

    centre_body_m: FloatArray
    normal_body: FloatArray
    radius_m: FloatArray

    def __len__(self) -> int:
        return len(self.radius_m)


@dataclass(frozen=True, slots=True, eq=False)
class LabelledDetections:
    """n detected rims and the true crater of each, ``NO_CRATER`` for a detection of none that the truth lists.

    ``unlisted`` (n,) are detections of no listed crater that are smaller than the listed ones: whether there is a
    crater is not known. None where the truth lists craters of all sizes.
    """

    ellipses: Ellipses
    crater: IndexArray
    unlisted: BoolArray | None = None


def draw_plane_craters(ground: MeshGround, spec: PlaneCratersSpec) -> PlaneCraters:
    """Draw the craters of a body, uniform over its area with N(>r) proportional to r**-slope, from their own seed."""
    rng, slope = np.random.default_rng(spec.seed), spec.exponent
    points, normals = ground.sample(spec.count, rng)
    low, high = ((0.5 * diameter_m) ** (-slope) for diameter_m in (spec.min_diameter_m, spec.max_diameter_m))
    return PlaneCraters(points, normals, (low + rng.uniform(size=spec.count) * (high - low)) ** (-1.0 / slope))


def raise_craters(craters: PlaneCraters, height_m: float, rng: np.random.Generator) -> PlaneCraters:
    """Move craters along their normals by random height errors of the a priori shape."""
    height = rng.normal(0.0, height_m, len(craters))
    return PlaneCraters(
        craters.centre_body_m + height[:, None] * craters.normal_body, craters.normal_body, craters.radius_m
    )


def in_view(
    craters: PlaneCraters, ground: MeshGround, view: View, limits_deg: tuple[float, float, float]
) -> IndexArray:
    """Return the indices of the craters entirely in the frame, not occluded, with emission and incidence within limits.

    ``limits_deg`` are the largest emission, and the least and largest incidence.
    """
    position = view.T_cam_body.camera_position_m
    towards = position - craters.centre_body_m
    emission = _angle_deg(craters.normal_body, towards)
    incidence = _angle_deg(craters.normal_body, np.broadcast_to(view.sun_dir_body, towards.shape))
    seen = (emission < limits_deg[0]) & (incidence > limits_deg[1]) & (incidence < limits_deg[2])
    seen &= faces_camera(craters.centre_body_m, craters.normal_body, position)
    cam = view.T_cam_body.transform(craters.centre_body_m)
    radius_px = craters.radius_m / np.maximum(cam[:, 2], 1.0) / view.camera.pixel_angle_rad
    uv = view.camera.project(cam)
    size = np.array([view.camera.width_px, view.camera.height_px])
    with np.errstate(invalid="ignore"):
        seen &= ((uv > radius_px[:, None]) & (uv < size - radius_px[:, None])).all(axis=1)
    rows = np.flatnonzero(seen)
    lifted = craters.centre_body_m[rows] + 0.5 * craters.radius_m[rows, None] * craters.normal_body[rows]
    return rows[ground.in_sight(lifted, craters.normal_body[rows], position)]


def detect_simulated(
    craters: PlaneCraters, visible: IndexArray, view: View, errors: DetectionErrorSpec, rng: np.random.Generator
) -> LabelledDetections:
    """Simulate detections of the visible craters with errors, and false ones of similar size anywhere in the frame."""
    rims = project_circles(
        view, craters.centre_body_m[visible], craters.normal_body[visible], craters.radius_m[visible]
    )
    found = (rng.uniform(size=len(visible)) < errors.recall) & (rims.radius_px > errors.least_radius_px)
    rims, crater = _disturbed(rims[found], errors, rng), visible[found]
    count = rng.poisson(len(crater) * errors.false_share / (1.0 - errors.false_share)) if len(crater) else 0
    like = rng.integers(0, max(len(crater), 1), count)
    false_centres = rng.uniform(size=(count, 2)) * [view.camera.width_px, view.camera.height_px]
    false_rims = Ellipses(false_centres, rims.semi_axes_px[like], rng.uniform(0.0, np.pi, count))
    order = rng.permutation(len(crater) + count)
    both = Ellipses.joined([rims, false_rims])
    return LabelledDetections(both[order], np.concatenate([crater, np.full(count, NO_CRATER)])[order])


def _disturbed(rims: Ellipses, errors: DetectionErrorSpec, rng: np.random.Generator) -> Ellipses:
    sigma = np.hypot(errors.centre_px, errors.centre_radii * rims.radius_px)
    centre = rims.centre_px + sigma[:, None] * rng.normal(size=(len(rims), 2))
    axes = rims.semi_axes_px * np.exp(errors.axes_ratio * rng.normal(size=(len(rims), 2)))
    axes = np.maximum(axes + errors.axes_px * rng.normal(size=(len(rims), 2)), 0.5)
    swapped = axes[:, 1] > axes[:, 0]
    angle = np.where(swapped, rims.angle_rad + 0.5 * np.pi, rims.angle_rad) % np.pi
    return Ellipses(centre, np.where(swapped[:, None], axes[:, ::-1], axes), angle)


def _angle_deg(a: FloatArray, b: FloatArray) -> FloatArray:
    cross = np.linalg.norm(np.cross(a, b), axis=-1)
    return np.asarray(np.degrees(np.arctan2(cross, np.einsum("ni,ni->n", a, b))), dtype=np.float64)


_MOST_DRAWS = 2000  # of a target, before the angles are given up
LIMITS_DEG = (60.0, 20.0, 75.0)
"""Maximum emission, minimum and maximum incidence at which a crater is detected."""

_SECOND_DEG = (55.0, 15.0, 70.0)  # the same limits for the common target


@dataclass(frozen=True, slots=True, eq=False)
class CraterView:
    """One of the two views: the true view, its detections, and the frame with a priori knowledge."""

    view: View
    detections: LabelledDetections
    frame: Frame


@dataclass(frozen=True, slots=True, eq=False)
class CraterPair:
    """Two views, and the angles between their camera directions and Sun directions, deg."""

    first: CraterView
    second: CraterView
    view_deg: float
    sun_deg: float


def draw_pair(
    spec: CraterPairsSpec,
    pose_error: PoseErrorSpec,
    camera: Camera,
    ground: MeshGround,
    craters: PlaneCraters,
    address: tuple[int, int],
) -> CraterPair:
    """Draw the pair of a trial; ``address`` is the seed and the number of the trial.

    Raise BoresightError if no two views with the required angles have a lit and visible target.
    """
    views, angles = draw_views(spec, camera, ground, generator(address[0], Stream.TRUTH, address[1]))
    noise, priors = (generator(address[0], stream, address[1]) for stream in (Stream.LANDMARKS, Stream.POSE_ERROR))
    real = raise_craters(craters, spec.errors.height_m, noise)  # the same height errors in both views
    looks = []
    for number, view in enumerate(views):
        visible = in_view(craters, ground, view, LIMITS_DEG)
        found = detect_simulated(real, visible, view, spec.errors, noise)
        black = np.zeros((camera.height_px, camera.width_px), dtype=np.float32)
        looks.append(CraterView(view, found, observed_frame(view, black, pose_error, priors, float(number))))
    return CraterPair(looks[0], looks[1], *angles)


def draw_views(
    spec: CraterPairsSpec, camera: Camera, ground: MeshGround, rng: np.random.Generator
) -> tuple[tuple[View, View], tuple[float, float]]:
    """Draw targets and directions until the target is visible and lit in both views."""
    angles = (float(spec.view_deg.draw(rng)), float(spec.sun_deg.draw(rng)))
    for _ in range(_MOST_DRAWS):
        points, normals = ground.sample(1, rng)
        place, normal = points[0], normals[0]
        one = turn_direction(normal, np.radians(spec.emission_deg.draw(rng)), rng.uniform(0.0, 2.0 * np.pi))
        other = turn_direction(one, np.radians(angles[0]), rng.uniform(0.0, 2.0 * np.pi))
        sun = turn_direction(normal, np.radians(spec.incidence_deg.draw(rng)), rng.uniform(0.0, 2.0 * np.pi))
        later = turn_direction(sun, np.radians(angles[1]), rng.uniform(0.0, 2.0 * np.pi))
        emission, incidence = np.degrees(np.arccos(np.clip([other @ normal, later @ normal], -1.0, 1.0)))
        # A metre above the surface, so that the target's own facet does not occlude it.
        above = (place + 1.0 * normal)[None]
        seen = all(ground.in_sight(above, normal[None], place + spec.range_m * d)[0] for d in (one, other))
        if seen and emission < _SECOND_DEG[0] and _SECOND_DEG[1] < incidence < _SECOND_DEG[2]:
            aims = place + rng.normal(0.0, spec.aim_sigma_m, (2, 3))
            views = [
                _look(camera, place + spec.range_m * towards, aim, light, rng)
                for towards, aim, light in zip((one, other), aims, (sun, later), strict=True)
            ]
            return (views[0], views[1]), angles
    raise BoresightError(
        f"crater_pairs: no place of the body is in sight and in the light of two looks {angles[0]:.3g} deg apart with"
        f" Suns {angles[1]:.3g} deg apart, in {_MOST_DRAWS} draws: make view_deg or sun_deg smaller"
    )


def _look(camera: Camera, position_m: FloatArray, aim_m: FloatArray, sun: FloatArray, rng: np.random.Generator) -> View:
    # look_at points at the origin: the rotation is that of a camera at the same offset from the aim.
    rotation = look_at(position_m - aim_m, float(rng.uniform(-np.pi, np.pi))).rotation
    return View(camera, Pose(rotation, -rotation @ position_m), sun)


def observed_frame(
    view: View, image: NDArray[np.float32], pose_error: PoseErrorSpec, rng: np.random.Generator, time_s: float
) -> Frame:
    """Make the frame of a view: image, Sun direction in camera axes and degraded prior pose."""
    true, camera = view.T_cam_body, view.camera
    prior = degrade(true, pose_error, camera, rng)
    return Frame(
        image,
        true.rotate(view.sun_dir_body),
        prior,
        prior_covariance(pose_error, prior, camera),
        time_s,
    )

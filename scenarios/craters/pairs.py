"""Pairs of views of one place of a body under different geometry, with simulated crater detections."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.craters.simulated import (
    DetectionErrors,
    LabelledDetections,
    PlaneCraters,
    detect_simulated,
    in_view,
    raise_craters,
    sample_plane_craters,
)
from boresight.scenarios.draw import Stream, degrade, generator, prior_covariance
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Pose, View, look_at
from boresight.scenarios.observation import Frame
from boresight.scenarios.sequences.ground import MeshGround
from boresight.scenarios.spec.craters import CraterPairsSpec, PlaneCratersSpec
from boresight.scenarios.spec.world import PoseErrorSpec

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


def draw_plane_craters(ground: MeshGround, spec: PlaneCratersSpec) -> PlaneCraters:
    """Draw the craters of a body from the seed of its spec."""
    radii = (0.5 * spec.min_diameter_m, 0.5 * spec.max_diameter_m)
    return sample_plane_craters(ground, spec.count, radii, spec.exponent, np.random.default_rng(spec.seed))


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
    errors = DetectionErrors(**spec.errors.model_dump())
    real = raise_craters(craters, errors.height_m, noise)  # the same height errors in both views
    looks = []
    for number, view in enumerate(views):
        visible = in_view(craters, ground, view, LIMITS_DEG)
        found = detect_simulated(real, visible, view, errors, noise)
        black = np.zeros((camera.height_px, camera.width_px), dtype=np.float32)
        looks.append(CraterView(view, found, observed_frame(view, black, pose_error, priors, float(number))))
    return CraterPair(looks[0], looks[1], *angles)


def turn_direction(direction: FloatArray, angle_rad: float, azimuth_rad: float) -> FloatArray:
    """Rotate a unit vector (3,) by an angle towards an azimuth about it."""
    # The coordinate axis farthest from the direction gives a well-conditioned product.
    first = np.cross(direction, np.eye(3)[int(np.argmin(np.abs(direction)))])
    first /= np.linalg.norm(first)
    across = np.cos(azimuth_rad) * first + np.sin(azimuth_rad) * np.cross(direction, first)
    return np.asarray(np.cos(angle_rad) * direction + np.sin(angle_rad) * across)


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

"""Two looks at craters on an ellipsoid of the size of Eros, with detections drawn by geometry."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from boresight.estimators.craters.contract import CraterDetections, CraterImage, CraterMatches
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.craters.simulated import (
    NO_CRATER,
    PlaneCraters,
    detect_simulated,
    draw_plane_craters,
    in_view,
    raise_craters,
)
from boresight.scenarios.draw import turn_direction
from boresight.scenarios.geometry import Camera, Pose, TriangleMesh, View, look_at
from boresight.scenarios.observation import Frame
from boresight.scenarios.sequences.ground import MeshGround
from boresight.scenarios.spec.craters import DetectionErrorSpec, PlaneCratersSpec

CAMERA = Camera.from_fov(537, 412, np.radians(2.93))
RANGE_M = 200e3


def ellipsoid(subdivisions: int = 4) -> MeshGround:
    ball = trimesh.creation.icosphere(subdivisions)
    return MeshGround(TriangleMesh(np.array(ball.vertices) * [17e3, 8.5e3, 6e3], np.array(ball.faces, dtype=np.int32)))


def population(ground: MeshGround, seed: int, count: int = 700) -> PlaneCraters:
    sizes = {"min_diameter_m": 220.0, "max_diameter_m": 5000.0, "exponent": 1.8}
    return draw_plane_craters(ground, PlaneCratersSpec(count=count, seed=seed, **sizes))


@dataclass(frozen=True)
class Look:
    """An image, and which crater each detection is."""

    image: CraterImage
    crater: NDArray[np.int64]


def turned(direction: FloatArray, angle_deg: float, azimuth_rad: float) -> FloatArray:
    """Turn a unit vector by an angle, towards an azimuth."""
    return turn_direction(direction, np.radians(angle_deg), azimuth_rad)


def look(
    number: int,
    ground: MeshGround,
    craters: PlaneCraters,
    target_m: FloatArray,
    directions: tuple[FloatArray, FloatArray],
    rng: np.random.Generator,
    errors: DetectionErrorSpec | None = None,
    position_sigma_m: float = 200.0,
    pixels: NDArray[np.float32] | None = None,
) -> Look:
    """Look at a target from a direction, with the Sun in another; the prior is off by a shift of the camera."""
    towards_camera, towards_sun = directions
    errors = errors or DetectionErrorSpec()
    position = target_m + RANGE_M * towards_camera
    attitude = look_at(position - target_m, rng.uniform(0.0, 2.0 * np.pi)).rotation
    view = View(CAMERA, Pose(attitude, -attitude @ position), towards_sun)
    visible = in_view(craters, ground, view, (60.0, 20.0, 75.0))
    found = detect_simulated(raise_craters(craters, errors.height_m, rng), visible, view, errors, rng)
    prior = view.T_cam_body.perturbed(np.zeros(3), rng.normal(0.0, position_sigma_m, 3))
    covariance = np.diag([1e-12] * 3 + [position_sigma_m**2] * 3)
    image = np.zeros((CAMERA.height_px, CAMERA.width_px), np.float32) if pixels is None else pixels
    frame = Frame(image, view.T_cam_body.rotate(view.sun_dir_body), prior, covariance)
    detections = CraterDetections(found.ellipses, np.ones(len(found.crater)))
    return Look(CraterImage(number, frame, CAMERA, detections), found.crater)


def pair(
    ground: MeshGround,
    craters: PlaneCraters,
    seed: int,
    view_deg: float,
    sun_deg: float,
    errors: DetectionErrorSpec | None = None,
    position_sigma_m: float = 200.0,
) -> tuple[Look, Look]:
    """Look twice at one place."""
    rng = np.random.default_rng(seed)
    points, normals = ground.sample(1, rng)
    towards, sun = turned(normals[0], 15.0, rng.uniform(0, 6)), turned(normals[0], 40.0, rng.uniform(0, 6))
    cameras = (towards, turned(towards, view_deg, rng.uniform(0, 6)))
    # Turned away from the limb of light: back over the normal.
    suns = (sun, turned(normals[0], abs(40.0 - sun_deg), 0.0) if sun_deg > 40.0 else turned(sun, sun_deg, 1.0))
    looks = [
        look(k, ground, craters, points[0], (cameras[k], suns[k]), rng, errors, position_sigma_m) for k in range(2)
    ]
    return looks[0], looks[1]


def counts(matches: CraterMatches, first: Look, second: Look) -> tuple[int, int, int]:
    """Count craters that both images detected, right matches and wrong ones."""
    common = np.intersect1d(first.crater[first.crater != NO_CRATER], second.crater)
    here, there = first.crater[matches.pairs[:, 0]], second.crater[matches.pairs[:, 1]]
    right = int(np.sum((here == there) & (here != NO_CRATER)))
    return len(common), right, len(matches.pairs) - right

"""Images planned along an a priori orbit: the nadir when it is lit, near the lit limb, near the terminator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scenarios.draw import TARGET_KINDS, TargetKind, emission_incidence_deg, is_lit_and_facing, near_limb_or_terminator
from scenarios.dynamics.propagation import PiecewiseAcceleration
from scenarios.dynamics.variational import propagate_partials
from scenarios.errors import BoresightError
from scenarios.geometry import look_at
from scenarios.orbits.data import Knowledge
from scenarios.sequences.ground import MeshGround

PLANNER, PLANNER_VERSION = "planner", 1
"""What plans are made by: raise the version when they change."""

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_AT_ONCE = 64


def plan_arc(
    knowledge: Knowledge,
    sun_dir_inertial: FloatArray,
    times_s: FloatArray,
    ground: MeshGround,
    centre_of_mass_m: FloatArray,
) -> tuple[PlannedImage, ...]:
    """Map the a priori orbit to ``times_s``, (n,) ascending, and plan an image at each where ground is lit.

    ``centre_of_mass_m``, (3,), is where that lies in the axes of ``ground``.

    Raises
    ------
    OrbitLostError
        If the a priori orbit leads into the body.
    """
    flown = propagate_partials(
        knowledge.field, knowledge.state, times_s, PiecewiseAcceleration.none(float(times_s[-1]))
    )
    attitudes = knowledge.field.rotation.at(times_s)
    positions = flown.states[:, :3] + np.einsum("nji,j->ni", attitudes, centre_of_mass_m)
    suns = np.broadcast_to(sun_dir_inertial, positions.shape)
    return plan_images(Ephemeris(times_s, positions, attitudes, suns), ground)


@dataclass(frozen=True, slots=True, eq=False)
class Ephemeris:
    """What is known beforehand at each of n epochs.

    Parameters
    ----------
    time_s
        (n,) ascending.
    position_inertial_m
        (n, 3) of the spacecraft about the origin of the axes of the ground: the a priori orbit.
    R_body_inertial
        (n, 3, 3) attitude of the body.
    sun_dir_inertial
        (n, 3) unit vectors towards the Sun.
    """

    time_s: FloatArray
    position_inertial_m: FloatArray
    R_body_inertial: FloatArray
    sun_dir_inertial: FloatArray

    def __post_init__(self) -> None:
        n = len(self.time_s)
        shapes = (self.position_inertial_m.shape, self.R_body_inertial.shape, self.sun_dir_inertial.shape)
        if shapes != ((n, 3), (n, 3, 3), (n, 3)):
            raise BoresightError(f"{n} epochs need (n, 3) positions, (n, 3, 3) attitudes and (n, 3) Suns, not {shapes}")


@dataclass(frozen=True, slots=True, eq=False)
class PlannedImage:
    """One image of a plan.

    Parameters
    ----------
    number, time_s
        Of the image, and of its shutter.
    kind
        Why it is taken.
    target_body_m
        (3,) ground that the boresight meets.
    planned_R_cam_inertial, actual_R_cam_inertial
        (3, 3) pointing as planned and as telemetry tells it; the same until telemetry comes.
    sun_dir_nadir
        (3,) direction of the Sun relative to the nadir: in axes of a camera that looks there with north up.
    """

    number: int
    time_s: float
    kind: TargetKind
    target_body_m: FloatArray
    planned_R_cam_inertial: FloatArray
    actual_R_cam_inertial: FloatArray
    sun_dir_nadir: FloatArray


def plan_images(
    ephemeris: Ephemeris, ground: MeshGround, kinds: Sequence[TargetKind] = TARGET_KINDS
) -> tuple[PlannedImage, ...]:
    """Plan one image for each epoch, the kinds in turn.

    Where no ground of the kind whose turn it is is lit and in sight, the next kind takes its place; an epoch from
    which no ground is of any kind has no image.
    """
    images: list[PlannedImage] = []
    for epoch in range(len(ephemeris.time_s)):
        attitude = ephemeris.R_body_inertial[epoch]
        position, sun = attitude @ ephemeris.position_inertial_m[epoch], attitude @ ephemeris.sun_dir_inertial[epoch]
        turn = len(images) % len(kinds)
        for kind in (*kinds[turn:], *kinds[:turn]):
            target = find_target(ground, position, sun, kind)
            if target is not None:
                looking = look_at(position - target).rotation @ attitude
                seen = look_at(position).rotation @ sun
                time_s = float(ephemeris.time_s[epoch])
                images.append(PlannedImage(len(images), time_s, kind, target, looking, looking, seen))
                break
    return tuple(images)


def with_telemetry(images: Sequence[PlannedImage], turned_rad: FloatArray) -> tuple[PlannedImage, ...]:
    """Write what telemetry says of the pointing: each planned one turned by a rotation vector (n, 3) in camera axes."""
    if turned_rad.shape != (len(images), 3):
        raise BoresightError(f"{len(images)} images need ({len(images)}, 3) rotation vectors, not {turned_rad.shape}")
    turns = Rotation.from_rotvec(turned_rad.reshape(-1, 3)).as_matrix() if len(images) else np.zeros((0, 3, 3))
    return tuple(
        replace(image, actual_R_cam_inertial=turn @ image.planned_R_cam_inertial)
        for image, turn in zip(images, turns, strict=True)
    )


def find_target(
    ground: MeshGround, position_body_m: FloatArray, sun_dir_body: FloatArray, kind: TargetKind
) -> FloatArray | None:
    """Find ground of a kind that is lit and in sight, (3,): that nearest to the line of sight to the nadir; or None."""
    if kind == "nadir":
        return _lit_nadir(ground, position_body_m, sun_dir_body)
    places, normals = ground.mesh.corners_m.mean(axis=1), ground.mesh.normals
    emission, incidence = emission_incidence_deg(places, normals, position_body_m, sun_dir_body)
    rows = np.flatnonzero(near_limb_or_terminator(kind, emission, incidence) & is_lit_and_facing(emission, incidence))
    rays = places[rows] - position_body_m
    off_nadir = rays @ -position_body_m / np.linalg.norm(rays, axis=1)
    rows = rows[np.argsort(-off_nadir, kind="stable")]
    for start in range(0, len(rows), _AT_ONCE):
        some = rows[start : start + _AT_ONCE]
        seen = ground.in_sight(places[some], normals[some], position_body_m)
        if seen.any():
            return np.asarray(places[some[int(np.argmax(seen))]], dtype=np.float64)
    return None


def _lit_nadir(ground: MeshGround, position: FloatArray, sun: FloatArray) -> FloatArray | None:
    """(3,) where the line to the body's origin meets it, if that is in the light."""
    points, normals = ground.intersect(position[None], -position[None] / np.linalg.norm(position))
    if not np.isfinite(points).all():
        return None
    emission, incidence = emission_incidence_deg(points, normals, position, sun)
    return points[0] if is_lit_and_facing(emission, incidence)[0] else None

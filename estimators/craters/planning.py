"""Planning of images along an orbit after Cheng et al. (2003): the lit nadir, near the lit limb, near the terminator.

The plan file is text, one record a line::

    # boresight image plan 1
    image NUMBER TIME KIND TX TY TZ P11 P12 P13 P21 P22 P23 P31 P32 P33 A11 .. A33 SX SY SZ

``TIME`` is that of the shutter in seconds, ``T`` the target of the boresight on the ground, in metres and body axes,
``P`` and ``A`` the planned and the telemetered rotation from inertial to camera axes, row by row, and ``S`` the
direction of the Sun in the axes of a camera that points to the nadir.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import numpy as np
from scipy.spatial.transform import Rotation

from boresight.estimators.craters.database.files import TextRecord, format_record, read_records, write_records
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.draw import (
    TARGET_KINDS,
    TargetKind,
    emission_incidence_deg,
    is_lit_and_facing,
    near_limb_or_terminator,
)
from boresight.scenarios.dynamics.propagation import PiecewiseAcceleration, propagate_partials
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import look_at
from boresight.scenarios.orbits.data import Knowledge
from boresight.scenarios.sequences.ground import MeshGround

PLANNER, PLANNER_VERSION = "planner", 1
"""Name and version of the planner: raise the version when plans change."""


_BLOCK_SIZE = 64  # facets tested for visibility at once
_HEAD = "boresight image plan 1"


def plan_arc(
    knowledge: Knowledge,
    sun_dir_inertial: FloatArray,
    times_s: FloatArray,
    ground: MeshGround,
    centre_of_mass_m: FloatArray,
) -> tuple[PlannedImage, ...]:
    """Propagate the a priori orbit to ``times_s``, (n,) ascending, and plan an image at each if there is lit ground.

    ``centre_of_mass_m``, (3,), is its position in the axes of ``ground``. Raise OrbitLostError if the a priori orbit
    hits the body.
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
    """A priori positions and attitudes at n epochs; ``time_s`` (n,) ascends.

    ``position_inertial_m`` (n, 3) are those of the spacecraft relative to the origin of the axes of the ground: the a
    priori orbit. ``R_body_inertial`` (n, 3, 3) is the attitude of the body, and ``sun_dir_inertial`` (n, 3) are unit
    vectors towards the Sun.
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
    """One image of a plan; ``time_s`` is that of its shutter, ``kind`` that of its target.

    ``target_body_m`` (3,) is the point of the ground on the boresight. ``planned_R_cam_inertial`` and
    ``actual_R_cam_inertial`` (3, 3) are planned and telemetered pointing; the same until telemetry is added.
    ``sun_dir_nadir`` (3,) is the direction of the Sun in the axes of a camera that points to the nadir, north up.
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

    If no ground of the kind in turn is lit and visible, the next kind is tried; an epoch without ground of any kind has
    no image.
    """
    images: list[PlannedImage] = []
    for epoch in range(len(ephemeris.time_s)):
        attitude = ephemeris.R_body_inertial[epoch]
        position, sun = attitude @ ephemeris.position_inertial_m[epoch], attitude @ ephemeris.sun_dir_inertial[epoch]
        turn = len(images) % len(kinds)
        for kind in (*kinds[turn:], *kinds[:turn]):
            target = find_target(ground, position, sun, kind)
            if target is not None:
                # look_at points to the origin of its axes: shifted by the target, that is where the boresight goes.
                looking = look_at(position - target).rotation @ attitude
                seen = look_at(position).rotation @ sun
                time_s = float(ephemeris.time_s[epoch])
                images.append(PlannedImage(len(images), time_s, kind, target, looking, looking, seen))
                break
    return tuple(images)


def with_telemetry(images: Sequence[PlannedImage], turned_rad: FloatArray) -> tuple[PlannedImage, ...]:
    """Set the telemetered pointing: each planned one rotated by a rotation vector (n, 3) in camera axes."""
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
    """Find lit and visible ground of a kind, (3,): that nearest to the line of sight to the nadir; None if none."""
    if kind == "nadir":
        return _lit_nadir(ground, position_body_m, sun_dir_body)
    places, normals = ground.mesh.corners_m.mean(axis=1), ground.mesh.normals
    emission, incidence = emission_incidence_deg(places, normals, position_body_m, sun_dir_body)
    rows = np.flatnonzero(near_limb_or_terminator(kind, emission, incidence) & is_lit_and_facing(emission, incidence))
    rays = places[rows] - position_body_m
    # Range times the cosine of the angle from the nadir: the largest is the nearest to the nadir.
    off_nadir = rays @ -position_body_m / np.linalg.norm(rays, axis=1)
    # Tested from the nadir outwards, so that the first visible facet is the nearest.
    rows = rows[np.argsort(-off_nadir, kind="stable")]
    for start in range(0, len(rows), _BLOCK_SIZE):
        some = rows[start : start + _BLOCK_SIZE]
        seen = ground.in_sight(places[some], normals[some], position_body_m)
        if seen.any():
            return np.asarray(places[some[int(np.argmax(seen))]], dtype=np.float64)
    return None


def _lit_nadir(ground: MeshGround, position: FloatArray, sun: FloatArray) -> FloatArray | None:
    """Return (3,) the intersection of the line to the body's origin with the ground if it is lit, else None."""
    points, normals = ground.intersect(position[None], -position[None] / np.linalg.norm(position))
    if not np.isfinite(points).all():
        return None
    emission, incidence = emission_incidence_deg(points, normals, position, sun)
    return points[0] if is_lit_and_facing(emission, incidence)[0] else None


def write_plan(path: Path, images: Sequence[PlannedImage]) -> None:
    """Write a plan, whole or not at all."""
    lines = []
    for image in images:
        pointing = (*image.planned_R_cam_inertial.ravel(), *image.actual_R_cam_inertial.ravel())
        lines.append(
            format_record(
                "image", image.number, image.time_s, image.kind, *image.target_body_m, *pointing, *image.sun_dir_nadir
            )
        )
    write_records(path, _HEAD, lines)


def read_plan(path: Path) -> tuple[PlannedImage, ...]:
    """Read a plan; raise BoresightError with file and line if a record is malformed, or a number is listed twice."""
    images: list[PlannedImage] = []
    seen: set[int] = set()
    for record in read_records(path, _HEAD, {"image": 27}):
        image = _image(record)
        if image.number in seen:
            raise record.error(f"image {image.number} is listed twice")
        seen.add(image.number)
        images.append(image)
    return tuple(images)


def _image(record: TextRecord) -> PlannedImage:
    kinds: tuple[TargetKind, ...] = get_args(TargetKind)
    kind = next((one for one in kinds if one == record.fields[2]), None)
    if kind is None:
        raise record.error(f"{record.fields[2]!r} is no kind of image; there are: {', '.join(kinds)}")
    time_s, values = record.numbers(1, 2)[0], np.array(record.numbers(3, 27))
    planned, actual = values[3:12].reshape(3, 3), values[12:21].reshape(3, 3)
    return PlannedImage(record.integer(0), time_s, kind, values[:3], planned, actual, values[21:])

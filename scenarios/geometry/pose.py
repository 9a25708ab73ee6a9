"""Rigid transforms with named frames, and vector operations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation


def cross_matrix(vectors: FloatArray) -> FloatArray:
    """(..., 3, 3) skew-symmetric matrices [v]x of vectors v (..., 3): [v]x w = v x w."""
    cross = np.zeros((*vectors.shape, 3))
    cross[..., 2, 1] = vectors[..., 0]
    cross[..., 0, 2] = vectors[..., 1]
    cross[..., 1, 0] = vectors[..., 2]
    return np.asarray(cross - np.swapaxes(cross, -1, -2), dtype=np.float64)


def angle_between(first: FloatArray, second: FloatArray) -> float:
    """Return the angle between two vectors (3,) of any length, rad."""
    (a, b, c), (x, y, z) = first.tolist(), second.tolist()
    # In place of numpy's cross product, which takes ten times as long for one pair.
    cross = np.array([b * z - c * y, c * x - a * z, a * y - b * x])
    # The arc tangent keeps the digits of small angles, of which the arc cosine loses half.
    return float(np.arctan2(np.linalg.norm(cross), first @ second))


def spherical_direction(longitude_rad: FloatArray | float, latitude_rad: FloatArray | float) -> FloatArray:
    """Return unit vectors (..., 3) towards longitudes and latitudes, or right ascensions and declinations."""
    c = np.cos(latitude_rad)
    parts = c * np.cos(longitude_rad), c * np.sin(longitude_rad), np.sin(latitude_rad)
    return np.stack(np.broadcast_arrays(*parts), axis=-1)


def plane_axes(normals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two unit vectors (n, 3) perpendicular to each unit normal (n, 3); first, second, normal are right-handed."""
    # The coordinate axis farthest from the normal: the product cannot vanish.
    helper = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    first = np.cross(normals, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(normals, first)


def orbit_axes(normal: FloatArray) -> FloatArray:
    """(3, 3) rows: the direction of zero anomaly, the one 90 deg on, and the normal of an orbit, of any length.

    Zero anomaly is the orbit's point nearest to the x axis, or to the y axis if the normal is along x.
    """
    normal = normal / np.linalg.norm(normal)
    # Within 0.08 deg of x its projection on the orbit's plane has no digits.
    along = np.eye(3)[0] if abs(normal[0]) < 0.999999 else np.eye(3)[1]
    first = along - (along @ normal) * normal
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first), normal])


class FrameMismatchError(BoresightError):
    """Raised when transforms with different inner frames are chained."""


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """A rigid transform ``x_to = rotation @ x_from + translation_m`` from ``from_frame`` to ``to_frame``.

    The translation (3,) is the origin of ``from_frame`` in ``to_frame`` coordinates: the T of Rowell et al. (2015),
    equation (4).
    """

    rotation: FloatArray
    translation_m: FloatArray
    to_frame: str = "cam"
    from_frame: str = "body"

    def __post_init__(self) -> None:
        for name in ("rotation", "translation_m"):
            value = np.array(getattr(self, name), dtype=np.float64)
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        if self.rotation.shape != (3, 3) or self.translation_m.shape != (3,):
            raise BoresightError(
                f"a pose needs a (3, 3) rotation and a (3,) translation,"
                f" not {self.rotation.shape} and {self.translation_m.shape}"
            )

    @classmethod
    def from_quat_wxyz(
        cls, quat_wxyz: FloatArray, translation_m: FloatArray, to_frame: str = "cam", from_frame: str = "body"
    ) -> Pose:
        """Build from a quaternion in the order (w, x, y, z), normalised here; Rowell et al. (2015), equation (8)."""
        rotation = _rotations().from_quat(np.asarray(quat_wxyz, dtype=np.float64), scalar_first=True).as_matrix()
        return cls(rotation, translation_m, to_frame, from_frame)

    @property
    def quat_wxyz(self) -> FloatArray:
        """The rotation as a unit quaternion (w, x, y, z) with w >= 0."""
        return _rotations().from_matrix(self.rotation).as_quat(canonical=True, scalar_first=True)

    @property
    def camera_position_m(self) -> FloatArray:
        """Origin of ``to_frame`` in ``from_frame`` coordinates, (3,): for T_cam_body the camera in the body."""
        return -self.rotation.T @ self.translation_m

    def __matmul__(self, other: Pose) -> Pose:
        if self.from_frame != other.to_frame:
            raise FrameMismatchError(
                f"T_{self.to_frame}_{self.from_frame} @ T_{other.to_frame}_{other.from_frame}:"
                f" {self.from_frame} is not {other.to_frame}"
            )
        return Pose(
            self.rotation @ other.rotation,
            self.rotation @ other.translation_m + self.translation_m,
            self.to_frame,
            other.from_frame,
        )

    def inverse(self) -> Pose:
        """Return the inverse transform."""
        return Pose(self.rotation.T, self.camera_position_m, self.from_frame, self.to_frame)

    def transform(self, points_m: FloatArray) -> FloatArray:
        """Take points (..., 3) in ``from_frame`` to ``to_frame``."""
        # R x for rows x.
        return np.asarray(points_m, dtype=np.float64) @ self.rotation.T + self.translation_m

    def rotate(self, vectors: FloatArray) -> FloatArray:
        """Take vectors (..., 3) in ``from_frame`` to ``to_frame``, without the translation."""
        return np.asarray(vectors, dtype=np.float64) @ self.rotation.T

    def perturbed(self, rotation_rad: FloatArray, translation_m: FloatArray) -> Pose:
        """Perturb the attitude by ``exp(rotation_rad)`` on the left and the translation additively.

        ``R' = exp(w) R`` and ``t' = t + d``, both in ``to_frame``. The two are independent: a rotation of the
        body about its own origin does not move that origin in the camera.
        """
        delta = _rotations().from_rotvec(np.asarray(rotation_rad, dtype=np.float64)).as_matrix()
        return Pose(
            delta @ self.rotation,
            self.translation_m + np.asarray(translation_m, dtype=np.float64),
            self.to_frame,
            self.from_frame,
        )

    def angle_to(self, other: Pose) -> float:
        """Return the angle, rad, of the rotation that takes one attitude to the other."""
        return float(_rotations().from_matrix(self.rotation @ other.rotation.T).magnitude())


def _rotations() -> type[Rotation]:
    """Return scipy's class, imported when it is first needed: all schemas import this module, and scipy takes 0.3 s."""
    from scipy.spatial.transform import Rotation

    return Rotation


def look_at(camera_position_body_m: FloatArray, roll_rad: float = 0.0) -> Pose:
    """Point a camera's boresight at the body's origin: T_cam_body.

    At zero roll the camera's y axis (down) points away from the body's z axis, so that north is up; over a pole the
    body's x axis replaces it. ``roll_rad`` turns the camera's axes about its boresight, x towards y. Raise
    BoresightError if the camera is at the origin.
    """
    position = np.asarray(camera_position_body_m, dtype=np.float64)
    distance = float(np.linalg.norm(position))
    if not distance > 0.0:
        raise BoresightError("a camera at the body's origin has no direction to look: choose a range above 0 m")
    forward = -position / distance
    # Within 0.08 deg of a pole, where the direction of north has no digits.
    north = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 0.999999 else np.array([1.0, 0.0, 0.0])
    # x right, y down, z forward: with north up, right = forward x up and down = forward x right.
    right = np.cross(forward, north)
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    cos_roll, sin_roll = np.cos(roll_rad), np.sin(roll_rad)
    # Rows are the camera axes in the body frame.
    rotation = np.stack([cos_roll * right + sin_roll * down, -sin_roll * right + cos_roll * down, forward])
    return Pose(rotation, -rotation @ position)

"""Landmarks of the crater database: the a priori positions of numbered craters, located on the shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.estimators.craters.contract import CraterImage, GroundModel
from boresight.estimators.craters.database.numbering import Numbering
from boresight.estimators.craters.matching.preliminary import landmark_covariances
from boresight.estimators.craters.matching.transfer import locate_craters
from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.orbits.data import LandmarkFile

# No crater: number, position, normal, logarithm of the radius, covariance.
_NOWHERE = np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3, 3))


@dataclass(frozen=True, slots=True, eq=False)
class Landmarks:
    """Craters of the database, ascending by number.

    ``number`` (n,) has each once. ``position_body_m`` (n, 3) are the centres of the rims, ``covariance_m2`` (n, 3, 3)
    is that of these, ``normal_body`` (n, 3) are the outward unit normals of the rims' planes, and ``radius_m`` (n,)
    their radii. ``images`` (n,) is the number of images in which each was found.
    """

    number: IndexArray
    position_body_m: FloatArray
    normal_body: FloatArray
    radius_m: FloatArray
    covariance_m2: FloatArray
    images: IndexArray

    def __post_init__(self) -> None:
        n = len(self.number)
        shapes = tuple(part.shape for part in (self.position_body_m, self.normal_body, self.covariance_m2))
        if shapes != ((n, 3), (n, 3), (n, 3, 3)) or {self.radius_m.shape, self.images.shape} != {(n,)}:
            raise BoresightError(f"{n} landmarks need (n, 3), (n, 3) and (n, 3, 3) values, not {shapes}")
        twice = self.number[np.flatnonzero(np.diff(self.number) <= 0)]
        if len(twice):
            raise BoresightError(f"landmark {int(twice[0])} is followed by one of the same or a smaller number")

    def __len__(self) -> int:
        return len(self.number)


def locate_landmarks(
    images: Sequence[CraterImage], numbering: Numbering, ground: GroundModel, height_sigma_m: float
) -> Landmarks:
    """Average the locations of each numbered crater on the shape over its images.

    The locations of an image are weighted with their covariances, from the prior pose, the rim's centre and the height
    of the shape. A crater that no image places on the body has no position and is left out.
    """
    parts: list[tuple[NDArray[np.generic], ...]] = [_NOWHERE]
    for image, numbers in zip(images, numbering.numbers, strict=True):
        located = locate_craters(image, ground)
        known = (numbers >= 0) & located.on_body
        ranges = np.linalg.norm(located.points_body_m - located.T_cam_body.camera_position_m, axis=1)
        # Foreshortening leaves the longer semi-axis unchanged: it is the radius on the ground.
        radii = image.detections.ellipses.semi_axes_px[:, 0] * image.camera.pixel_angle_rad * ranges
        spread = landmark_covariances(image, located, height_sigma_m)
        values = (numbers, located.points_body_m, located.normals_body, np.log(radii), spread)
        parts.append(tuple(value[known] for value in values))
    return _average_by_number(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _average_by_number(
    numbers: IndexArray, points: FloatArray, normals: FloatArray, log_radii: FloatArray, spread: FloatArray
) -> Landmarks:
    """Average the values of all images for each number.

    Positions (k, 3) m are weighted with the inverse of ``spread`` (k, 3, 3) m^2; normals and logarithms of radii count
    equally.
    """
    number, place, images = np.unique(numbers, return_inverse=True, return_counts=True)
    # Weighted with their information as if independent: errors of poses and shape common to several images are not.
    information = np.linalg.inv(spread)
    total, weighted = np.zeros((len(number), 3, 3)), np.zeros((len(number), 3))
    normal, log_radius = np.zeros((len(number), 3)), np.zeros(len(number))
    # add.at, because a number occurs in several images: plain indexing would keep the last of them alone.
    np.add.at(total, place, information)
    np.add.at(weighted, place, np.einsum("nij,nj->ni", information, points))
    np.add.at(normal, place, normals)
    # Logarithms: errors of a radius are relative.
    np.add.at(log_radius, place, log_radii)
    covariance = np.linalg.inv(total)
    return Landmarks(
        number.astype(np.int64),
        np.einsum("nij,nj->ni", covariance, weighted),
        np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True), dtype=np.float64),
        np.exp(log_radius / images),
        np.asarray(0.5 * (covariance + np.swapaxes(covariance, 1, 2)), dtype=np.float64),
        images.astype(np.int64),
    )


def landmarks_for_orbit(landmarks: Landmarks, centre_of_mass_m: FloatArray) -> LandmarkFile:
    """Convert landmarks to the input of orbit determination: positions about the centre of mass.

    ``centre_of_mass_m`` is (3,) in the axes of the database: a plate model's origin need not be the centre of mass;
    that of Eros at uniform density lies at (-23, 2, 47) m.
    """
    # Orbit determination takes one sigma for all directions: the root mean square of the three axes.
    sigma = np.sqrt(np.trace(landmarks.covariance_m2, axis1=1, axis2=2) / 3.0)
    return LandmarkFile(landmarks.number, landmarks.position_body_m - centre_of_mass_m, sigma)

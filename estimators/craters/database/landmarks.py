"""Content of the crater database: craters numbered over all images, their a priori positions, and the pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from boresight.estimators.craters.contract import CraterImage, CraterMatches, GroundModel
from boresight.estimators.craters.matching.preliminary import landmark_covariances
from boresight.estimators.craters.matching.transfer import locate_craters
from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.dynamics.field import UniformRotation
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Ellipses, Pose
from boresight.scenarios.orbits.data import LandmarkFile, Pictures

NO_NUMBER = -1


@dataclass(frozen=True, slots=True, eq=False)
class PairMatches:
    """The matches of two images, given by their places in the sequence."""

    first: int
    second: int
    matches: CraterMatches


@dataclass(frozen=True, slots=True, eq=False)
class Numbering:
    """Numbers of the detections of all images.

    ``numbers`` has for each image the numbers of its detections, ``NO_NUMBER`` if a detection has no match. No number
    occurs twice in an image. They count from 0 in the order of the images. ``conflicts`` counts the matches that were
    refused, because they would have given two detections of an image one number.
    """

    numbers: tuple[IndexArray, ...]
    conflicts: int

    @property
    def count(self) -> int:
        """Return how many craters have a number."""
        return 1 + max((int(one.max(initial=NO_NUMBER)) for one in self.numbers), default=NO_NUMBER)

    def hits(self) -> IndexArray:
        """Return (count,) the number of images of each crater."""
        together = np.concatenate([*self.numbers, np.zeros(0, dtype=np.int64)])
        return np.bincount(together[together >= 0], minlength=self.count)


def number_craters(sizes: Sequence[int], found: Sequence[PairMatches]) -> Numbering:
    """Assign numbers to the craters of images with ``sizes`` detections each.

    Matches are joined into groups in the order of reliability: first those confirmed by most other images (both
    detections matched with the same third one), among equals those with the higher score. A match that would bring two
    detections of an image into one group is a conflict: it is refused and counted. Raise BoresightError if a match
    refers to an image or a detection that does not exist.
    """
    starts = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    edges, scores = _all_pairs(starts, found)
    image_of = np.repeat(np.arange(len(sizes)), np.diff(starts))
    # The row is the last key, so that the order is the same on every machine.
    order = np.lexsort((np.arange(len(edges)), -scores, -_confirmations(edges, len(image_of))))
    groups, conflicts = _join_groups(edges[order], image_of)
    numbers = _numbers_of_groups(groups)
    return Numbering(tuple(numbers[a:b] for a, b in pairwise(starts)), conflicts)


def _all_pairs(starts: IndexArray, found: Sequence[PairMatches]) -> tuple[IndexArray, FloatArray]:
    """Return all matches as pairs (e, 2) of detections counted over all images, and their scores (e,)."""
    sizes, parts = np.diff(starts), [np.zeros((0, 2), dtype=np.int64)]
    for one in found:
        images = np.array([one.first, one.second])
        if images.min() < 0 or images.max() >= len(sizes) or one.first == one.second:
            raise BoresightError(f"matches of images {one.first} and {one.second}: there are {len(sizes)} images")
        pairs = one.matches.pairs
        if len(pairs) and (pairs.min() < 0 or (pairs >= sizes[images]).any()):
            raise BoresightError(f"matches of images {one.first} and {one.second} name a detection that there is not")
        parts.append(pairs + starts[images])
    return np.concatenate(parts), np.concatenate([np.zeros(0), *(one.matches.score for one in found)])


def _confirmations(edges: IndexArray, count: int) -> IndexArray:
    """Return (e,) the number of third detections with which both ends of each match are matched."""
    # A wrong match is rarely repeated in a third image: triangles of matches are the more reliable ones.
    others: list[set[int]] = [set() for _ in range(count)]
    for a, b in edges.tolist():
        others[a].add(b)
        others[b].add(a)
    return np.array([len(others[a] & others[b]) for a, b in edges.tolist()], dtype=np.int64)


def _join_groups(edges: IndexArray, image_of: IndexArray) -> tuple[list[list[int]], int]:
    """Join detections into groups in the order of the matches; return the groups and the number of refused matches."""
    group_of = list(range(len(image_of)))
    members = [[k] for k in range(len(image_of))]
    images = [{int(image)} for image in image_of]
    conflicts = 0
    for a, b in edges.tolist():
        one, other = group_of[a], group_of[b]
        if one == other:
            continue
        # A crater is seen at most once in an image.
        if images[one] & images[other]:
            conflicts += 1
            continue
        # Union by size: each detection changes its group at most log2(n) times.
        if len(members[one]) < len(members[other]):
            one, other = other, one
        for k in members[other]:
            group_of[k] = one
        members[one] += members[other]
        images[one] |= images[other]
        members[other] = []
    return members, conflicts


def _numbers_of_groups(groups: Sequence[Sequence[int]]) -> IndexArray:
    """Assign numbers to the groups of two and more in the order of their first detection."""
    numbers = np.full(sum(map(len, groups)), NO_NUMBER, dtype=np.int64)
    # In the order of their first detections, whatever the order in which groups were joined.
    matched = sorted((sorted(group) for group in groups if len(group) > 1), key=lambda group: group[0])
    for number, group in enumerate(matched):
        numbers[group] = number
    return numbers


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
        spread = landmark_covariances(image, located, height_sigma_m)
        values = (numbers, located.points_body_m, located.normals_body, np.log(located.radii_m(image)), spread)
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


@dataclass(frozen=True, slots=True, eq=False)
class SequencePicture:
    """One image in the picture sequence, the input of orbit determination; its ``number`` is unique in the sequence.

    ``time_s`` is the epoch of the exposure, ``camera`` has no distortion, ``T_cam_body`` is the prior pose, and
    ``sun_dir_cam`` (3,) the unit vector towards the Sun. ``landmark`` (k,) are the numbers of the craters that were
    found, each once, and ``ellipses`` their rims, whose centres are the measurements.
    """

    number: int
    time_s: float
    camera: Camera
    T_cam_body: Pose
    sun_dir_cam: FloatArray
    landmark: IndexArray
    ellipses: Ellipses

    def __post_init__(self) -> None:
        if len(self.landmark) != len(self.ellipses):
            raise BoresightError(f"picture {self.number}: {len(self.landmark)} numbers of {len(self.ellipses)} rims")
        values, counts = np.unique(self.landmark, return_counts=True)
        if (counts > 1).any():
            raise BoresightError(f"picture {self.number} has landmark {int(values[np.argmax(counts > 1)])} twice")


def numbered_pictures(
    images: Sequence[CraterImage], numbering: Numbering, placed: IndexArray
) -> tuple[SequencePicture, ...]:
    """Convert images to pictures in the order of time, with the numbered craters that have a position.

    ``placed`` (n,) are the numbers of the landmarks with a position; sightings of other numbers are left out.
    """
    pictures = []
    for image, numbers in zip(images, numbering.numbers, strict=True):
        rows = np.flatnonzero((numbers >= 0) & np.isin(numbers, placed))
        rows = rows[np.argsort(numbers[rows], kind="stable")]
        frame, rims = image.frame, image.detections.ellipses[rows]
        pose = frame.prior_T_cam_body
        pictures.append(
            SequencePicture(image.number, frame.time_s, image.camera, pose, frame.sun_dir_cam, numbers[rows], rims)
        )
    return tuple(sorted(pictures, key=lambda picture: (picture.time_s, picture.number)))


def pictures_for_orbit(pictures: Sequence[SequencePicture], camera: Camera, rotation: UniformRotation) -> Pictures:
    """Convert pictures to the input of orbit determination: attitudes in inertial axes, times ascending.

    ``camera`` is the camera model of orbit determination, and ``rotation`` that of the body with which the poses of the
    pictures were made. Raise BoresightError if there is no picture, or one of another camera.
    """
    if not pictures:
        raise BoresightError("the data base has no picture: there is nothing to determine an orbit from")
    other = next((picture for picture in pictures if picture.camera != camera), None)
    if other is not None:
        raise BoresightError(f"picture {other.number} is of another camera than the orbit is to be determined with")
    times = np.array([picture.time_s for picture in pictures])
    attitudes = np.stack([picture.T_cam_body.rotation for picture in pictures])
    return Pictures(
        times,
        np.asarray(attitudes @ rotation.at(times)),
        np.repeat(np.arange(len(pictures)), [len(picture.landmark) for picture in pictures]),
        np.concatenate([picture.landmark for picture in pictures]),
        np.concatenate([picture.ellipses.centre_px for picture in pictures]),
    )

"""The crater data base from numbered sightings at known poses: positions from all lines of sight to a landmark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimators.craters.contract import CraterImage, CraterMatcher, Ground
from estimators.craters.database.files import CraterDatabase
from estimators.craters.database.landmarks import Landmarks, locate_landmarks
from estimators.craters.database.numbering import Numbering, PairMatches, number_craters
from estimators.craters.database.pictures import Picture, placed_pictures
from estimators.craters.matching.association import AssociationOptions, centre_noise
from estimators.craters.matching.preliminary import ImagePairs, PreliminaryOptions, preliminary_pairs
from estimators.craters.robust import huber_weights

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

_PASSES = 6


@dataclass(frozen=True, slots=True, eq=False)
class BuiltDatabase:
    """A data base, and how it came about.

    Parameters
    ----------
    database
        Landmarks and pictures.
    pairs
        Of images that were matched.
    found
        What the matcher said of each.
    numbering
        Numbers of all detections, also of craters that no image places on the body.
    """

    database: CraterDatabase
    pairs: ImagePairs
    found: tuple[PairMatches, ...]
    numbering: Numbering


def build_database(
    images: Sequence[CraterImage],
    matcher: CraterMatcher,
    ground: Ground,
    options: PreliminaryOptions | None = None,
) -> BuiltDatabase:
    """Match all images that may show the same craters, and number and place what they have in common."""
    options = options or PreliminaryOptions()
    pairs = preliminary_pairs(images, ground, options)
    found = tuple(PairMatches(int(i), int(j), matcher.match(images[i], images[j], ground)) for i, j in pairs.pairs)
    numbering = number_craters([len(image.detections.ellipses) for image in images], found)
    landmarks = locate_landmarks(images, numbering, ground, options.height_sigma_m)
    pictures = placed_pictures(images, numbering, landmarks.number)
    return BuiltDatabase(CraterDatabase(pictures, landmarks), pairs, found, numbering)


@dataclass(frozen=True, slots=True, eq=False)
class _Sights:
    """All sightings of landmarks.

    Parameters
    ----------
    row
        (s,) rows of their landmarks.
    camera_m, direction
        (s, 3) where the camera was, and unit vectors from there, in body axes.
    weight
        (s,) 1/m^2, the information of a rim's centre on the ground.
    """

    row: IndexArray
    camera_m: FloatArray
    direction: FloatArray
    weight: FloatArray


def triangulated(database: CraterDatabase, height_sigma_m: float, options: AssociationOptions) -> CraterDatabase:
    """Move each landmark to where its lines of sight meet best, with the shape's height as a prior.

    The normal equations of the points x: sum over pictures of w (I - d d^T) / s^2 (x - c) = 0, where a line leaves the
    camera at c along d and s is the error of the rim's centre on the ground, and n n^T / h^2 (x - x0) for the a priori
    location x0 on the shape, known to h along the normal n. Huber's weights w keep a line that has the number of
    another crater from deciding; they begin at 1.
    """
    landmarks = database.landmarks
    sights = _all_sights(database, options)
    across = np.eye(3) - np.einsum("ni,nj->nij", sights.direction, sights.direction)
    information = across * sights.weight[:, None, None]
    normal = landmarks.normal_body
    height = np.einsum("ni,nj->nij", normal, normal) / height_sigma_m**2
    position, share = landmarks.position_body_m, np.ones(len(sights.row))
    for _ in range(_PASSES):
        total, weighted = height.copy(), np.einsum("nij,nj->ni", height, landmarks.position_body_m)
        weighed = information * share[:, None, None]
        np.add.at(total, sights.row, weighed)
        np.add.at(weighted, sights.row, np.einsum("nij,nj->ni", weighed, sights.camera_m))
        covariance = np.linalg.inv(total)
        position = np.einsum("nij,nj->ni", covariance, weighted)
        off = np.einsum("nij,nj->ni", across, position[sights.row] - sights.camera_m)
        share = huber_weights(np.linalg.norm(off, axis=1) * np.sqrt(sights.weight))
    moved: Landmarks = replace(
        landmarks,
        position_body_m=position,
        covariance_m2=np.asarray(0.5 * (covariance + np.swapaxes(covariance, 1, 2)), dtype=np.float64),
    )
    return CraterDatabase(database.pictures, moved)


def _all_sights(database: CraterDatabase, options: AssociationOptions) -> _Sights:
    parts = [_sights_of(picture, database.landmarks, options) for picture in database.pictures]
    if not parts:
        return _Sights(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    row, camera_m, direction, weight = (np.concatenate(column) for column in zip(*parts, strict=True))
    return _Sights(row, camera_m, direction, weight)


def _sights_of(
    picture: Picture, landmarks: Landmarks, options: AssociationOptions
) -> tuple[IndexArray, FloatArray, FloatArray, FloatArray]:
    rows = np.searchsorted(landmarks.number, picture.landmark)
    pose = picture.T_cam_body
    camera_m = np.broadcast_to(pose.camera_position_m, (len(rows), 3))
    direction = pose.inverse().rotate(picture.camera.unproject(picture.ellipses.centre_px))
    ranges = np.linalg.norm(landmarks.position_body_m[rows] - camera_m, axis=1)
    sigma_m = np.sqrt(centre_noise(picture.ellipses, options)[:, 0, 0]) * ranges * picture.camera.pixel_angle_rad
    return rows, camera_m, direction, sigma_m**-2.0

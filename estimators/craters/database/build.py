"""Building of the crater database: matching, numbering and location of craters, and triangulation at known poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from boresight.estimators.craters.contract import CraterImage, CraterMatcher, GroundModel
from boresight.estimators.craters.database.files import CraterDatabase
from boresight.estimators.craters.database.landmarks import (
    Landmarks,
    Numbering,
    PairMatches,
    locate_landmarks,
    number_craters,
    numbered_pictures,
)
from boresight.estimators.craters.matching.association import CraterAssociationOptions, centre_noise, huber_weights
from boresight.estimators.craters.matching.preliminary import ImagePairs, PreliminaryOptions, preliminary_pairs
from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.geometry.camera import LinesOfSight, triangulation_equations

_PASSES = 6


@dataclass(frozen=True, slots=True, eq=False)
class CraterDatabaseBuild:
    """A database with the pairs of images that were matched, the matches of each, and the numbers of all detections.

    The numbers include craters that no image places on the body.
    """

    database: CraterDatabase
    pairs: ImagePairs
    found: tuple[PairMatches, ...]
    numbering: Numbering


def build_database(
    images: Sequence[CraterImage],
    matcher: CraterMatcher,
    ground: GroundModel,
    options: PreliminaryOptions | None = None,
) -> CraterDatabaseBuild:
    """Match all images that may show the same craters, and number and locate the craters that they share."""
    options = options or PreliminaryOptions()
    pairs = preliminary_pairs(images, ground, options)
    found = tuple(PairMatches(int(i), int(j), matcher.match(images[i], images[j], ground)) for i, j in pairs.pairs)
    numbering = number_craters([len(image.detections.ellipses) for image in images], found)
    landmarks = locate_landmarks(images, numbering, ground, options.height_sigma_m)
    pictures = numbered_pictures(images, numbering, landmarks.number)
    return CraterDatabaseBuild(CraterDatabase(pictures, landmarks), pairs, found, numbering)


def triangulate_landmarks(
    database: CraterDatabase, height_sigma_m: float, options: CraterAssociationOptions
) -> CraterDatabase:
    """Move each landmark to where its lines of sight meet best, with the shape's height as a prior.

    The normal equations of the points x: sum over pictures of w (I - d d^T) / s^2 (x - c) = 0, where a line starts at
    the camera c along d and s is the error of the rim's centre on the ground, and n n^T / h^2 (x - x0) for the a priori
    location x0 on the shape, known to h along the normal n. Huber's weights w, 1 at first, limit the influence of a
    line that has the number of another crater.
    """
    landmarks = database.landmarks
    row, lines, information = _lines_of_sight(database, options)
    normal = landmarks.normal_body
    height = np.einsum("ni,nj->nij", normal, normal) / height_sigma_m**2
    # Information of the height along the normal, and the same times the a priori location: b = A x0.
    prior = height, np.einsum("nij,nj->ni", height, landmarks.position_body_m)
    position, robust = landmarks.position_body_m, np.ones(len(row))
    for _ in range(_PASSES):
        matrix, right = triangulation_equations(lines, row, prior, (information, robust))
        covariance = np.linalg.inv(matrix)
        position = np.einsum("nij,nj->ni", covariance, right)
        # The distance of the line over its sigma on the ground is the residual of the sighting.
        robust = huber_weights(lines.distances(position[row]) * np.sqrt(information))
    moved: Landmarks = replace(
        landmarks,
        position_body_m=position,
        covariance_m2=np.asarray(0.5 * (covariance + np.swapaxes(covariance, 1, 2)), dtype=np.float64),
    )
    return CraterDatabase(database.pictures, moved)


def _lines_of_sight(
    database: CraterDatabase, options: CraterAssociationOptions
) -> tuple[IndexArray, LinesOfSight, FloatArray]:
    """Return the landmark rows (K,) of all sightings, their lines in body axes, and their information (K,), 1 / m^2."""
    parts = [(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))]
    for picture in database.pictures:
        # Landmark numbers ascend, and every picture's numbers are among them.
        rows = np.searchsorted(database.landmarks.number, picture.landmark)
        pose = picture.T_cam_body
        camera_m = np.broadcast_to(pose.camera_position_m, (len(rows), 3))
        direction = pose.inverse().rotate(picture.camera.unproject(picture.ellipses.centre_px))
        ranges = np.linalg.norm(database.landmarks.position_body_m[rows] - camera_m, axis=1)
        # Isotropic noise of the centre, pixels to metres across the line of sight at the a priori range.
        sigma_m = np.sqrt(centre_noise(picture.ellipses, options)[:, 0, 0]) * ranges * picture.camera.pixel_angle_rad
        parts.append((rows, camera_m, direction, sigma_m**-2.0))
    row, camera_m, direction, information = (np.concatenate(column) for column in zip(*parts, strict=True))
    return row, LinesOfSight(camera_m, direction), information

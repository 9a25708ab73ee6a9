"""The picture sequence: the images of the database with their numbered craters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from boresight.estimators.craters.contract import CraterImage
from boresight.estimators.craters.database.numbering import Numbering
from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.dynamics.field import UniformRotation
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Ellipses, Pose
from boresight.scenarios.orbits.data import Pictures


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

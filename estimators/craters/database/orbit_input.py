"""What orbit determination reads of a crater data base: the picture sequence and the places of the landmarks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimators.craters.database.files import CraterDatabase
from scenarios.dynamics.field import UniformRotation
from scenarios.errors import BoresightError
from scenarios.geometry import Camera
from scenarios.orbits.data import LandmarkFile, Pictures

FloatArray = NDArray[np.float64]


def sequence_of_pictures(database: CraterDatabase, camera: Camera, rotation: UniformRotation) -> Pictures:
    """Write the pictures of a data base as orbit determination sees them: in inertial axes, times ascending.

    Parameters
    ----------
    camera
        What orbit determination calculates with.
    rotation
        Of the body, as the poses of the pictures were made with.

    Raises
    ------
    BoresightError
        If the data base has no picture, or one by another camera.
    """
    pictures = database.pictures
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


def places_of_landmarks(database: CraterDatabase, centre_of_mass_m: FloatArray) -> LandmarkFile:
    """Write the landmarks of a data base with their places about the centre of mass, (3,) in the data base's axes.

    A plate model's origin need not be the centre of mass: that of Eros at one density lies at (-23, 2, 47) m.
    """
    landmarks = database.landmarks
    sigma = np.sqrt(np.trace(landmarks.covariance_m2, axis1=1, axis2=2) / 3.0)
    return LandmarkFile(landmarks.number, landmarks.position_body_m - centre_of_mass_m, sigma)

"""The input of the navigation chain: a priori values and shape, radiometric data, images with their craters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.estimators.craters.contract import CraterDetections
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.orbits.data import Knowledge, Radiometry
from boresight.scenarios.sequences.ground import MeshGround


@dataclass(frozen=True, slots=True, eq=False)
class AprioriShape:
    """The shape that landmarks are located on, in axes whose origin need not be the centre of mass.

    ``centre_of_mass_m`` (3,) is in the same axes; ``height_sigma_m`` is the standard deviation of the shape's height.
    """

    ground: MeshGround
    centre_of_mass_m: FloatArray
    height_sigma_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Exposure:
    """An image with its craters and its attitude; its position comes from the trajectory.

    ``time_s`` is relative to the epoch of the orbit, ``R_cam_inertial`` (3, 3) the telemetered attitude,
    ``sun_dir_cam`` (3,) the unit vector towards the Sun; ``pixels`` are (H, W).
    """

    number: int
    time_s: float
    R_cam_inertial: FloatArray
    sun_dir_cam: FloatArray
    pixels: NDArray[np.float32]
    detections: CraterDetections


@dataclass(frozen=True, slots=True, eq=False)
class NavigationTask:
    """The input of the chain other than the images; ``knowledge`` and ``radiometry`` are as in `OrbitData`.

    ``wanted_s`` (E,) are the times at which the orbit is wanted; later than the last image for a prediction.
    """

    knowledge: Knowledge
    shape: AprioriShape
    radiometry: Radiometry | None
    wanted_s: FloatArray

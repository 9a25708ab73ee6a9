"""Input of orbit determination: landmark sightings, a priori landmark positions, radiometry and a priori knowledge.

Times are seconds after the epoch. Inertial axes have their origin in the body's centre of mass; body axes have the same
origin and rotate about their z axis. Simulated data and the picture-sequence and landmark files of a crater data base
have the same form.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.dynamics.field import HarmonicField
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera


@dataclass(frozen=True, slots=True, eq=False)
class Pictures:
    """Picture-sequence file: times, attitudes and landmark sightings of images.

    ``times_s`` (I,) of the exposures ascend; ``R_cam_inertial`` (I, 3, 3) is the attitude by the star tracker and the
    camera's nominal mounting. Each of K sightings has its ``image``, a row of the times, the number of its
    ``landmark``, unique in an image, and the measured column and row ``uv_px`` (K, 2).
    """

    times_s: FloatArray
    R_cam_inertial: FloatArray
    image: IndexArray
    landmark: IndexArray
    uv_px: FloatArray

    def __post_init__(self) -> None:
        images, sightings = len(self.times_s), len(self.image)
        shapes = (self.R_cam_inertial.shape, self.landmark.shape, self.uv_px.shape)
        if shapes != ((images, 3, 3), (sightings,), (sightings, 2)):
            raise BoresightError(
                f"pictures: {images} times and {sightings} sightings do not go with attitudes {shapes[0]},"
                f" numbers {shapes[1]} and pixels {shapes[2]}"
            )
        if not all(np.isfinite(part).all() for part in (self.times_s, self.R_cam_inertial, self.uv_px)):
            raise BoresightError("pictures: times, attitudes and pixels must be finite numbers")
        if np.any(np.diff(self.times_s) < 0.0):
            raise BoresightError("pictures: times must ascend: sort the picture sequence by time")
        if sightings and (self.image.min() < 0 or self.image.max() >= images):
            raise BoresightError(f"pictures: a sighting names image {int(self.image.max())} of {images}")
        pairs = np.stack([self.image, self.landmark], axis=1)
        found, counts = np.unique(pairs, axis=0, return_counts=True)
        if len(found) < len(pairs):
            image, number = found[np.argmax(counts > 1)]
            raise BoresightError(f"pictures: landmark {number} stands twice in image {image}: keep one of the two")


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkFile:
    """Landmark-location file: each of L distinct numbers with its a priori position (L, 3).

    ``sigma_m`` (L,) is the standard deviation of each coordinate; infinite for no constraint.
    """

    numbers: IndexArray
    positions_body_m: FloatArray
    sigma_m: FloatArray

    def __post_init__(self) -> None:
        n = len(self.numbers)
        if self.positions_body_m.shape != (n, 3) or self.sigma_m.shape != (n,):
            raise BoresightError(
                f"landmarks: {n} numbers do not go with positions {self.positions_body_m.shape}"
                f" and deviations {self.sigma_m.shape}"
            )
        if not np.isfinite(self.positions_body_m).all() or not np.all(self.sigma_m > 0.0):
            raise BoresightError("landmarks: positions must be finite and deviations above 0")
        found, counts = np.unique(self.numbers, return_counts=True)
        if len(found) < n:
            raise BoresightError(
                f"landmarks: number {found[np.argmax(counts > 1)]} stands twice: each has one position"
            )


@dataclass(frozen=True, slots=True, eq=False)
class PositionFixes:
    """Positions of the body's centre of mass, measured in F images, of which each has one at most.

    ``image`` (F,) are rows of the times of the pictures, ascending. ``position_cam_m`` (F, 3) are in the axes of the
    camera and ``information`` (F, 3, 3), 1/m^2, is the inverse of the covariance of their errors, without those of the
    camera's attitude and focal length. It is singular where a direction, such as that of the range, is not measured.
    ``common_m`` (F, 3) is one standard deviation of the part of these errors that all fixes share.
    """

    image: IndexArray
    position_cam_m: FloatArray
    information: FloatArray
    common_m: FloatArray

    def __post_init__(self) -> None:
        n, parts = len(self.image), (self.position_cam_m, self.information, self.common_m)
        shapes = tuple(part.shape for part in parts)
        if shapes != ((n, 3), (n, 3, 3), (n, 3)):
            raise BoresightError(
                f"fixes: {n} images do not go with positions {shapes[0]}, information {shapes[1]}"
                f" and common errors {shapes[2]}"
            )
        if not all(np.isfinite(part).all() for part in parts):
            raise BoresightError("fixes: positions, information and common errors must be finite numbers")
        if np.any(np.diff(self.image) <= 0):
            raise BoresightError("fixes: images must ascend: each has one fix at most")


@dataclass(frozen=True, slots=True, eq=False)
class Radiometry:
    """N range and Doppler records along a fixed direction, times ascending; either may be NaN (missing).

    ``earth_dir`` (3,) is the unit vector from the body to the Earth, inertial axes. ``range_m`` is the distance from
    the station minus that of the body's centre, with a common bias; ``range_rate_m_s`` its time derivative, without.
    The sigmas are standard deviations of the noise and of the bias.
    """

    earth_dir: FloatArray
    times_s: FloatArray
    range_m: FloatArray
    range_rate_m_s: FloatArray
    range_sigma_m: float
    range_rate_sigma_m_s: float
    range_bias_sigma_m: float

    def __post_init__(self) -> None:
        n = len(self.times_s)
        if self.range_m.shape != (n,) or self.range_rate_m_s.shape != (n,) or self.earth_dir.shape != (3,):
            raise BoresightError(
                f"radiometry: {n} times do not go with ranges {self.range_m.shape}, rates {self.range_rate_m_s.shape}"
                f" and a direction {self.earth_dir.shape}"
            )
        if not np.isfinite(self.times_s).all() or np.any(np.diff(self.times_s) < 0.0):
            raise BoresightError("radiometry: times must be finite and ascend")
        if not min(self.range_sigma_m, self.range_rate_sigma_m_s) > 0.0 or self.range_bias_sigma_m < 0.0:
            raise BoresightError("radiometry: deviations must be above 0, that of the bias at least 0")


@dataclass(frozen=True, slots=True, eq=False)
class Knowledge:
    """A priori knowledge and its standard deviations, which are of one coordinate.

    ``state`` (6,) is position, m, and velocity, m/s, at the epoch, inertial axes; ``noise_px`` is of a sighting. Errors
    of the attitude are about each camera axis: ``attitude_sigma_rad`` of each image, ``misalignment_sigma_rad`` of the
    camera in all images. Those of the focal length, GM, solar radiation pressure (``light_sigma``) and the spin rate
    are relative, 0 if exact. ``pole_sigma_rad`` is of the spin axis about each of two axes across it, 0 if exact.
    ``coefficient_sigma`` is of each estimated normalised gravity coefficient. The unmodelled acceleration has the
    standard deviation ``noise_m_s2``, 0 if there is none, and the correlation time ``noise_time_s``, in which its
    autocorrelation decays to 1 / e.
    """

    camera: Camera
    field: HarmonicField
    state: FloatArray
    position_sigma_m: float
    velocity_sigma_m_s: float
    noise_px: float
    attitude_sigma_rad: float
    misalignment_sigma_rad: float
    focal_sigma: float
    gm_sigma: float
    light_sigma: float
    pole_sigma_rad: float
    spin_sigma: float
    coefficient_sigma: float
    noise_m_s2: float
    noise_time_s: float

    def __post_init__(self) -> None:
        if self.state.shape != (6,) or not np.isfinite(self.state).all():
            raise BoresightError("the state before must be 6 finite numbers: position, m, and velocity, m/s")
        if not min(self.position_sigma_m, self.velocity_sigma_m_s, self.noise_px, self.attitude_sigma_rad) > 0.0:
            raise BoresightError("deviations of position, velocity, pixels and attitude must be above 0")


@dataclass(frozen=True, slots=True, eq=False)
class OrbitData:
    """All input of an orbit determination; ``radiometry`` and ``fixes`` are None without such data.

    Every number in ``pictures`` occurs in ``landmarks``. ``wanted_s`` (E,) are the requested times of the orbit,
    ascending from 0; times after the last image are predictions.
    """

    knowledge: Knowledge
    pictures: Pictures
    landmarks: LandmarkFile
    radiometry: Radiometry | None
    wanted_s: FloatArray
    fixes: PositionFixes | None = None

    def __post_init__(self) -> None:
        unknown = np.setdiff1d(self.pictures.landmark, self.landmarks.numbers)
        if len(unknown):
            raise BoresightError(f"landmarks: number {unknown[0]} is seen in a picture, but has no position")
        images = len(self.pictures.times_s)
        if self.fixes is not None and not np.all((self.fixes.image >= 0) & (self.fixes.image < images)):
            raise BoresightError(f"fixes: images {self.fixes.image.tolist()} are not all of {images} pictures")
        times = [self.wanted_s, self.pictures.times_s]
        times += [] if self.radiometry is None else [self.radiometry.times_s]
        if any(len(some) and some[0] < 0.0 for some in times) or np.any(np.diff(self.wanted_s) < 0.0):
            raise BoresightError("times must ascend from the epoch, 0, on")

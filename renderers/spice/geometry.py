"""Where a camera was at an instant, and the Sun: positions and attitudes of the loaded kernels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import spiceypy
from numpy.typing import NDArray

from scenarios.geometry import Pose

FloatArray = NDArray[np.float64]
Aberration = Literal["LT+S", "NONE"]
_M_PER_KM = 1e3


@dataclass(frozen=True, slots=True)
class Actors:
    """NAIF's names of those who take part: the spacecraft, its camera's frame, the body, the body's frame."""

    spacecraft: str
    camera_frame: str
    target: str
    target_frame: str


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """What the kernels tell about an instant.

    Parameters
    ----------
    T_cam_body
        Body to camera coordinates, m; the camera's axes are those of its frame.
    sun_dir_body
        (3,) unit vector towards the Sun in the body frame.
    """

    T_cam_body: Pose
    sun_dir_body: FloatArray


def sight(actors: Actors, et: float, aberration: Aberration = "LT+S") -> Sighting:
    """Return pose and Sun of an exposure; kernels are loaded.

    With ``LT+S`` the body is where it appears: where it was, and turned as it was, when the light left it (light time),
    in the direction into which the spacecraft's motion turns that light (stellar aberration). Both matter and all but
    cancel where spacecraft and body fly together: either alone is an error of v / c, 20 arcsec at 30 km/s. The range is
    that which the light has travelled, longer or shorter than the geometric one by up to the same 1e-4.
    ``NONE`` gives the geometric state, as ISIS takes it for AMICA.

    The Sun is where it appears from the body (LT+S), when the light left the body.

    Parameters
    ----------
    actors
        Who takes part.
    et
        Middle of the exposure, s past J2000 TDB.
    aberration
        Correction of the position of the body.
    """
    position_km, light_s = spiceypy.spkpos(actors.target, et, "J2000", aberration, actors.spacecraft)
    left_et = et - (0.0 if aberration == "NONE" else light_s)
    R_cam_j2000 = np.array(spiceypy.pxform("J2000", actors.camera_frame, et))
    R_body_j2000 = np.array(spiceypy.pxform("J2000", actors.target_frame, left_et))
    sun_km, _ = spiceypy.spkpos("SUN", left_et, "J2000", "LT+S", actors.target)
    sun_body = R_body_j2000 @ np.array(sun_km)
    pose = Pose(R_cam_j2000 @ R_body_j2000.T, _M_PER_KM * (R_cam_j2000 @ np.array(position_km)))
    return Sighting(pose, sun_body / np.linalg.norm(sun_body))

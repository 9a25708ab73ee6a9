"""From Keplerian elements to a state."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from scenarios.spec.orbit import ArcSpec

FloatArray = NDArray[np.float64]


def state_at_epoch(arc: ArcSpec, gm_m3_s2: float) -> FloatArray:
    """(6,) position, m, and velocity, m/s, inertial axes."""
    a, e, mean = arc.semi_major_axis_m, arc.eccentricity, np.radians(arc.anomaly_deg % 360.0)
    eccentric = float(brentq(lambda x: x - e * np.sin(x) - mean, -1.0, 2.0 * np.pi + 1.0, xtol=1e-14))
    root, c, s = np.sqrt(1.0 - e * e), np.cos(eccentric), np.sin(eccentric)
    position = a * np.array([c - e, root * s, 0.0])
    velocity = np.sqrt(gm_m3_s2 / a) / (1.0 - e * c) * np.array([-s, root * c, 0.0])
    angles = [arc.node_deg, arc.inclination_deg, arc.pericentre_deg]
    turn = Rotation.from_euler("ZXZ", angles, degrees=True).as_matrix()
    return np.concatenate([turn @ position, turn @ velocity])

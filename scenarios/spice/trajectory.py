"""States of a spacecraft about a body from SPICE kernels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import spiceypy

from boresight.scenarios.errors import BoresightError
from boresight.scenarios.spec.flights import MOST_STATES
from boresight.scenarios.spec.trajectory import SpiceTrajectorySpec, StatesSpec, rows_of
from boresight.scenarios.spice.geometry import M_PER_KM, SpiceNames, apparent_geometry
from boresight.scenarios.spice.kernels import find_kernels, loaded_kernels


def spice_states(spec: SpiceTrajectorySpec, folders: Sequence[Path], *, spin: bool) -> StatesSpec:
    """Compute apparent states (see `apparent_geometry`) at the epochs of a trajectory, and the first ``spin``.

    Velocities are geometric: they serve to name the directions along and across an orbit. Raise BoresightError if a
    kernel is missing or damaged, or the kernels do not have a name, a frame or an epoch.
    """
    names = SpiceNames(spec.observer, spec.camera_frame or "J2000", spec.target, spec.target_frame)
    with loaded_kernels(find_kernels(spec.kernels, folders, "spice.kernels")):
        start_et, stop_et = (float(spiceypy.str2et(utc)) for utc in (spec.start_utc, spec.stop_utc))
        count = math.floor((stop_et - start_et) / spec.step_s + 1e-9) + 1
        if not 1 <= count <= MOST_STATES:
            raise BoresightError(f"spice: {count} epochs from start_utc to stop_utc are not within [1, {MOST_STATES}]")
        epochs = start_et + spec.step_s * np.arange(count)
        found, velocities = [], []
        for et in epochs.tolist():
            found.append(apparent_geometry(names, et, spec.aberration))
            state_km, _ = spiceypy.spkezr(spec.observer, et, "J2000", "NONE", spec.target)
            to_body = np.array(spiceypy.pxform("J2000", spec.target_frame, et))
            velocities.append(M_PER_KM * to_body @ np.array(state_km)[3:])
        spin_rad_s = None
        if spin:
            # The angular velocity of the body-fixed frame is given in inertial axes.
            to_body, rate_rad_s = spiceypy.xf2rav(spiceypy.sxform("J2000", spec.target_frame, epochs[0]))
            spin_rad_s = tuple((to_body @ rate_rad_s).tolist())
    return StatesSpec(
        time_s=tuple(epochs.tolist()),
        position_m=rows_of(np.array([one.T_cam_body.camera_position_m for one in found])),
        velocity_m_s=rows_of(np.array(velocities)),
        attitude=rows_of(np.array([one.T_cam_body.quat_wxyz for one in found])) if spec.camera_frame else None,
        sun_dir=rows_of(np.array([one.sun_dir_body for one in found])),
        spin_rad_s=spin_rad_s,
    )

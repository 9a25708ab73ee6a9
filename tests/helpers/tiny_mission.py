"""A mission of a few minutes in kernels of its own: AMICA beside an Itokawa that moves and spins as it is told here.

The names and numbers are NAIF's; the rest is made up so that every pose has a closed form. Spacecraft and body fly
together at 30 km/s, the spacecraft at rest beside the body.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import spiceypy
from astropy.io import fits
from scipy.spatial.transform import Rotation

START_ET = 182_000_000.0
LENGTH_S = 7200.0
TICKS_PER_S = 32.0
VELOCITY_KM_S = np.array([10.0, 25.0, 13.0])
SUN_FROM_BODY_KM = np.array([1.2e8, -0.7e8, 0.2e8])
SPIN_DEG_PER_DAY = 712.0
POLE_RA_DEG, POLE_DEC_DEG, MERIDIAN_DEG = 90.0, -67.0, 130.0

LSK = r"""KPL/LSK
\begindata
DELTET/DELTA_T_A = 32.184
DELTET/K = 1.657D-3
DELTET/EB = 1.671D-2
DELTET/M = ( 6.239996 1.99096871D-7 )
DELTET/DELTA_AT = ( 31, @1997-JUL-1
                    32, @1999-JAN-1 )
\begintext
"""
SCLK = rf"""KPL/SCLK
\begindata
SCLK_KERNEL_ID = ( @2005-10-01 )
SCLK_DATA_TYPE_130 = ( 1 )
SCLK01_TIME_SYSTEM_130 = ( 1 )
SCLK01_N_FIELDS_130 = ( 1 )
SCLK01_MODULI_130 = ( 4294967296 )
SCLK01_OFFSETS_130 = ( 0 )
SCLK01_OUTPUT_DELIM_130 = ( 1 )
SCLK_PARTITION_START_130 = ( 0 )
SCLK_PARTITION_END_130 = ( 4294967295 )
SCLK01_COEFFICIENTS_130 = ( 0, {START_ET}, {1.0 / TICKS_PER_S} )
\begintext
"""
FRAMES = rf"""KPL/FK
\begindata
FRAME_HAYABUSA_SC_BUS_PRIME = -130000
FRAME_-130000_NAME = 'HAYABUSA_SC_BUS_PRIME'
FRAME_-130000_CLASS = 3
FRAME_-130000_CLASS_ID = -130000
FRAME_-130000_CENTER = -130
CK_-130000_SCLK = -130
CK_-130000_SPK = -130
FRAME_HAYABUSA_AMICA = -130102
FRAME_-130102_NAME = 'HAYABUSA_AMICA'
FRAME_-130102_CLASS = 4
FRAME_-130102_CLASS_ID = -130102
FRAME_-130102_CENTER = -130
TKFRAME_-130102_SPEC = 'ANGLES'
TKFRAME_-130102_RELATIVE = 'HAYABUSA_SC_BUS_PRIME'
TKFRAME_-130102_ANGLES = ( 0.0, 0.0, 0.0 )
TKFRAME_-130102_AXES = ( 1, 2, 3 )
TKFRAME_-130102_UNITS = 'DEGREES'
FRAME_ITOKAWA_FIXED = 2025143
FRAME_2025143_NAME = 'ITOKAWA_FIXED'
FRAME_2025143_CLASS = 2
FRAME_2025143_CLASS_ID = 2025143
FRAME_2025143_CENTER = 2025143
OBJECT_2025143_FRAME = 'ITOKAWA_FIXED'
BODY2025143_POLE_RA = ( {POLE_RA_DEG} 0.0 0.0 )
BODY2025143_POLE_DEC = ( {POLE_DEC_DEG} 0.0 0.0 )
BODY2025143_PM = ( {MERIDIAN_DEG} {SPIN_DEG_PER_DAY} 0.0 )
\begintext
"""
CAMERA = r"""KPL/IK
\begindata
INS-130102_PIXEL_SAMPLES = ( {size} )
INS-130102_PIXEL_LINES = ( {size} )
INS-130102_CENTER = ( {middle} {middle} )
INS-130102_PIXEL_SIZE = ( {pitch_m} )
INS-130102_FOCAL_LENGTH = ( 0.1208 )
INS-130102_OD_K = ( 0.0 {k1} 0.0 )
\begintext
"""
LABEL = """PDS_VERSION_ID = PDS3
^IMAGE = "{name}.FIT"
INSTRUMENT_HOST_NAME = "HAYABUSA"
INSTRUMENT_ID = "{instrument}"
TARGET_NAME = "{target}"
FILTER_NAME = "V"
START_TIME = {start}
EXPOSURE_DURATION = {exposure_s} <SECOND>
OBJECT = IMAGE
LINES = {size}
LINE_SAMPLES = {size}
SAMPLE_TYPE = IEEE_REAL
SAMPLE_BITS = 32
END_OBJECT = IMAGE
END
"""
KERNELS = ("naif.tls", "tiny.tsc", "tiny.tf", "tiny.ti", "tiny.bsp", "tiny.bc")
SPICE_SECTION = {
    "instrument": "hayabusa-amica", "target": "ITOKAWA", "target_frame": "ITOKAWA_FIXED", "kernels": KERNELS,
}  # fmt: skip


@dataclass(frozen=True)
class TinyMission:
    """Where the kernels lie, and what they say.

    ``R_cam_j2000`` and ``body_from_craft_km`` (in J2000) hold for the whole mission.
    """

    folder: Path
    R_cam_j2000: np.ndarray
    body_from_craft_km: np.ndarray
    size: int

    @property
    def kernels(self) -> list[Path]:
        return [self.folder / name for name in KERNELS]

    def R_body_j2000(self, et: float) -> np.ndarray:
        """IAU's convention: W about z, 90 deg - dec about x, 90 deg + ra about z."""
        w_deg = MERIDIAN_DEG + SPIN_DEG_PER_DAY * et / 86400.0
        angles = [90.0 + POLE_RA_DEG, 90.0 - POLE_DEC_DEG, w_deg]
        return Rotation.from_euler("ZXZ", angles, degrees=True).as_matrix().T

    def write_image(self, name: str, pixels: np.ndarray, clock: float, **label: object) -> None:
        """Write a FITS file with AMICA's keywords and its detached label; ``clock`` is the start, s after START_ET."""
        said = {"instrument": "AMICA", "target": "25143 ITOKAWA", "exposure_s": 0.02, "size": self.size, **label}
        header = fits.Header({"TI_0": round(clock * TICKS_PER_S), "BINNING": 1, "OUT_MODE": "LOSS-LESS"})
        fits.PrimaryHDU(pixels.astype(np.float32), header).writeto(self.folder / f"{name}.fit")
        text = LABEL.format(name=name.upper(), start="2005-10-07T19:33:00", **said)
        (self.folder / f"{name}.lbl").write_text(text)


def make_mission(folder: Path, off_deg: Sequence[float] = (0.3, -0.2, 20.0), size: int = 64, k1: float = 2.8e-5):
    """Write the kernels of a mission with a camera of ``size`` x ``size`` pixels over AMICA's field.

    The camera looks at the body from 8 km, turned by ``off_deg`` about its own axes.
    """
    folder.mkdir(parents=True, exist_ok=True)
    towards_body = np.array([-0.8, 0.5, 0.33166247903554])
    forward = towards_body / np.linalg.norm(towards_body)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    R_cam_j2000 = Rotation.from_euler("xyz", off_deg, degrees=True).as_matrix() @ np.stack(
        [right, np.cross(forward, right), forward]
    )
    mission = TinyMission(folder, R_cam_j2000, 8.0 * forward, size)
    camera = CAMERA.format(size=size, middle=size / 2 - 0.5, pitch_m=1.2e-5 * 1024 / size, k1=k1)
    for name, text in zip(KERNELS[:4], (LSK, SCLK, FRAMES, camera), strict=True):
        (folder / name).write_text(text)
    _write_positions(mission)
    _write_attitude(mission)
    return mission


def _write_positions(mission: TinyMission) -> None:
    """Straight lines: the body about the Sun's place, the spacecraft beside it, the Sun at rest."""
    step, number = 60.0, int((LENGTH_S + 4000.0) / 60.0)
    times = START_ET - 2000.0 + step * np.arange(number)
    still = np.zeros((number, 6))
    body, craft = still.copy(), still.copy()
    body[:, :3] = -SUN_FROM_BODY_KM + (times - START_ET)[:, None] * VELOCITY_KM_S
    body[:, 3:] = VELOCITY_KM_S
    craft[:, :3] = -mission.body_from_craft_km
    handle = spiceypy.spkopn(str(mission.folder / "tiny.bsp"), "tiny", 0)
    for target, centre, states in ((10, 0, still), (2025143, 10, body), (-130, 2025143, craft)):
        spiceypy.spkw08(
            handle, target, centre, "J2000", times[0], times[-1], "tiny", 1, number, states.tolist(), times[0], step
        )
    spiceypy.spkcls(handle)


def _write_attitude(mission: TinyMission) -> None:
    ticks = np.array([0.0, LENGTH_S * TICKS_PER_S])
    quaternion = spiceypy.m2q(mission.R_cam_j2000)
    handle = spiceypy.ckopn(str(mission.folder / "tiny.bc"), "tiny", 0)
    spiceypy.ckw03(
        handle, ticks[0], ticks[-1], -130000, "J2000", False, "tiny", 2, ticks, [quaternion, quaternion],
        [[0.0] * 3] * 2, 1, [ticks[0]],
    )  # fmt: skip
    spiceypy.ckcls(handle)

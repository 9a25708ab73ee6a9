"""SUM files of the estimated poses of single images, in the format of `scenarios.spc`."""

from __future__ import annotations

from collections import Counter
from pathlib import Path, PurePosixPath

import numpy as np

from boresight.campaign.inspection.show import PosedFrames
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.atomic import write_text
from boresight.scenarios.geometry import Pose
from boresight.scenarios.geometry.pose import cross_matrix
from boresight.scenarios.spc import Sumfile, sumfile_text

_M_PER_KM = 1e3


def write_sumfiles(posed: PosedFrames, folder: Path) -> list[Path]:
    """Write a SUM file of each frame whose direction to the Sun is known; return the files.

    It has the name of the image without its ending, or the whole path if several images would have one file.
    """
    written, stems = [], Counter(PurePosixPath(frame.name).stem for frame in posed.frames)
    for frame in posed.frames:
        if frame.sun_dir_cam is None:
            continue
        stem = PurePosixPath(frame.name).stem
        stem = frame.name.replace("/", "-") if stems[stem] > 1 else stem
        content = Sumfile(frame.time_s, posed.camera, frame.estimated, frame.estimated.rotation.T @ frame.sun_dir_cam)
        sigma = None if frame.covariance is None else sigma_km_rad(frame.estimated, frame.covariance)
        landmarks = dict(zip(frame.landmarks.tolist(), frame.uv_px, strict=True))
        written.append(folder / f"{stem}.SUM")
        write_text(written[-1], sumfile_text(stem, content, sigma, landmarks))
    return written


def sigma_km_rad(T_cam_body: Pose, covariance: FloatArray) -> FloatArray:
    """Return SIGMA_VSO and SIGMA_PTG (6,) of a pose's covariance, (6, 6) of [rotation_rad, translation_m].

    SCOBJ is R^T t. For R' = exp(w) R and t' = t + d it changes by R^T (d - w x t), to first order.
    """
    derivative = T_cam_body.rotation.T @ np.hstack([cross_matrix(T_cam_body.translation_m), np.eye(3)])
    variance_m2 = np.diag(derivative @ covariance @ derivative.T)
    return np.asarray(np.sqrt(np.concatenate([variance_m2 / _M_PER_KM**2, np.diag(covariance)[:3]])))

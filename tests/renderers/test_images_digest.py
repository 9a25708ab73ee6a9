"""The digest of an image set stands for its content, not for its place."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from boresight.renderers.images import PosedImageSet
from boresight.scenarios.geometry import Camera
from boresight.scenarios.spec.scenario import ImageSetSpec

CAMERA = Camera.from_fov(20, 16, 0.3)
HEAD = "file,time_s,ref_qw,ref_qx,ref_qy,ref_qz,ref_tx_m,ref_ty_m,ref_tz_m,sun_body_x,sun_body_y,sun_body_z\n"


def make_set(folder: Path, value: int, depth_m: float) -> str:
    folder.mkdir(exist_ok=True)
    cv2.imwrite(str(folder / "a.png"), np.full((16, 20), value, dtype=np.uint8))
    (folder / "poses.csv").write_text(HEAD + f"a.png,0,1,0,0,0,0,0,{depth_m},0,0,-1\n")
    return PosedImageSet.open(ImageSetSpec(folder=str(folder)), CAMERA).content_digest()


def test_pixels_and_poses_count_and_the_place_does_not(tmp_path):
    first = make_set(tmp_path / "a", 7, 100.0)
    assert make_set(tmp_path / "b", 7, 100.0) == first
    assert make_set(tmp_path / "c", 8, 100.0) != first
    assert make_set(tmp_path / "d", 7, 101.0) != first

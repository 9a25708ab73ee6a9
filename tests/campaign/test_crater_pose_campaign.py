"""The pose by craters end to end: a data base of rendered images, found and matched, and poses of other images."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from tiny_campaign import run, write_campaign

from boresight.campaign.products.databases import database_images
from boresight.campaign.runs.resolve import resolve
from boresight.renderers.mitsuba3 import choose_variant

SCENE = """\
description: A small cratered sphere.
body: {shape: sphere}
craters:
  {seed: 5, count: 150, min_diameter_m: 20, max_diameter_m: 120, known_diameter_m: 30, edge_m: 4, roughness: null}
camera: {width_px: 200, height_px: 160, fov_deg: 12}
detector: {psf_sigma_px: 0.8}
viewpoint: {range_m: 2000, targets: [nadir, limb]}
lighting: {phase_deg: {uniform: [30, 70]}, measure: angle}
pose_error:
  {position_cam_m: {normal: [10, 10, 10]}, attitude: {rotation_vector_deg: {normal: [0.005, 0.005, 0.005]}}}
"""
CAMPAIGN = """\
title: Poses by craters of a small sphere
scenarios: [scene]
estimators:
  - prior
  - crater-pose:
      association: {centre_sigma_px: 0.3, centre_sigma_radii: 0.05}
      database: {images: 24, detector: crater-learned, most_detections: 40}
trials: 3
seed: 2
"""


def test_craters_of_rendered_images_bring_poses_near_the_truth_and_images_are_kept(tmp_path: Path, capsys) -> None:
    campaign = write_campaign(tmp_path, CAMPAIGN, SCENE)
    assert run(campaign, tmp_path / "run") == 0
    assert "image pairs" in capsys.readouterr().out
    rows = pd.concat(pd.read_parquet(path) for path in sorted((tmp_path / "run" / "rows").glob("*.parquet")))
    assert list(rows.loc[rows.estimator == "crater-pose", "status"]) == ["ok"] * 3
    error = rows.pivot_table(index="trial", columns="estimator", values="position_error_m").median()
    assert error["crater-pose"] < 0.3 * error["prior"]
    other = database_images(resolve(str(campaign)).scenarios[0], range(24), (20.0, 80.0), 0, choose_variant().name)
    assert all(image.from_store for image in other)

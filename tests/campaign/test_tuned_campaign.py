"""A campaign with a covariance tuned by rehearsals."""

from __future__ import annotations

import numpy as np
import pytest
from tiny_campaign import RESULTS, SCENE, files, run, write_campaign

from boresight.campaign.products import product_key
from boresight.estimators.tuned import PRODUCT, Rehearsals
from boresight.reports.run.data import read_run
from boresight.scenarios.load import load_scenario

CAMPAIGN = """\
title: A tiny campaign
scenarios: [scene]
estimators:
  - photometric
  - tuned: {base: photometric, tuning: {trials: 20, bodies: 2, errors: {relief_below_m: 40}}}
trials: 6
seed: 5
"""
OPTIONS = Rehearsals(base="photometric", options={}, version=3)


def key(folder, *overrides: str) -> str:
    write_campaign(folder)
    return product_key(load_scenario(str(folder / "scene.yaml"), overrides), PRODUCT, OPTIONS, "llvm_ad_mono")


@pytest.mark.parametrize(
    "change",
    [
        "viewpoint.off_pointing_deg=1", "lighting.phase_deg={uniform: [0, 40]}", "detector.psf_sigma_px=1",
        "pose_error={position_cam_m: {normal: [1, 2, 3]}}", "body.detail.seed=4",
    ],
)  # fmt: skip
def test_what_would_change_the_rehearsals_changes_the_key(tmp_path, change):
    assert key(tmp_path, change) != key(tmp_path)


def test_the_pose_stays_and_the_covariance_is_scaled_whatever_the_number_of_jobs(tmp_path, monkeypatch):
    file = write_campaign(tmp_path, CAMPAIGN, SCENE + "pose_error: {position_cam_m: {normal: [20, 20, 5]}}\n")
    alone, both = (tmp_path / f"run-{jobs}" for jobs in (1, 2))
    for jobs, folder in ((1, alone), (2, both)):
        monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path / f"cache-{jobs}"))  # each makes its own product
        assert run(file, folder, "--jobs", jobs) == 0
    assert files(alone, *RESULTS) == files(both, *RESULTS)
    found = read_run(alone)
    rows = {name: own.set_index("trial") for name, own in found.rows.groupby("estimator")}
    base, tuned = rows["photometric"], rows["tuned"]
    assert (base["status"] == "ok").all()
    for column in ("position_error_m", "attitude_error_deg"):
        np.testing.assert_array_equal(tuned[column], base[column])
    diagnostics = found.table("diagnostics")
    factors = diagnostics[diagnostics["name"] == "covariance_factor"]["value"].unique()
    assert len(factors) == 1 and factors[0] != pytest.approx(1.0, abs=0.1)
    # The prior is weak here: nearly all information is the image's.
    np.testing.assert_allclose(tuned["nees"], base["nees"] / factors[0], rtol=0.05)

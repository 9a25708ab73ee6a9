"""``boresight rare``: the rate of rare misses from trials with larger pose errors, where it is known."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, norm

from boresight.campaign.cli.main import main
from boresight.reports.kinds.rare import rare_grid
from boresight.reports.run.data import read_run
from boresight.reports.statistics.rare import weighted_rate
from boresight.scenarios.errors import BoresightError

SCENE = """\
body: {detail: {facets: 320, seed: 3}}
camera: {width_px: 32, height_px: 32, fov_deg: 18.3}
viewpoint: {range_m: 2000}
lighting: {phase_deg: 20}
pose_error:
  position_cam_m: {mixture: [{weight: 1, law: {normal: [10, 10, 10]}}, {weight: 2, law: {normal: [25, 25, 25]}}]}
  attitude: {angle_deg: {normal: 0.001}}
onboard:
  pose_error: {position_cam_m: {normal: [10, 10, 10]}}
"""
CAMPAIGN = """\
scenarios: [wide]
estimators: [prior]
trials: 600
seed: 12
requirements: [{that: position_error_m < 45 in 99.9 % at 90 %, estimators: [prior]}]
"""


@pytest.fixture(scope="module")
def folder(cache, tmp_path_factory):
    folder = tmp_path_factory.mktemp("rare")
    (folder / "wide.yaml").write_text(SCENE)
    (folder / "narrow.yaml").write_text("extends: wide\npose_error: {position_cam_m: {normal: [12, 12, 12]}}\n")
    (folder / "pixels.yaml").write_text("extends: quickstart\npose_error: {position_cam_px: {normal: [9, 9, 9]}}\n")
    (folder / "chosen.yaml").write_text("extends: wide\npose_error: {position_cam_m: {choice: [[1, 2, 3]]}}\n")
    (folder / "campaign.yaml").write_text(CAMPAIGN)
    run = ["run", str(folder / "campaign.yaml"), "--out", str(folder / "run"), "--jobs", "1", "--no-report"]
    assert main(run) == 4
    return folder


@pytest.mark.parametrize(("law", "sigma_m"), [(None, 10.0), ("narrow.yaml", 12.0)])
def test_the_rate_of_large_errors_of_the_prior(folder, capsys, monkeypatch, law, sigma_m):
    """Beyond a radius three normal components follow chi-square; of 600 plain trials none or one is there."""
    monkeypatch.chdir(folder)
    assert main(["rare", "run", *([] if law is None else ["--law", law])]) == 0
    said = " ".join(capsys.readouterr().out.split())
    number = r"[\d.]+(?:e-\d+)?"
    found = re.search(rf"prior (\d+)/600 ({number}) \[({number}), ({number})\]", said)
    missed, rate, low, high = map(float, found.groups())
    true = chi2.sf((45.0 / sigma_m) ** 2, 3)
    assert low < true < high
    assert rate == pytest.approx(true, rel=0.4)
    assert missed > 20
    assert ("told another law" in said) is (law is not None)
    assert "mean weight" not in said


def test_what_cannot_be_weighted_is_refused(folder, refused, tiny_run, monkeypatch):
    monkeypatch.chdir(folder)
    assert "has no requirement: give one" in refused("rare", tiny_run.folder)
    assert "no onboard.pose_error: name with --law" in refused("rare", tiny_run.folder, "success in 99 % at 90 %")
    assert "give the same key" in refused("rare", "run", "--law", "pixels.yaml")
    assert "has no density" in refused("rare", "run", "--law", "chosen.yaml")
    run = read_run(folder / "run")
    orbit = replace(run, manifest=run.manifest.model_copy(update={"campaign": {"experiment": "orbit-determination"}}))
    with pytest.raises(BoresightError, match="only those of single-image and pose-convergence"):
        rare_grid(orbit, {})


def test_errors_that_are_never_drawn_are_told(folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    (folder / "wider.yaml").write_text("extends: wide\npose_error: {position_cam_m: {normal: [80, 80, 80]}}\n")
    assert main(["rare", "run", "--law", "wider.yaml"]) == 0
    assert "wanted errors are not drawn" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(("n", "cut"), [(500, 3.9), (2000, 4.5)])
def test_the_interval_holds_the_true_rate(n, cut):
    """Half of the draws three times as wide, 400 times; of 95 %, with a standard error of 1 %."""
    rng, true = np.random.default_rng(1), 2.0 * norm.sf(cut)
    held = []
    for _ in range(400):
        x = rng.normal(size=n) * np.where(rng.random(n) < 0.5, 3.0, 1.0)
        found = weighted_rate(np.abs(x) > cut, norm.pdf(x) / (0.5 * norm.pdf(x) + 0.5 * norm.pdf(x, scale=3.0)))
        held.append(found.low <= true <= found.high)
        assert abs(found.weight - 1.0) < 6.0 * found.weight_sigma
    assert np.mean(held) > 0.93


def test_misses_of_another_cause_are_within_the_interval():
    """A rate of 1e-3 that the pose errors have no part in: 300 trials rarely have one."""
    rng, held = np.random.default_rng(2), []
    for _ in range(400):
        x = rng.normal(size=300) * np.where(rng.random(300) < 0.5, 3.0, 1.0)
        weights = norm.pdf(x) / (0.5 * norm.pdf(x) + 0.5 * norm.pdf(x, scale=3.0))
        held.append(weighted_rate(rng.random(300) < 1e-3, weights).high >= 1e-3)
    assert np.mean(held) > 0.97


def test_without_a_miss_and_with_equal_weights_the_interval_is_poissons():
    found = weighted_rate(np.zeros(1000, dtype=bool), np.ones(1000))
    assert (found.low, found.rate, found.effective) == (0.0, 0.0, 1000.0)
    assert found.high == pytest.approx(3.689 / 1000, rel=1e-3)

"""`boresight predict`: a table without images, beside the errors of a run, and what is refused."""

import json

import numpy as np
import pandas as pd
import pytest
from tiny_campaign import DATABASE, SCENE, write_campaign
from tiny_sequences import write_sequences

from boresight.campaign.cli import main
from boresight.campaign.runs.predict import predict_errors, summarise, with_predictors
from boresight.campaign.runs.resolve import resolve
from boresight.campaign.store import RunFolder
from boresight.renderers.mitsuba3 import choose_variant
from boresight.reports.run.data import read_run

LIMB = "scenarios: [scene]\nestimators: [limb, prior]\ntrials: 6\nseed: 5\n"


@pytest.fixture
def orbits(tmp_path):
    file = write_sequences(tmp_path, 12)
    file.write_text(file.read_text().replace("[dead-reckoning]", "[dead-reckoning, fixed-lag, ba-slam]"))
    return file


def test_predictions_and_a_run_are_pairs(orbits, tmp_path, capsys):
    out = tmp_path / "run"
    assert main(["run", str(orbits), "--out", str(out), "--jobs", "1", "--no-report"]) == 0
    capsys.readouterr()
    assert main(["predict", str(orbits), "--run", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "12 / 12" in printed and "RMS / predicted" in printed
    assert "no predictor: ba-slam" in printed
    campaign, others = with_predictors(resolve(str(orbits), variant=choose_variant().name))
    assert others == ["ba-slam"]
    predicted = predict_errors(campaign, 12, tmp_path / "products", print)
    found = {one.estimator: one for one in summarise(predicted, read_run(out))}
    rows = RunFolder(out).table("rows")
    own = rows[rows["estimator"] == "dead-reckoning"]["position_error_m"]
    one = found["dead-reckoning"]
    assert one.n_ok == 12 and one.error == pytest.approx(np.sqrt(np.mean(own**2)))
    assert one.ratio == pytest.approx(one.error / one.predicted)
    low, high = one.interval
    assert low < one.ratio < high and 0.5 < one.ratio < 2.0
    # Dead reckoning adds up moves with 50 % error: sigma is half of each of six moves of 6 deg, on three axes.
    assert one.predicted == pytest.approx(0.5 * 2.0 * 790.0 * np.sin(np.radians(3.0)) * np.sqrt(6.0), rel=0.01)
    assert found["fixed-lag"].predicted < 0.5 * one.predicted


def test_the_limb_is_predicted_without_an_image(cache, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("boresight.campaign.imaging.image_store.Imager.image", None)
    file = write_campaign(tmp_path, LIMB, SCENE)
    assert main(["predict", str(file), "--trials", "3"]) == 0
    printed = capsys.readouterr().out
    assert "range, m" in printed and "3 / 3" in printed and "no predictor: prior" in printed


def test_landmarks_are_predicted_with_the_range_of_an_altimeter(cache, tmp_path):
    text = (
        "scenarios: [scene]\nestimators:\n"
        f"  - landmark-harris: &harris {{database: {DATABASE}}}\n"
        "  - landmark-altimeter: {height_sigma_m: 0.1, options: *harris}\n"
        "  - landmark-altimeter: {label: on-sift, base: landmark-sift}\n"
        "trials: 3\nseed: 5\n"
    )
    file = write_campaign(tmp_path, text, SCENE + "sensors: {altimeter: {sigma_m: 0.1}}\n")
    campaign, others = with_predictors(resolve(str(file), variant=choose_variant().name))
    assert others == ["on-sift"]  # the base has no predictor
    found = predict_errors(campaign, 3, tmp_path / "products", print).set_index(["estimator", "trial"])["range_m"]
    assert found.notna().all() and (found["landmark-altimeter"] < 0.8 * found["landmark-harris"]).all()


DESIGNS = """\
grid:
  axes:
    fov: {key: camera.fov_deg, values: [10, 20, 30, 40]}
    error: {key: viewpoint.range_m, values: [4000, 5000, 6000]}
"""
VIEWS = (
    "body: {shape: apophis-like}\ncamera: {width_px: 128, height_px: 128, fov_deg: 10}\nviewpoint: {range_m: 4000}\n"
    "lighting: {phase_deg: 30}\npose_error: {position_cam_m: {normal: [30, 30, 100]}}\n"
)


def test_a_grid_of_designs_is_written_and_its_best_and_worst_are_printed(cache, tmp_path, capsys):
    file, out = write_campaign(tmp_path, LIMB + DESIGNS, VIEWS), tmp_path / "designs.csv"
    assert main(["predict", str(file), "--trials", "2", "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    table = pd.read_csv(out)
    assert list(table)[:6] == ["scenario", "fov", "error_level", "estimator", "error", "predicted"], (
        "one axis is renamed"
    )
    assert len(table) == 4 * 3 * 4, "a line for each scenario and error"
    assert set(table["n"]) == {2}
    assert "of 12 scenarios the 3 best and 3 worst" in printed and f"all 48 lines are in {out}" in printed
    lines = [line.split()[0] for line in printed.splitlines() if "range, m" in line]
    ranges = table[table["error"] == "range_m"].sort_values("predicted")["scenario"]
    assert lines == [*ranges[:3], *ranges[-3:]]
    wide = table[table["error"] == "sight_urad"].pivot_table(index="error_level", columns="fov", values="predicted")
    assert (np.diff(wide.to_numpy(), axis=1) > 0.0).all(), "a wider field has larger pixels"
    assert main(["predict", str(file), "--trials", "2", "--out", str(tmp_path / "designs.json")]) == 0
    assert [one["predicted"] for one in json.loads((tmp_path / "designs.json").read_text())] == pytest.approx(
        table["predicted"].to_list()
    )


def test_a_table_of_another_ending_is_refused(orbits, capsys):
    assert main(["predict", str(orbits), "--out", "designs.parquet"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "--out designs.parquet: ends neither in .csv nor in .json" in line


def test_an_estimator_without_a_predictor_alone_is_refused(orbits, capsys):
    assert main(["predict", str(orbits), "--estimator", "ba-slam"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "no covariance can be predicted for ba-slam" in line
    assert main(["predict", str(orbits), "--estimator", "ba"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "there are: dead-reckoning, fixed-lag, ba-slam" in line


def test_a_run_of_another_campaign_is_refused(orbits, tmp_path, capsys):
    out = tmp_path / "run"
    assert main(["run", str(orbits), "--out", str(out), "--jobs", "1", "--no-report", "--trials", "1"]) == 0
    capsys.readouterr()
    assert main(["predict", str(orbits), "--run", str(out), "--seed", "6"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "is not a run of this campaign" in line


WRONG = """\
import numpy as np

class Wrong:
    name, version = "wrong", 1
    @classmethod
    def from_options(cls, options, assets): return cls()
    def estimate(self, observation, *, rng): ...
    def predict(self, planned): return {}
"""


@pytest.mark.parametrize("answer", ["planned.frame.image.max()", "np.eye(3)", "-np.eye(6)", "np.full((6, 6), np.nan)"])
def test_what_is_no_covariance_is_refused_in_one_line(cache, tmp_path, capsys, answer):
    (tmp_path / "wrong.py").write_text(WRONG.format(answer))
    file = write_campaign(tmp_path, LIMB.replace("limb, prior", f"'{tmp_path}/wrong.py:Wrong'"), SCENE)
    assert main(["predict", str(file), "--trials", "2"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "predict of the estimator failed" in line


def test_the_errors_of_the_limb_are_those_predicted(cache, tmp_path, capsys):
    """A body of 130 px, with a prior that is ten times as wide: 40 images."""
    out = tmp_path / "run"
    scene = (
        "body: {shape: apophis-like}\ncamera: {width_px: 256, height_px: 256, fov_deg: 9.15}\n"
        "detector: {psf_sigma_px: 0.6}\n"
        "viewpoint: {range_m: 5000}\nlighting: {phase_deg: {uniform: [20, 60]}}\n"
        "pose_error: {position_cam_m: {normal: [30, 30, 100]}}\n"
    )
    file = write_campaign(tmp_path, LIMB.replace("trials: 6", "trials: 40"), scene)
    assert main(["run", str(file), "--out", str(out), "--jobs", "1", "--no-report"]) == 0
    campaign, _ = with_predictors(resolve(str(file), variant=choose_variant().name))
    found = {
        one.measure: one for one in summarise(predict_errors(campaign, 40, tmp_path / "products", print), read_run(out))
    }
    assert found["sight_urad"].n_ok == 40
    assert 0.6 < found["sight_urad"].ratio < 1.5
    assert 0.5 < found["range_m"].ratio < 1.6

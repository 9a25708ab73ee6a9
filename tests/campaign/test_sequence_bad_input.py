"""Sequences that nobody can follow, end to end: failed with reason and last good frame, and the campaign goes on."""

from __future__ import annotations

import pandas as pd
import pytest

from boresight.campaign.cli import main

# Three ranges: of a single ranged landmark one in ten is not tracked to the second frame, and the scale goes with it.
SCENE = "extends: apophis-sphere-sequence\nsequence: {orbit: {revolutions: 0.25}, knowledge: {ranges: 3}}\n"
CAMPAIGN = """\
title: Faults
experiment: sequence
scenarios: [scene.yaml]
grid:
  design: one-at-a-time
  axes:
    fault:
      label: fault
      levels:
        none: {}
        no-range: {sequence.knowledge.ranges: 0}
        few: {sequence.vision.landmarks_per_frame: 3}
        empty: {sequence.vision.landmarks_per_frame: 0.5}
        lost: {sequence.vision.repeatability: 0.01, sequence.vision.min_connection: 0}
        falls: {sequence.orbit: {model: propagated, forces: {noise_m_s2: 3.0e-5}}}
        exact: {sequence.vision.noise_px: 0, sequence.knowledge: {motion_error: 0, range_sigma_m: 1.0e-3}}
estimators: [ba-slam, ekf-slam, fixed-lag, dead-reckoning]
trials: 3
seed: 3
"""
METHODS = ["ba-slam", "ekf-slam", "fixed-lag"]


@pytest.fixture(scope="module")
def faults(tmp_path_factory):
    """Rows with the frames of each, by fault."""
    folder = tmp_path_factory.mktemp("faults")
    (folder / "scene.yaml").write_text(SCENE)
    (folder / "campaign.yaml").write_text(CAMPAIGN)
    out = folder / "out"
    assert main(["run", str(folder / "campaign.yaml"), "--jobs", "1", "--worst", "0", "--out", str(out)]) == 0
    assert (out / "report" / "report.html").stat().st_size > 10_000
    rows, epochs = (pd.read_parquet(out / name) for name in ("rows", "epochs"))
    key = ["scenario", "estimator", "trial"]
    rows = rows.join(epochs.groupby(key).size().rename("frames"), on=key).fillna({"frames": 0})
    last = epochs.sort_values("frame").groupby(key)["position_error_m"].last()
    rows = rows.join(last.rename("last_error_m"), on=key)
    fault = rows["scenario"].str.removeprefix("scene").str.removeprefix("-fault-").replace("", "none")
    assert set(rows["status"]) <= {"ok", "failed"}
    return dict(list(rows.groupby(fault)))


def of_methods(rows):
    return rows[rows["estimator"].isin(METHODS)]


def test_the_others_are_as_they_would_be_alone(faults):
    assert (faults["none"]["status"] == "ok").all()
    for name in set(faults) - {"falls"}:
        control = faults[name][faults[name]["estimator"] == "dead-reckoning"]
        assert (control["status"] == "ok").all()
        assert (control["frames"] == 46).all()


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("no-range", "frame 0: no .* the scale is unobservable"),
        ("lost", r"frame 1: tracks are lost: \d landmarks .* 3 are needed"),
        ("empty", r"the frame is empty: no track is seen|tracks are lost"),
    ],
)
def test_what_cannot_be_followed_is_failed_with_its_reason(faults, fault, said):
    rows = of_methods(faults[fault])
    assert (rows["status"] == "failed").all()
    assert rows["reason"].str.contains(said, regex=True).all()


def test_a_failed_trial_keeps_its_frames_up_to_the_last_good_one(faults):
    failed = of_methods(faults["few"]).query("status == 'failed'")
    assert len(failed) > 0
    number = failed["reason"].str.extract(r"^frame (\d+):")[0].astype(int)
    assert (failed["frames"] == number).all()
    assert failed.loc[failed["frames"] > 0, "last_error_m"].lt(100.0).all()
    assert failed["position_error_m"].isna().all()


def test_an_orbit_that_chance_leads_into_the_body_costs_its_own_trial_alone(faults):
    rows = faults["falls"]
    lost = rows[rows["reason"].str.contains("the orbit leads into the body")]
    assert 0 < lost["trial"].nunique() < rows["trial"].nunique()
    assert (lost["status"] == "failed").all()
    assert (lost.groupby("trial").size() == 4).all()
    assert (rows[~rows["trial"].isin(lost["trial"])]["frames"] == 46).all()


def test_an_exact_sequence_is_followed_exactly(faults):
    rows = of_methods(faults["exact"])
    assert (rows["status"] == "ok").all()
    assert rows["position_error_m"].max() < 0.05


def test_an_orbit_that_leads_into_the_body_by_known_forces_is_refused(tmp_path, refused):
    near = "{radius_m: 400, model: propagated, forces: {gravity: polyhedral}}"
    (tmp_path / "scene.yaml").write_text(
        "extends: apophis-sphere-sequence\nbody: {shape: contact-binary}\n"
        f"sequence: {{sphere_radius_m: null, orbit: {near}}}\n"
    )
    (tmp_path / "campaign.yaml").write_text(
        "title: x\nexperiment: sequence\nscenarios: [scene.yaml]\nestimators: [dead-reckoning]\ntrials: 1\nseed: 1\n"
    )
    error = refused("run", tmp_path / "campaign.yaml", "--jobs", 1, "--no-report", "--out", tmp_path / "out")
    assert "scene.yaml: sequence.orbit: " in error
    assert "begin farther away or lower the forces" in error


@pytest.mark.parametrize("stated", ["walk_px=-1", "walk_px=.nan", "contraction=0", "contraction=1", "drift_px=much"])
def test_impossible_knowledge_of_track_errors_is_one_line(capsys, stated):
    assert main(["validate", "vesta-simulated-slam", "--set", f"sequence.knowledge.{stated}"]) == 2
    said = capsys.readouterr().err.strip()
    assert f"sequence.knowledge.{stated.partition('=')[0]}" in said
    assert len(said.splitlines()) == 1

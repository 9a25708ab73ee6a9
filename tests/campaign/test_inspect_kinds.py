"""What `boresight inspect` draws of sequences, craters and orbits, against closed forms and what is stored."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest
from tiny_campaign import compute
from tiny_pairs import PAIRS

from boresight.campaign.cli import main
from boresight.campaign.inspection.recompute import Case, Choice, recompute, reopened
from boresight.campaign.inspection.show import look_of
from boresight.campaign.kinds.crater_matching.show import draw_pair_case
from boresight.campaign.kinds.sequence.show import followed_of, last_seen, lives_of
from boresight.campaign.store import RunFolder
from boresight.reports.compare import compare_runs
from boresight.reports.compare.tables import subject_tables
from boresight.reports.run.data import read_run

SEQUENCE = """\
extends: apophis-sphere-sequence
sequence:
  orbit: {revolutions: 0.3}
  vision: {outlier_share: 0.02}
  body_motion: {kind: spin, period_h: 30.4, axis_body: [0, 0.2, 1]}
"""
SEQUENCES = """\
title: Short sequences
experiment: sequence
scenarios: [orbit.yaml]
estimators: [fixed-lag, dead-reckoning]
trials: 2
seed: 3
"""
ORBITS = """\
title: Short arcs
experiment: orbit-determination
scenarios: [eros-like-orbit]
estimators: [batch-filter]
trials: 2
seed: 20030300
"""
MATCHING = """\
title: Pairs
experiment: crater-matching
scenarios: [pairs.yaml]
estimators: [vote]
trials: 3
seed: 5
"""


def made(folder, campaign, scenario, name, trials):
    """Run a campaign of one scenario."""
    (folder / f"{name}.yaml").write_text(scenario, encoding="utf-8")
    (folder / "campaign.yaml").write_text(campaign, encoding="utf-8")
    compute(folder / "campaign.yaml", folder / "run", trials=trials)
    return folder / "run"


@pytest.fixture(scope="module")
def sequences(cache, tmp_path_factory):
    return made(tmp_path_factory.mktemp("sequences"), SEQUENCES, SEQUENCE, "orbit", 2)


def test_a_sequence_comes_out_the_same_with_its_figures(sequences, tmp_path, capsys):
    assert main(["inspect", str(sequences), "--trial", "1", "--out", str(tmp_path)]) == 0
    assert capsys.readouterr().out.count("the same as stored, bit for bit") == 2
    drawn = {path.name for path in (tmp_path / "orbit_fixed-lag_0000001").glob("*.png")}
    assert drawn == {"trajectory.png", "errors.png", "tracks.png", "landmarks.png"}


def test_components_and_sigmas_of_a_sequence_are_those_of_its_epochs(sequences):
    folder = RunFolder(sequences)
    again = recompute(reopened(folder), folder, Case("orbit", "fixed-lag", 0))
    shown = again.shown
    truth, sequence = shown.truth, shown.observation
    followed = followed_of(shown.estimate, sequence, truth, again.records["epochs"], 190.0)
    epochs = pd.read_parquet(sequences / "epochs").query("trial == 0 and estimator == 'fixed-lag'")
    # A rotation keeps lengths and traces.
    inertial = np.linalg.norm(followed.estimated_m - followed.true_m, axis=1)
    np.testing.assert_allclose(inertial, epochs["position_error_m"], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(followed.error_m, axis=1), epochs["position_error_m"], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(followed.sigma_m, axis=1), epochs["position_sigma_m"], rtol=1e-9)
    assert np.abs(followed.true_m[:, 2]).max() < 1e-6 * np.abs(followed.true_m[:, 0]).max()
    ends = last_seen(shown.estimate, sequence, truth)
    lives = lives_of(sequence, truth, ends, len(shown.estimate.frames))
    assert lives.per_frame[:, 1].tolist() == epochs["n_tracks"].tolist()
    assert len(lives.wrong_at) == sum(int(wrong.sum()) for wrong in truth.wrong) > 0
    assert (lives.last >= lives.first).all()
    squares = np.array([error @ error for error, times in ends.values() if times > 1])
    row = pd.read_parquet(sequences / "rows").query("trial == 0 and estimator == 'fixed-lag'")
    assert np.sqrt(squares.mean()) == pytest.approx(row["final_landmark_rmse_m"].item(), rel=1e-9)


@pytest.fixture(scope="module")
def pairs(cache, tmp_path_factory):
    return made(tmp_path_factory.mktemp("pairs"), MATCHING, PAIRS, "pairs", 3)


def test_a_matched_pair_is_drawn_with_the_counts_that_are_stored(pairs, tmp_path, capsys):
    run = pairs
    assert main(["inspect", str(run), "--worst", "3", "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "n_missed_or_wrong" in said
    assert said.count("the same as stored, bit for bit") == 3
    folder = RunFolder(run)
    stored = pd.read_parquet(run / "crater_matches").set_index("trial")
    order = (stored["n_missed"] + stored["n_wrong"]).sort_values(ascending=False, kind="stable").index.tolist()
    listed = [int(line.split()[1]) for line in said.splitlines() if line.startswith("trial ")]
    assert listed == order
    again = recompute(reopened(folder), folder, Case("tiny-pairs", "vote", 0))
    title = next(iter(draw_pair_case(again).figures)).figure.get_suptitle()
    counts = stored.loc[0]
    wanted = f"{counts['n_correct']} right, {counts['n_wrong']} wrong, {counts['n_missed']} missed"
    assert title == f"trial 0 of tiny-pairs / vote: {wanted}"


def test_a_look_at_pairs_has_the_matches_that_are_stored(pairs):
    folder = RunFolder(pairs)
    look = look_of(reopened(folder), folder, read_run(pairs), Choice())
    stored = pd.read_parquet(pairs / "crater_matches")
    chances, hits = (
        sum(int(re.search(rf"{words}: (\d+)", text)[1]) for text in look.marks[0].texts)
        for words in ("in both looks", "matched rightly")
    )
    assert (chances, hits) == (stored["n_common"].sum(), stored["n_correct"].sum())
    faults = stored["n_missed"] + stored["n_wrong"]
    sets = {cameras.name: len(cameras.points_m) for cameras in look.cameras}
    assert sets.get("bad trials", 0) == 2 * (faults > faults.median()).sum(), "two cameras for each trial"
    assert sum(sets.values()) == 6
    # From 4 km, the centres of the craters lie on the body.
    assert np.linalg.norm(look.marks[0].points_m, axis=1).max() <= np.linalg.norm(look.vertices_m, axis=1).max()


def compared(run, metric):
    """Compare a run with itself; return the medians over the solved trials by estimator."""
    _, subjects = subject_tables(compare_runs([run], metric, ["estimator"]))
    found = subjects.query("trials == 'solved' and statistic == 'median'")
    return found.set_index("estimator")["value"].to_dict()


def test_matchers_are_compared_by_what_they_miss_and_mistake(pairs, capsys):
    stored, rows = pd.read_parquet(pairs / "crater_matches"), pd.read_parquet(pairs / "rows")
    solved = stored[(rows["status"] == "ok").to_numpy()]
    wanted = {
        None: 100.0 * solved["n_missed"] / solved["n_common"],
        "wrong_share": 100.0 * solved["n_wrong"] / (solved["n_wrong"] + solved["n_correct"]),
    }
    for metric, values in wanted.items():
        assert compared(pairs, metric) == {"vote": pytest.approx(values.median())}
    assert main(["compare", str(pairs), "--metric", "speed"]) == 2
    assert "choose one of missed_share, wrong_share" in capsys.readouterr().err


def test_an_orbit_is_drawn_with_its_residuals_and_looked_at(cache, tmp_path, capsys):
    campaign = ORBITS + (
        "set:\n"
        "  orbit:\n"
        "    arc: {days: 0.6, predicted_days: 0.2}\n"
        "    asteroid: {gravity_degree: 4}\n"
        "    knowledge: {shape_degree: 6}\n"
        "    sightings: {images: 30, craters: 120}\n"
    )
    (tmp_path / "campaign.yaml").write_text(campaign, encoding="utf-8")
    compute(tmp_path / "campaign.yaml", tmp_path / "run", trials=2)
    assert main(["inspect", str(tmp_path / "run"), "--trial", "1", "--look"]) == 2
    assert main(["inspect", str(tmp_path / "run"), "--trial", "1"]) == 0
    said = capsys.readouterr().out
    assert "the same as stored, bit for bit" in said
    assert len(list((tmp_path / "run" / "inspect").glob("*/residuals.png"))) == 1
    folder = RunFolder(tmp_path / "run")
    look = look_of(reopened(folder), folder, read_run(folder.path), Choice())
    assert sum(len(cameras.points_m) for cameras in look.cameras) == 2 * 30
    solved = {marks.name: marks for marks in look.marks}["landmark error, worst trial"]
    rows = pd.read_parquet(folder.path / "rows")
    worst = rows.loc[rows["position_error_m"].abs().idxmax()]
    assert len(solved.values) == worst["n_landmarks"]
    orbits = pd.read_parquet(folder.path / "orbits")
    found = compared(folder.path, "arc_rms_m")
    assert found == {"batch-filter": pytest.approx(orbits["arc_rms_m"].median())}


def test_a_kind_with_numbers_alone_says_so(cache, tmp_path, capsys):
    from tiny_campaign import DATABASE, SCENE

    campaign = f"""\
title: Solvers
experiment: pose-convergence
scenarios: [scene.yaml]
estimators:
  - pose-solver: {{database: {DATABASE}}}
trials: 30
seed: 5
"""
    run = made(tmp_path, campaign, SCENE + "pose_error: {position_cam_m: {normal: [20, 20, 5]}}\n", "scene", 30)
    assert main(["inspect", str(run), "--worst", "2"]) == 0
    assert capsys.readouterr().out.count("bit for bit") == 2
    page = next((run / "inspect").glob("*/index.html")).read_text()
    assert "trials of pose-convergence hold numbers alone" in page

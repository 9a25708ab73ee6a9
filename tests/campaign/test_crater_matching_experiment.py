"""The crater-matching experiment: scores against hand counts, reproducible rows, and wrong input."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tiny_pairs import PAIRS

from campaign.kinds.crater_matching.pairs import _found
from campaign.kinds.crater_matching.trial import (
    CraterMatching,
    check_matches,
    largest_epipolar_offset,
    score_matches,
)
from campaign.runs.resolve import resolve
from campaign.trial.kind import Bench
from estimators.craters.contract import CraterDetections, CraterImage, CraterMatches
from reports.kinds.crater_matching import RECALL, WRONG, matching_grids, matching_records
from reports.run.data import read_run
from reports.schema.grid import value_of
from scenarios.craters.pairs import CraterPair, CraterView
from scenarios.craters.simulated import NO_CRATER, LabelledDetections
from scenarios.errors import BoresightError
from scenarios.geometry import Camera, Ellipses, Pose, View
from scenarios.observation import Frame

_CAMPAIGN = """name: tiny-matching
experiment: crater-matching
scenarios: [tiny-pairs.yaml]
estimators: [vote, hybrid]
trials: 6
seed: 5
"""


@pytest.fixture(scope="module")
def campaign_file(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("matching")
    (folder / "tiny-pairs.yaml").write_text(PAIRS)
    (folder / "tiny-matching.yaml").write_text(_CAMPAIGN)
    return folder / "tiny-matching.yaml"


def _opened(path: Path, run: Path) -> CraterMatching:
    campaign = resolve(str(path))
    return CraterMatching.open(campaign, campaign.scenarios[0], Bench(run, 1, keep_images=False))


def test_trials_depend_on_their_number_alone(campaign_file, tmp_path) -> None:
    experiment = _opened(campaign_file, tmp_path)
    together, alone = experiment.run(range(4)), experiment.run(range(3, 4))
    last = [record for record in together["crater_matches"] if record["trial"] == 3]
    assert last == alone["crater_matches"]
    assert {record["estimator"] for record in last} == {"vote", "hybrid"}
    for record in together["crater_matches"]:
        assert record["n_common"] == record["n_correct"] + record["n_missed"]
        assert 0.0 <= record["view_deg"] <= 20.0
        assert (record["epipolar_offset_px"] is None) == (record["n_common"] == 0)
    found = [record for record in together["crater_matches"] if record["estimator"] == "vote"]
    assert sum(record["n_correct"] for record in found) > 0.8 * sum(record["n_common"] for record in found) > 10


def _pair(first: list[int], second: list[int]) -> CraterPair:
    camera = Camera.from_fov(100, 100, 0.1)
    pose = Pose(np.eye(3), np.array([0.0, 0.0, 1e3]))
    frame = Frame(np.zeros((100, 100), np.float32), np.array([0.0, 0.0, -1.0]), pose, np.eye(6))
    view = View(camera, pose, np.array([0.0, 0.0, -1.0]))
    rims = Ellipses(np.full((9, 2), 50.0), np.full((9, 2), 5.0), np.zeros(9))
    looks = [
        CraterView(view, LabelledDetections(rims[: len(crater)], np.array(crater)), frame) for crater in (first, second)
    ]
    return CraterPair(looks[0], looks[1], 3.0, 4.0)


def _matches(*pairs: tuple[int, int], reason: str = "") -> CraterMatches:
    return CraterMatches(np.array(pairs, dtype=np.int64).reshape(-1, 2), np.ones(len(pairs)), reason)


def test_matches_are_counted_as_by_hand() -> None:
    pair = _pair([7, 3, NO_CRATER, 5, 9], [3, 7, NO_CRATER, 8, 5])
    scored = score_matches(_matches((0, 1), (1, 3), (2, 2), (3, 4)), pair)
    assert {name: scored[name] for name in ("n_common", "n_correct", "n_wrong", "n_missed")} == {
        "n_common": 3, "n_correct": 2, "n_wrong": 2, "n_missed": 1,
    }  # fmt: skip


def _moved(look: CraterView, x_m: float, centres_px: list[tuple[float, float]]) -> CraterView:
    """The same look from a camera moved along its own x axis, with craters elsewhere."""
    rims = Ellipses(np.array(centres_px), np.full((len(centres_px), 2), 5.0), np.zeros(len(centres_px)))
    pose = Pose(np.eye(3), np.array([-x_m, 0.0, 1e3]))
    found = LabelledDetections(rims, look.detections.crater)
    return replace(look, detections=found, frame=replace(look.frame, prior_T_cam_body=pose))


def test_the_crater_farthest_from_its_epipolar_line_counts(tmp_path) -> None:
    """A camera that moves along x has rows for epipolar lines; a crater that is in one image alone does not count."""
    pair = _pair([7, 3, 5], [3, 7, 8])
    first = _moved(pair.first, 0.0, [(20.0, 30.0), (60.0, 70.0), (5.0, 5.0)])
    second = _moved(pair.second, 50.0, [(10.0, 74.0), (90.0, 28.5), (5.0, 95.0)])
    images = [
        CraterImage(k, look.frame, look.view.camera, CraterDetections(look.detections.ellipses, np.ones(3)))
        for k, look in enumerate((first, second))
    ]
    assert largest_epipolar_offset(*images, replace(pair, first=first, second=second)) == pytest.approx(4.0)
    alone = _pair([1, 2, 3], [4, 5, NO_CRATER])
    assert largest_epipolar_offset(*images, alone) is None


@pytest.mark.parametrize(("matches", "said"), [
    (_matches((0, 9)), "name a detection that there is not"),
    (_matches((0, 1), (0, 2)), "name a detection twice"),
    (_matches(), "no reason why"),
    (CraterMatches(np.zeros((1, 2), np.int64), np.zeros(2)), "score of shape"),
])  # fmt: skip
def test_matches_that_break_the_contract_are_refused(matches, said) -> None:
    pair = _pair([1, 2, 3], [1, 2, 3])
    images = [
        CraterImage(k, look.frame, look.view.camera, CraterDetections(look.detections.ellipses, np.ones(3)))
        for k, look in enumerate((pair.first, pair.second))
    ]
    with pytest.raises(ValueError, match=said):
        check_matches(matches, *images)


def test_a_run_is_stored_and_reported_with_shares_of_its_counts(campaign_file, tmp_path, capsys) -> None:
    from campaign.cli import main

    out = tmp_path / "run"
    assert main(["run", str(campaign_file), "--out", str(out), "--jobs", "1", "--worst", "0"]) == 0
    run = read_run(out)
    table = run.table("crater_matches")[run.table("crater_matches")["estimator"] == "vote"]
    records = matching_records(run)
    near = [r for r in records if r.estimator == "vote" and r.stage == "matching, views 0 to 20 deg, Suns 0 to 30 deg"]
    recall, wrong = (next(r for r in near if r.measure == name) for name in (RECALL, WRONG))
    assert recall.value == pytest.approx(100.0 * table["n_correct"].sum() / table["n_common"].sum())
    offset = next(r for r in records if r.estimator == "vote" and r.measure == "epipolar_offset_px")
    assert offset.value == pytest.approx(table["epipolar_offset_px"].median())
    assert wrong.n == int(table["n_correct"].sum() + table["n_wrong"].sum())
    assert recall.low <= recall.value <= recall.high
    assert len(matching_grids(records, run)) == 2
    told = capsys.readouterr().out
    assert f"0 to 30 deg vote             6 {value_of(recall, interval=True)}" in told
    assert "6/6 trials" in told
    assert "median" not in told  # of a position: there is none
    assert (out / "report" / "matching_tiny-pairs.png").exists()


def test_the_terminal_has_a_grid_by_its_levels(campaign_file, tmp_path, capsys) -> None:
    from campaign.cli import main

    levels = "{a: {crater_pairs.errors.centre_px: 0.1}, b: {crater_pairs.errors.centre_px: 0.4}}"
    (tmp_path / "tiny-pairs.yaml").write_text(PAIRS)
    (tmp_path / "tiny-matching.yaml").write_text(f"{_CAMPAIGN}grid:\n  axes: {{rim: {{levels: {levels}}}}}\n")
    assert main(["run", str(tmp_path / "tiny-matching.yaml"), "--out", str(tmp_path / "run"), "--worst", "0"]) == 0
    lines = [line.split()[:3] for line in capsys.readouterr().out.splitlines()]
    for level in ("a", "b"):
        for mode in ("vote", "hybrid"):
            assert [level, mode, "6"] in lines


@pytest.mark.parametrize(("change", "said"), [
    (("view_deg: {uniform: [0, 20]}", "view_deg: {uniform: [0, 95]}"), "view_deg .* is not within"),
    (("crater_pairs:", "crater_pair:"), "crater_pair"),
    (("range_m: 4000", "range_m: -1"), "range_m"),
])  # fmt: skip
def test_a_wrong_section_is_one_clear_error(campaign_file, tmp_path, change, said) -> None:
    (tmp_path / "tiny-pairs.yaml").write_text(PAIRS.replace(*change))
    (tmp_path / "tiny-matching.yaml").write_text(_CAMPAIGN)
    with pytest.raises(BoresightError, match=said):
        resolve(str(tmp_path / "tiny-matching.yaml"))


def test_a_scenario_without_pairs_and_an_unknown_matcher_are_refused(campaign_file, tmp_path) -> None:
    (tmp_path / "tiny-matching.yaml").write_text(_CAMPAIGN.replace("tiny-pairs.yaml", "quickstart"))
    campaign = resolve(str(tmp_path / "tiny-matching.yaml"))
    with pytest.raises(BoresightError, match="crater_pairs: missing"):
        CraterMatching.prepare(campaign, campaign.scenarios[0], None)  # type: ignore[arg-type]
    for detector, said in (("crater-classic", "crater-classic has no image to look at"), ("coin", "'coin' is unknown")):
        entry = f"vote: {{detector: {detector}}}"
        (tmp_path / "seen.yaml").write_text(_CAMPAIGN.replace("vote", entry).replace("tiny-matching", "seen"))
        (tmp_path / "tiny-pairs.yaml").write_text(PAIRS)
        with pytest.raises(BoresightError, match=said):
            campaign = resolve(str(tmp_path / "seen.yaml"))
            CraterMatching.prepare(campaign, campaign.scenarios[0], None)  # type: ignore[arg-type]
    (tmp_path / "other.yaml").write_text(_CAMPAIGN.replace("vote", "coin").replace("tiny-matching", "other"))
    (tmp_path / "tiny-pairs.yaml").write_text(PAIRS)
    with pytest.raises(BoresightError, match="'coin' is unknown; there are: context"):
        resolve(str(tmp_path / "other.yaml"))


class _Blind:
    name, version = "blind", 1

    def detect(self, frame: Frame, camera: Camera) -> CraterDetections:
        raise BoresightError("67 % of the image is saturated")


def test_an_image_in_which_a_detector_sees_nothing_has_no_crater() -> None:
    pair = _pair([1], [1])
    assert len(_found(_Blind(), pair.first.frame, pair.first.view.camera)) == 0

"""The crater-matching experiment: scores against hand counts, reproducible rows, and wrong input."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from tiny_pairs import PAIRS

from boresight.campaign.kinds.crater_matching import (
    CraterMatching,
    check_matches,
    largest_epipolar_offset,
    score_matches,
)
from boresight.campaign.kinds.crater_matching.pairs import RenderedPairs, _found, diameters_m
from boresight.campaign.runs.check import check_campaign
from boresight.campaign.runs.resolve import resolve
from boresight.campaign.trial.kind import WorkerContext
from boresight.campaign.trial.score import check_listed
from boresight.estimators.craters.contract import CraterDetections, CraterImage, CraterMatches
from boresight.reports.kinds.crater_matching import RECALL, WRONG, matching_grids, matching_records
from boresight.reports.run.data import read_run
from boresight.reports.schema.grid import value_of
from boresight.scenarios.bodies.embedded import icosphere
from boresight.scenarios.craters.simulated import NO_CRATER, CraterPair, CraterView, LabelledDetections
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Ellipses, Pose, View, look_at
from boresight.scenarios.geometry.ellipse import fit_conics
from boresight.scenarios.load import load_scenario
from boresight.scenarios.observation import Frame
from boresight.scenarios.sequences.ground import MeshGround
from boresight.scenarios.spec.craters import RenderedLooksSpec

_VOTE = "vote: {height_sigma_m: 30}"
_CAMPAIGN = """name: tiny-matching
experiment: crater-matching
scenarios: [tiny-pairs.yaml]
estimators: [vote: {height_sigma_m: 30}, hybrid]
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
    return CraterMatching.open(campaign, campaign.scenarios[0], WorkerContext(run, 1, keep_images=False))


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


def test_matches_of_what_is_too_small_for_the_list_of_the_truth_count_for_nothing() -> None:
    """Both no listed crater and one of them small is neither right nor wrong; a listed crater with another is wrong."""
    pair = _pair([7, NO_CRATER, NO_CRATER, NO_CRATER, NO_CRATER], [7, NO_CRATER, NO_CRATER, NO_CRATER, 8])
    looks = [
        replace(look, detections=replace(look.detections, unlisted=np.array(small, dtype=bool)))
        for look, small in ((pair.first, [0, 1, 1, 0, 1]), (pair.second, [0, 1, 0, 0, 0]))
    ]
    scored = score_matches(_matches(*((k, k) for k in range(5))), replace(pair, first=looks[0], second=looks[1]))
    assert {name: scored[name] for name in ("n_correct", "n_wrong", "n_missed", "n_unlisted")} == {
        "n_correct": 1, "n_wrong": 2, "n_missed": 0, "n_unlisted": 2,
    }  # fmt: skip
    assert score_matches(_matches((1, 1)), pair)["n_wrong"] == 1, "where all craters are listed, it is wrong"


_BALL = MeshGround(icosphere(5, 1000.0))
_CAMERA = Camera.from_fov(400, 400, np.radians(20.0))


def _above(x_m: float, y_m: float) -> View:
    """A camera 4 km from the centre of the ball, above a place on its northern half."""
    place = np.array([x_m, y_m, np.sqrt(1e6 - x_m**2 - y_m**2)])
    return View(_CAMERA, look_at(4.0 * place, np.zeros(3)), np.array([0.0, 0.0, 1.0]))


def test_the_diameter_of_a_rim_is_that_of_the_circle_on_the_ground() -> None:
    angles = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    circle = 40.0 * np.stack([np.cos(angles), np.sin(angles), np.zeros(60)], axis=1)
    for place in ((10.0, 20.0), (300.0, 0.0), (-50.0, 500.0)):
        view = _above(*place)
        points = circle + np.array([0.0, 0.0, np.sqrt(1e6 - 40.0**2)])
        uv = view.camera.project(view.T_cam_body.transform(points))
        rims = Ellipses.from_conics(fit_conics(uv[None], np.ones((1, 60))))
        assert diameters_m(rims, view, _BALL) == pytest.approx(80.0, rel=0.02)
    off_body = Ellipses(np.array([[-400.0, -400.0]]), np.array([[4.0, 4.0]]), np.zeros(1))
    assert np.isnan(diameters_m(off_body, view, _BALL)).all()


def test_a_detection_below_the_listed_sizes_is_told_from_a_false_alarm_above_them() -> None:
    """At 2.6 m per pixel, rims of 12 px are 32 m in diameter and those of 20 px 53 m; the list begins at 40 m."""
    centres = np.array([[200.0, 200.0], [150.0, 220.0], [260.0, 170.0]])
    found = Ellipses(centres, np.array([[6.0, 6.0], [6.0, 6.0], [10.0, 10.0]]), np.zeros(3))
    none = dict.fromkeys(field.name for field in fields(RenderedPairs))
    source = RenderedPairs(
        **none | {"images": RenderedLooksSpec(), "camera": _CAMERA, "ground": _BALL, "listed_from_m": 40.0}
    )
    frame = Frame(np.zeros((400, 400), np.float32), np.array([0.0, 0.0, -1.0]), _above(0.0, 0.0).T_cam_body, np.eye(6))
    truth = SimpleNamespace(ellipses=found[:1], crater=np.array([31]))
    finder = SimpleNamespace(detect=lambda *_: CraterDetections(found, np.ones(3)))
    seen = source._look(finder, _above(0.0, 0.0), frame, truth).detections
    assert (seen.crater.tolist(), seen.unlisted.tolist()) == ([31, NO_CRATER, NO_CRATER], [False, True, False])


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
    from boresight.campaign.cli import main

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
    assert f"0 to 20 deg 0 to 30 deg vote             6 {value_of(recall, interval=True)}" in told
    assert "6/6 trials" in told
    assert "median" not in told  # of a position: there is none
    assert (out / "report" / "matching_tiny-pairs.png").exists()


def test_the_terminal_counts_pairs_at_angles_that_have_no_line_of_their_own(campaign_file, tmp_path, capsys) -> None:
    from boresight.campaign.cli import main

    apart = "crater_pairs={view_deg: {uniform: [30, 40]}, sun_deg: {uniform: [31, 45]}}"
    command = ["run", str(campaign_file), "--set", apart, "--out", str(tmp_path / "run"), "--worst", "0"]
    assert main([*command, "--jobs", "1"]) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [line[:4] for line in lines if "vote" in line[:3]] == [["all", "all", "vote", "6"]]


def test_the_terminal_has_a_grid_by_its_levels(campaign_file, tmp_path, capsys) -> None:
    from boresight.campaign.cli import main

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
    (("  craters:", "  # craters:"),
     r"tiny-pairs.yaml:4: crater_pairs: give either craters or images \(craters: Plane rims, detected by geometry"),
])  # fmt: skip
def test_a_wrong_section_is_one_clear_error(campaign_file, tmp_path, change, said) -> None:
    (tmp_path / "tiny-pairs.yaml").write_text(PAIRS.replace(*change))
    (tmp_path / "tiny-matching.yaml").write_text(_CAMPAIGN)
    with pytest.raises(BoresightError, match=said):
        resolve(str(tmp_path / "tiny-matching.yaml"))


def test_a_truth_without_most_craters_is_refused_where_they_would_be_false_alarms_but_not_here() -> None:
    """A match of craters that are not listed counts for nothing."""
    few = load_scenario(str(Path(__file__).parents[1] / "before_after" / "campaigns" / "pairs-rendered.yaml"))
    with pytest.raises(BoresightError, match="57 % of the craters of 12 px or more would not be listed"):
        check_listed(few)
    CraterMatching.check_scenario(few)


def test_a_scenario_without_pairs_and_an_unknown_matcher_are_refused(campaign_file, tmp_path) -> None:
    (tmp_path / "tiny-matching.yaml").write_text(_CAMPAIGN.replace("tiny-pairs.yaml", "quickstart"))
    campaign = resolve(str(tmp_path / "tiny-matching.yaml"))
    with pytest.raises(BoresightError, match="crater_pairs: missing"):
        check_campaign(campaign, 1)
    for detector, said in (("crater-classic", "crater-classic has no image to look at"), ("coin", "'coin' is unknown")):
        entry = f"vote: {{detector: {detector}}}"
        (tmp_path / "seen.yaml").write_text(_CAMPAIGN.replace(_VOTE, entry).replace("tiny-matching", "seen"))
        (tmp_path / "tiny-pairs.yaml").write_text(PAIRS)
        with pytest.raises(BoresightError, match=said):
            campaign = resolve(str(tmp_path / "seen.yaml"))
            check_campaign(campaign, 1)
    (tmp_path / "other.yaml").write_text(_CAMPAIGN.replace(_VOTE, "coin").replace("tiny-matching", "other"))
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

"""The crater-detection experiment end to end, with detectors of this test's own."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pandas as pd
import pytest
from stored_runs import find
from terminal_text import terminal_lines
from tiny_campaign import Heard, run
from undrawn import undrawn

from boresight.campaign.cli import main
from boresight.campaign.inspection.recompute import Choice, reopened
from boresight.campaign.inspection.show import look_of
from boresight.campaign.kinds import crater_detection
from boresight.campaign.products import BuiltAssets
from boresight.campaign.runs.execute import run_campaign
from boresight.campaign.runs.manifest import RunRequest
from boresight.campaign.runs.resolve import resolve
from boresight.campaign.store import RunFolder
from boresight.estimators.craters.contract import CraterDetections
from boresight.renderers.mitsuba3 import choose_variant
from boresight.reports.kinds.crater_detection import confidence_curve, crater_records, detector_results
from boresight.reports.pages.content import read_content
from boresight.reports.run.data import read_run
from boresight.reports.schema.grid import number
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Ellipses
from boresight.scenarios.observation import Frame

SCENE = """\
description: A small cratered sphere.
body: {shape: sphere}
craters:
  {seed: 5, count: 150, min_diameter_m: 20, max_diameter_m: 120, known_diameter_m: 30, edge_m: 4, roughness: null}
camera: {width_px: 200, height_px: 160, fov_deg: 12}
detector: {psf_sigma_px: 0.8}
viewpoint: {range_m: 2000, targets: [nadir, limb, terminator]}
lighting: {phase_deg: {uniform: [30, 70]}, measure: angle}
"""
CAMPAIGN = """\
title: Craters of a small sphere
experiment: crater-detection
scenarios: [scene]
estimators: [blobs, broken, blind]
trials: 4
seed: 2
report: cheng2003-detection
"""


class Blobs:
    """Round dark or bright blobs, by OpenCV: a detector that finds some craters and much else."""

    name, version = "blobs", 1

    @classmethod
    def from_options(cls, options: Mapping[str, object]) -> Blobs:
        if options:
            raise BoresightError("blobs: there are no options")
        return cls()

    def detect(self, frame: Frame, camera: Camera) -> CraterDetections:
        image = np.clip(frame.image / max(float(frame.image.max()), 1.0) * 255.0, 0, 255).astype(np.uint8)
        found = cv2.HoughCircles(image, cv2.HOUGH_GRADIENT, 1.0, 6.0, param1=60, param2=9, minRadius=5, maxRadius=25)
        circles = np.zeros((0, 3)) if found is None else found.reshape(-1, found.shape[-1])[:, :3].astype(float)
        ellipses = Ellipses(circles[:, :2] + 0.5, np.repeat(circles[:, 2:], 2, axis=1), np.zeros(len(circles)))
        return CraterDetections.above(0.3, ellipses, np.linspace(1.0, 0.1, len(circles)))


class Broken(Blobs):
    """Raises on every image."""

    name = "broken"

    def detect(self, frame: Frame, camera: Camera) -> CraterDetections:
        raise ZeroDivisionError


class Blind(Blobs):
    """Refuses every image."""

    name = "blind"

    def detect(self, frame: Frame, camera: Camera) -> CraterDetections:
        raise BoresightError("the image is black")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("craters")
    (place / "scene.yaml").write_text(SCENE)
    (place / "tiny.yaml").write_text(CAMPAIGN)
    return place


@pytest.fixture(autouse=True, scope="module")
def _own_detectors() -> object:
    patch = pytest.MonkeyPatch()
    kinds = {kind.name: kind for kind in (Blobs, Broken, Blind)}

    def look_up(name: str) -> type[Blobs]:
        if name not in kinds:
            raise BoresightError(f"no detector is called {name}")
        return kinds[name]

    patch.setattr(crater_detection, "crater_detector_class", look_up)
    yield
    patch.undo()


@pytest.fixture(scope="module")
def done(folder: Path) -> Path:
    assert run(folder / "tiny.yaml", folder / "run", "--worst", 0) == 3  # one of the detectors raises
    return folder / "run"


def test_surfaces_are_built_by_as_many_threads_as_jobs_and_announced(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[object, ...]] = []
    monkeypatch.setattr(crater_detection, "build_surfaces", lambda *given: asked.append(given[3:]))
    campaign = resolve(str(folder / "tiny.yaml"), variant=choose_variant().name)
    for jobs in (1, 3):
        assets = BuiltAssets(campaign.scenarios[0], tmp_path, jobs, campaign.variant, print)
        crater_detection.CraterDetection.prepare(campaign, campaign.scenarios[0], assets)
    assert asked == [(1, print), (3, print)]


def test_all_trials_are_stored_whatever_a_detector_does(done: Path) -> None:
    rows = RunFolder(done).table("rows")
    status = rows.groupby("estimator")["status"].unique()
    assert status["broken"].tolist() == ["error"]
    assert status["blind"].tolist() == ["failed"]
    assert status["blobs"].tolist() == ["ok"]
    assert rows.groupby("estimator").size().tolist() == [4, 4, 4]
    assert set(rows.loc[rows["estimator"] == "blind", "reason"]) == {"the image is black"}
    assert RunFolder(done).table("tracebacks")["traceback"].str.contains("ZeroDivisionError").all()


def test_tables_agree_with_each_other(done: Path) -> None:
    store = RunFolder(done)
    images, craters, found = (store.table(name) for name in ("crater_images", "craters", "detections"))
    assert len(images) == 4
    by_trial = craters.groupby("trial")
    assert by_trial.size().reindex(images["trial"]).tolist() == images["n_craters"].tolist()
    assert by_trial["detectable"].sum().reindex(images["trial"]).tolist() == images["n_detectable"].tolist()
    assert (craters["clean"] <= craters["detectable"]).all()
    matched = found[found["crater"] >= 0]
    assert len(matched) > 5
    both = matched.merge(craters, on=["trial", "crater"], suffixes=("", "_true"))
    assert len(both) == len(matched)
    assert not matched.duplicated(["trial", "crater"]).any()
    apart = np.hypot(both["u_px"] - both["u_px_true"], both["v_px"] - both["v_px_true"])
    np.testing.assert_allclose(apart, both["centre_error_px"], atol=1e-9)
    assert (both["detectable"] == both["detectable_true"]).all()
    assert found.loc[found["crater"] < 0, "centre_error_px"].isna().all()


def test_report_counts_by_hand(done: Path) -> None:
    data = read_run(done)
    records = crater_records(data)
    every, craters = data.table("detections"), data.table("craters")
    found = every[every["confidence"] >= 0.3]
    assert 10 < len(found) < len(every)
    assert (every["kept"] == (every["confidence"] >= 0.3)).all()
    rate = find(records, estimator="blobs", measure="detection_share", statistic="mean")
    hits = found[(found["crater"] >= 0) & found["detectable"]]
    assert rate is not None
    assert rate.value == pytest.approx(100.0 * len(hits) / craters["detectable"].sum())
    assert rate.low <= rate.value <= rate.high
    false = find(records, estimator="blobs", measure="false_alarm_share", statistic="mean")
    wrong = int((found["crater"] < 0).sum())
    assert 0 < len(hits) < len(found) - wrong, "some are of craters that are listed but not detectable"
    assert false.value == pytest.approx(100.0 * wrong / (wrong + len(hits)))
    listed, beyond = (
        find(records, estimator="blobs", measure=name, statistic="mean")
        for name in ("listed_false_alarm_share", "beyond_detectable_share")
    )
    assert listed.value == pytest.approx(100.0 * wrong / len(found))
    assert beyond.value == pytest.approx(100.0 * (1.0 - len(hits) / len(found)))
    assert listed.value < false.value < beyond.value
    shape = find(records, estimator="blobs", measure="best_axes_error_px", statistic="median")
    best = found[(found["rank"] < 12) & (found["crater"] >= 0)]
    assert shape.value == pytest.approx(np.median(best[["major_error_px", "minor_error_px"]].abs()))
    assert shape.n == 2 * len(best)
    text = (done / "report" / "report.md").read_text()
    # (30^-2 - 120^-2) / (20^-2 - 120^-2) of the population, and 1 - (30^-2 - 120^-2) / (25.2^-2 - 120^-2).
    assert (
        "The truth lists craters of 30 m or more (14.3 px at the range of the views), 43 % of the population; it leaves"
        " out 31 % of those of 12 px or more. Over the detections"
    ) in text
    assert text.index("detections of detectable craters and false ones") < text.index("any listed crater counting")
    blind = find(records, estimator="blind", measure="detection_share", statistic="mean")
    assert blind.value == 0.0
    one = next(one for one in detector_results(data) if one.estimator == "blobs")
    curve = confidence_curve(one)
    assert curve["detectable"].iloc[len(found) - 1] == pytest.approx(rate.value / 100.0)
    assert curve["false_share"].iloc[len(found) - 1] == pytest.approx(false.value / 100.0)
    assert len(curve) == len(every)
    assert np.all(np.diff(curve["detectable"]) >= 0.0)
    half = one.detections.sort_values("confidence", ascending=False).head(7)
    assert curve["listed_false_share"].iloc[6] == pytest.approx((half["crater"] < 0).mean())


def test_rejected_detections_are_scored_and_are_not_kept() -> None:
    rims = Ellipses(np.array([[50.0, 50.0], [20.0, 30.0]]), np.full((2, 2), 9.0), np.zeros(2))
    nothing = np.zeros(0, dtype=np.int64)
    truth = SimpleNamespace(ellipses=Ellipses.none(), crater=nothing, detectable=nothing, clean=nothing)
    records = crater_detection._scored(CraterDetections.above(0.5, rims, np.array([0.8, 0.3])), truth)
    assert [(one["u_px"], one["confidence"], one["kept"]) for one in records] == [(50.0, 0.8, True), (20.0, 0.3, False)]


def test_report_shows_images_curves_and_the_papers_claim(done: Path) -> None:
    report = done / "report"
    names = {path.name for path in report.iterdir()}
    assert {"crater_curves_scene.png", "crater_rates_scene.png"} <= names
    assert any(name.startswith("crater_example_scene_blobs") for name in names)
    text = (report / "report.md").read_text()
    for words in ("Detection of craters", "by diameter", "by degradation", "by incidence", "by confidence", "90 %"):
        assert words in text
    assert "nan" not in text.lower().replace("finance", "")
    assert read_content(done).comparison is not None


def test_the_terminal_shows_the_rates_of_each_detector(done: Path) -> None:
    rate = find(crater_records(read_run(done)), estimator="blobs", measure="detection_share", statistic="mean")
    lines = [line.split() for line in terminal_lines(done)]
    assert [line[1] for line in lines if line[:1] == ["blobs"]] == [number(rate.value)]
    assert ["blind", "0", "[0,", "49.0]"] in [line[:4] for line in lines]


def test_a_look_colours_craters_by_how_often_they_are_detected(done: Path) -> None:
    folder = RunFolder(done)
    look = look_of(reopened(folder), folder, read_run(done), Choice(estimator="blobs"))
    craters, detections = folder.table("craters"), folder.table("detections")
    own = detections[(detections["estimator"] == "blobs") & detections["kept"] & detections["detectable"]]
    told = [
        {int(re.search(r"crater (\d+)", text)[1]): int(re.search(rf"{word}: (\d+)", text)[1]) for text in marks.texts}
        for marks in look.marks
        for word in ("detectable", "detected")
    ]
    assert told[0] == craters.loc[craters["detectable"], "crater"].value_counts().to_dict()
    assert {crater: hits for crater, hits in told[1].items() if hits} == own["crater"].value_counts().to_dict()
    assert sum(told[1].values()) > 0
    np.testing.assert_allclose(np.linalg.norm(look.marks[0].points_m, axis=1), 250.0, rtol=0.1)
    assert sum(len(cameras.points_m) for cameras in look.cameras) == 4


def test_detectors_are_compared_by_what_they_miss(done: Path, tmp_path: Path) -> None:
    assert main(["compare", str(done), "--out", str(tmp_path)]) == 0
    store = RunFolder(done)
    images, every = store.table("crater_images").set_index("trial"), store.table("detections")
    hits = every[every["kept"] & every["detectable"]].groupby("trial").size().reindex(images.index).fillna(0)
    missed = 100.0 * (1.0 - hits / images["n_detectable"])
    subjects = pd.read_csv(tmp_path / "subjects.csv").query("metric == 'missed_share' and statistic == 'median'")
    value = subjects.set_index(["estimator", "trials"])["value"]
    assert value["blobs", "solved"] == pytest.approx(missed.median())
    for failing in ("blind", "broken"):
        assert value[failing, "failures-worst"] == np.inf, "a detector that finds nothing is not the better one"
    against = pd.read_csv(tmp_path / "differences.csv").set_index(["subject", "against"])
    assert against.loc[("broken, scene", "blobs, scene"), "better_of_all"] == 0.0


def test_same_seed_same_rows(folder: Path, done: Path) -> None:
    campaign = resolve(str(folder / "tiny.yaml"), variant=choose_variant().name)
    run_campaign(campaign, RunRequest(folder / "again", 4, 1), Heard())
    for name in ("crater_images", "craters", "detections", "rows"):
        first, second = (RunFolder(path).table(name) for path in (done, folder / "again"))
        pd.testing.assert_frame_equal(first, second)


def test_worlds_of_craters_are_the_unit_where_there_are_several(folder: Path, done: Path) -> None:
    """Trials 0 and 2 are of the first world, the one of a campaign with a single world, and the others of another."""
    (folder / "worlds.yaml").write_text(CAMPAIGN + "databases: 2\n")
    with undrawn("png", "pdf"):
        assert run(folder / "worlds.yaml", folder / "worlds", "--worst", 0) == 3
    several, one = (RunFolder(path).table("craters").set_index("trial") for path in (folder / "worlds", done))
    pd.testing.assert_frame_equal(several.loc[[0, 2]], one.loc[[0, 2]])
    assert not several.loc[[1, 3]].reset_index().equals(one.loc[[1, 3]].reset_index())
    assert (
        RunFolder(folder / "worlds").table("rows").groupby("trial")["database"].unique().str[0].tolist() == [0, 1] * 2
    )
    ours = next(iter(detector_results(read_run(folder / "worlds"))))
    assert ours.craters.groupby("trial")["unit"].nunique().eq(1).all() and ours.craters["unit"].nunique() == 2
    assert "The world of craters was drawn 2 times" in (folder / "worlds" / "report" / "report.md").read_text()
    assert main(["inspect", str(folder / "worlds"), "--trial", "1", "--estimator", "blobs"]) == 0


def test_scenario_without_craters_is_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    head, tail = SCENE.split("craters:")
    (folder / "scene2.yaml").write_text(head + tail.split("\n", 2)[2])
    (folder / "bare.yaml").write_text(CAMPAIGN.replace("[scene]", "[scene2]"))
    assert main(["run", str(folder / "bare.yaml"), "--out", str(folder / "bare")]) == 2
    message = capsys.readouterr().err
    assert "craters" in message
    assert "add the section" in message


def test_a_truth_without_most_detectable_craters_is_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of 12 px and more, which are 25.2 m at 2 km, 1 - (60^-2 - 120^-2) / (25.2^-2 - 120^-2) = 86 % are below 60 m."""
    (folder / "few.yaml").write_text(SCENE.replace("known_diameter_m: 30", "known_diameter_m: 60"))
    (folder / "refused.yaml").write_text(CAMPAIGN.replace("[scene]", "[few]"))
    assert main(["run", str(folder / "refused.yaml"), "--out", str(folder / "refused")]) == 2
    message = capsys.readouterr().err
    assert "few.yaml: craters.known_diameter_m: 60 m is 28.5 px at the range of the views, and 86 % of" in message
    assert "give at most 25.2" in message

"""Real errors over simulated ones: medians of resamples, coverage of the ratio's interval, verdicts, the table."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from stored_runs import RunBuilder, pose_error

from boresight.campaign.papers.page import FinishedRun, PaperFigure, drawn
from boresight.campaign.papers.reality import PAPER, SCORES
from boresight.campaign.store import RunFolder
from boresight.reports.figures.named import NamedFigure
from boresight.reports.run.data import read_run
from boresight.reports.statistics.reality import Side, levels_of, ratio_interval, reality_rows, verdict
from boresight.scenarios.errors import BoresightError


def side(error_m, unit) -> Side:
    return Side(np.asarray(error_m, dtype=float), np.asarray(unit).astype(str))


def test_medians_of_resamples_are_those_of_the_values_written_out():
    rng = np.random.default_rng(1)
    unit = rng.integers(0, 7, 40)
    error_m = np.where(rng.uniform(size=40) < 0.2, np.nan, rng.gamma(2.0, 5.0, 40))
    names = np.unique(unit.astype(str))
    counts = rng.multinomial(7, np.full(7, 1 / 7), size=50).astype(np.int32)
    expected = [np.nanmedian(np.repeat(error_m, row[np.searchsorted(names, unit.astype(str))])) for row in counts]
    np.testing.assert_allclose(side(error_m, unit).medians_m(names, counts), expected)


@pytest.mark.parametrize("paired", [True, False])
def test_the_interval_of_a_ratio_covers_the_true_one(paired):
    """Two trials for each of 60 images, whose difficulty both sides share if they are paired; true ratio 1.3."""
    rng, covered, widths = np.random.default_rng(3), 0, []
    for _ in range(80):
        difficulty = rng.normal(0.0, 0.5, 60)
        other = difficulty if paired else rng.normal(0.0, 0.5, 60)
        real = np.exp(np.tile(difficulty, 2) + rng.normal(0.0, 0.3, 120)) * 13.0
        simulated = np.exp(np.tile(other, 2) + rng.normal(0.0, 0.3, 120)) * 10.0
        names = np.tile(np.arange(60), 2)
        found = ratio_interval(side(real, names), side(simulated, names if paired else names + 100))
        covered += found[0] <= 1.3 <= found[1]
        widths.append(found[1] / found[0])
    assert covered >= 70, "of 80; 76 are expected"
    # Images of which both sides have the same draw leave less open.
    assert np.median(widths) < 1.45 if paired else np.median(widths) > 1.45


def test_tracks_that_share_their_images_have_the_interval_of_the_simulated_trials():
    simulated = side(np.arange(1.0, 41.0), np.arange(40))
    real = side(np.full(20, 41.0), np.zeros(20))
    assert ratio_interval(real, simulated) is None, "one image has no interval"
    low, high = ratio_interval(real, simulated, shared=True)
    assert 41.0 / 30.0 < low < 2.0 < high < 41.0 / 10.0


@pytest.mark.parametrize(
    ("interval", "said"),
    [
        ((0.71, 1.39), "as predicted"), ((0.5, 1.2), "open"), ((1.2, 1.6), "open"), ((1.41, 3.0), "differs"),
        ((0.1, 0.69), "differs"), (None, "no interval"),
    ],
)  # fmt: skip
def test_the_verdict_goes_by_the_interval_alone(interval, said):
    assert verdict(interval) == said


GRID = {
    "design": "star",
    "axes": [{"name": "images", "label": "images", "levels": ["real", "rendered"]}],
    "scenarios": [
        {"name": f"views-{level}", "base": "views", "levels": {"images": level}} for level in ("real", "rendered")
    ],
}


@pytest.fixture
def both(tmp_path):
    """A run of 12 images, real and rendered: the real errors are 3 times the rendered ones, and one trial fails."""
    builder = RunBuilder(tmp_path / "run")
    for scenario, factor in (("views-real", 3.0), ("views-rendered", 1.0)):
        for trial in range(24):
            for estimator in ("prior", "lmaps"):
                solved = (scenario, trial, estimator) != ("views-real", 5, "lmaps")
                error = pose_error((factor * (10 + trial % 12), 0.0, 0.0), 0.1)
                builder.add(
                    "rows", trial=trial, scenario=scenario, estimator=estimator, reason="",
                    status="ok" if solved else "failed", image=f"{trial % 12}.png", n_landmarks=0,
                    nees=6.0 * factor if solved and estimator == "lmaps" else np.nan,
                    **(error if solved else dict.fromkeys(error, np.nan)),
                )  # fmt: skip
    scenarios = {f"views-{level}": {"name": f"views-{level}"} for level in ("real", "rendered")}
    return builder.write(
        name="compare-navcam67p", estimators=["prior", "lmaps"], grid=GRID, scenarios=scenarios, trials=24
    )


def test_the_table_has_a_line_for_each_method_that_both_have(both):
    run = read_run(both)
    assert levels_of(run, {"images": "real"}) == {(): "views-real"}
    (line,) = reality_rows("67P", (run, "views-real"), (run, "views-rendered"))
    assert line["method"] == "lmaps"
    assert (line["ok, real"], line["ok, simulated"]) == ("23/24", "24/24")
    assert (line["real, m"], line["simulated, m"]) == ("48.0", "16.0")
    assert line["ratio [95 %]"].startswith("3.00 [")
    assert (line["in the central 90 %"], line["verdict"]) == ("no", "differs")
    assert (line["NEES/n, real"], line["NEES/n, simulated"]) == ("3.00 [3.00, 3.00]", "1.00 [1.00, 1.00]")


def test_medians_are_of_trials_with_an_estimate_on_both_sides(both):
    run = read_run(both)
    run.rows.loc[(run.rows["scenario"] == "views-rendered") & (run.rows["trial"] >= 12), "status"] = "failed"
    (line,) = reality_rows("67P", (run, "views-real"), (run, "views-rendered"))
    assert (line["ok, real"], line["ok, simulated"]) == ("23/24", "12/24")
    # Trials 0 to 11 without 5, which failed on the real side.
    assert line["real, m"] == f"{3 * np.median([10 + i for i in range(12) if i != 5]):.1f}"
    assert line["ratio [95 %]"].startswith("3.00 [")


@pytest.mark.parametrize("solved", [1, 9, 10])
def test_an_interval_needs_ten_images_with_an_estimate(solved):
    names, error_m = np.arange(20), np.arange(1.0, 21.0)
    few = side(np.where(names < solved, error_m, np.nan), names)
    assert (ratio_interval(few, side(error_m, names)) is None) == (solved < 10)
    assert (ratio_interval(side(error_m, names), few) is None) == (solved < 10)


def test_a_ratio_without_a_value_is_none(both):
    run = read_run(both)
    run.rows.loc[run.rows["scenario"] == "views-rendered", "position_error_m"] = 0.0
    (line,) = reality_rows("67P", (run, "views-real"), (run, "views-rendered"))
    assert [line[name] for name in ("ratio [95 %]", "in the central 90 %", "verdict")] == ["-", "-", "-"]


def test_a_run_of_before_the_renderings_is_named(both):
    manifest = json.loads((both / "manifest.json").read_text())
    (both / "manifest.json").write_text(json.dumps({**manifest, "grid": None}))
    with pytest.raises(BoresightError, match="has not both real images and renderings of their views: run it again"):
        PAPER.tables[0]({"compare-navcam67p": FinishedRun(RunFolder(both), {})})


def test_the_page_draws_the_runs_that_are_there(both):
    (grid,) = PAPER.tables[0]({"compare-navcam67p": FinishedRun(RunFolder(both), {})})
    table = pd.DataFrame(grid.rows, columns=grid.columns)
    assert table["seen"].tolist() == ["67P, 60 images"]
    assert PAPER.tables[0]({}) == []


def test_craters_are_those_of_the_stored_scores(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(BoresightError, match="to make it: boresight craters-real"):
        PAPER.tables[1]({})
    SCORES.parent.mkdir(parents=True)
    lines = ["all,0.3,moon,4", "isolated,0.5,moon,4", "all,0.4,mars,4", "all,0.8,rendered,4"]
    lines += ["all,0.6,moon,10", "all,0.7,mars,10", "all,1.0,rendered,10"]
    told = "".join(f"{line},crater-learned,choices\n" for line in lines)
    SCORES.write_text(f"labels,recall_10,ground,least_px,detector,set\n{told}")
    (grid,) = PAPER.tables[1]({})
    assert grid.title.endswith("crater-learned, images of the Moon for choices")
    assert grid.columns[1] == "labels from, px radius"
    assert grid.rows == (
        ("moon", "4.00", "0.300", "0.800", "0.375"),
        ("mars", "4.00", "0.400", "0.800", "0.500"),
        ("moon", "10.0", "0.600", "1.00", "0.600"),
        ("mars", "10.0", "0.700", "1.00", "0.700"),
    )
    SCORES.write_text("labels,recall_10\nall,0.3\n")
    with pytest.raises(BoresightError, match=r"scores\.csv: cannot be read"):
        PAPER.tables[1]({})


def test_a_figure_without_campaigns_needs_no_run():
    drawing = NamedFigure("_alone", Figure(), "Drawn.", "A picture.")
    (named,) = drawn(PaperFigure("5", (), lambda: [drawing]), {}, None)
    assert (named.stem, named.caption) == ("figure_05_alone", "Figure 5. Drawn.")
    with pytest.raises(BoresightError, match="not drawn without a finished run of vesta-real-slam"):
        drawn(PaperFigure("3", ("vesta-real-slam",), lambda run: [drawing]), {}, None)

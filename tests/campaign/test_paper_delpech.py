"""The page of Delpech et al. (2015), from small runs that go by the names of its campaigns."""

from __future__ import annotations

import pandas as pd
import pytest
from ruamel.yaml import YAML
from test_published_records import CAMPAIGNS, DELPECH, EASED, lost
from tiny_campaign import compute

from boresight.campaign.cli import main
from boresight.campaign.runs.read import CATALOG
from boresight.reports.pages.content import read_content

TRIALS = 2


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Run the campaigns of the catalogue with few trials and frames; what it takes to follow 6 deg steps is eased."""
    folder = tmp_path_factory.mktemp("delpech")
    yaml = YAML(typ="safe", pure=True)
    for name in sorted(DELPECH):
        spec = yaml.load((CATALOG / f"{name}.yaml").read_text(encoding="utf-8"))
        spec["trials"] = TRIALS
        spec["set"] = {**spec.get("set", {}), **EASED}
        file = folder / f"{name}.yaml"
        with file.open("w", encoding="utf-8") as stream:
            yaml.dump(spec, stream)
        compute(file, folder / "runs" / name, TRIALS)
    return folder / "runs"


@pytest.fixture(scope="module")
def page(runs):
    """What the command writes."""
    out = runs.parent / "figures"
    assert main(["figures", "delpech2015", "--runs", str(runs), "--out", str(out)]) == 0
    return out


def test_figures_have_the_numbers_of_the_paper(page):
    drawn = {path.stem for path in page.glob("figure_*.png")}
    assert {f"figure_{n}" for n in ("3.1", "3.2", "4.1", "4.2", "5.1", "5.2")} <= drawn
    assert {path.name for path in page.glob("table_*")} == {"table_03.png", "table_03.pdf"}
    text = (page / "table.md").read_text(encoding="utf-8")
    assert "Figure 4.2. Position error after whole revolutions by views" in text


def test_the_numbers_are_those_of_the_rows(page, runs):
    table = pd.read_csv(page / "table.csv")
    rows = pd.read_parquet(runs / "delpech2015-comparison" / "rows")
    for n in (10, 15, 20):
        for method in ("ekf-slam", "ba-slam"):
            scenario = f"apophis-sphere-sequence-{n}"
            mine = rows[(rows["scenario"] == scenario) & (rows["estimator"] == method)]
            one = table["quantity"].str.startswith("position error after 1 revolution, sequence")
            told = table[one & (table["scenario"] == scenario) & (table["estimator"] == method)].set_index("statistic")
            assert told.loc["mean", "ours"] == pytest.approx(mine["error_after_1_m"].mean())
            assert told.loc["deviation", "ours"] == pytest.approx(mine["error_after_1_m"].std())
            assert told.loc["mean", "n"] == TRIALS


def test_reductions_stand_beside_the_sentences_of_the_paper(page, runs):
    table = pd.read_csv(page / "table.csv")
    told = table[(table["campaign"] == "delpech2015-ba-views") & (table["estimator"] == "ba-slam-7")]
    rows = pd.read_parquet(runs / "delpech2015-ba-views" / "rows")
    mean = (
        rows.pivot_table(index="trial", columns="estimator", values="error_after_2_m")[["ba-slam-3", "ba-slam-7"]]
        .dropna()
        .mean()
    )
    mine = told[told["quantity"].str.startswith("position error after 2 revolutions, reduction")]["ours"].item()
    assert mine == pytest.approx(100 * (1 - mean["ba-slam-7"] / mean["ba-slam-3"]))


@pytest.mark.parametrize("name", sorted(DELPECH & set(CAMPAIGNS)))
def test_every_value_and_statement_finds_its_numbers(runs, name):
    content = read_content(runs / name)
    assert lost(content, content.comparison) == []

"""Campaigns from Python give what the command line stores."""

from __future__ import annotations

import pandas as pd
import pytest
from tiny_campaign import run as run_command
from tiny_campaign import write_campaign

from boresight import campaign, reports
from boresight.scenarios.errors import BoresightError


class Heard:
    def __init__(self):
        self.steps = []

    def message(self, text):
        self.steps.append(text)

    def started(self, done, total):
        self.steps.append((done, total))

    def block(self, records, trials):
        self.steps.append(trials)


def test_the_rows_are_those_of_the_command_and_a_run_goes_on(tmp_path):
    file = write_campaign(tmp_path)
    assert run_command(file, tmp_path / "command", "--trials", 20) == 0
    heard = Heard()
    first = campaign.run(file, trials=10, jobs=1, out=tmp_path / "python")
    rows = campaign.run(file, trials=20, jobs=1, out=tmp_path / "python", listener=heard)
    stored = pd.read_parquet(tmp_path / "command" / "rows")
    pd.testing.assert_frame_equal(rows, stored)
    pd.testing.assert_frame_equal(first, stored[stored["trial"] < 10].reset_index(drop=True))
    assert (10, 20) in heard.steps, "ten were stored already"
    assert rows.attrs["folder"] == str(tmp_path / "python")


def test_a_run_of_fewer_trials_than_are_stored_returns_as_many_as_asked_for(tmp_path):
    file = write_campaign(tmp_path)
    campaign.run(file, trials=20, jobs=1, out=tmp_path / "run")
    again = campaign.run(file, trials=10, jobs=1, out=tmp_path / "run")
    assert set(again["trial"]) == set(range(10))


def test_statistics_are_those_of_the_rows(tmp_path):
    rows = campaign.run(write_campaign(tmp_path), trials=10, jobs=1, out=tmp_path / "run")
    table = reports.summary(tmp_path / "run")
    ours = table.query("estimator == 'prior' and stage == 'final' or estimator == 'prior' and stage == 'prior'")
    median = ours.query("measure == 'position_error_m' and statistic == 'median'")["value"].iloc[0]
    assert median == pytest.approx(rows.query("estimator == 'prior'")["position_error_m"].median())
    assert len(reports.read_run(rows.attrs["folder"]).rows) == len(rows)


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"trials": 0}, "--trials 0: give 1 or more"),
        ({"jobs": -1}, "--jobs -1: give 1 or more"),
        ({"overrides": ["camera.fov=3"]}, "camera.fov"),
        ({"until": "now"}, "--until 'now'"),
    ],
)
def test_what_cannot_be_run_is_refused_in_one_line_and_leaves_nothing(tmp_path, asked, said):
    file = write_campaign(tmp_path)
    with pytest.raises(BoresightError, match=said) as refused:
        campaign.run(file, out=tmp_path / "run", **asked)
    assert "\n" not in str(refused.value)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("module", [campaign, reports])
def test_an_unknown_name_is_an_attribute_error(module):
    with pytest.raises(AttributeError, match="no attribute 'walk'"):
        module.walk  # noqa: B018  the look-up is what is tested

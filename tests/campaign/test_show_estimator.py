"""``boresight show ESTIMATOR`` prints the page of an estimator."""

from __future__ import annotations

import pytest

from boresight.campaign.cli.main import main
from boresight.estimators.pages import SECTIONS


@pytest.mark.parametrize("name", ["landmark-ransac", "fixed-lag", "crater-learned", "vote", "batch-filter", "prior"])
def test_show_prints_the_page_in_short(name, capsys):
    assert main(["show", name]) == 0
    said = capsys.readouterr().out
    lines = said.splitlines()
    assert lines[0].startswith(f"{name}, version ")
    headings = [line for line in lines if line in (*SECTIONS, "Options")]
    assert headings == [*SECTIONS, "Options"]
    assert max(map(len, lines)) <= 100
    assert "`" not in said


def test_show_prints_each_option_with_type_unit_and_default(capsys):
    assert main(["show", "landmark-ransac"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    line = "alignment_sigma_px: Standard deviation of that alignment, each axis (number above 0, px, default: 3.6)"
    assert line in said


def test_show_prints_the_detector_that_trials_of_every_matcher_take(capsys):
    for name, takes in (("vote", True), ("hybrid", True), ("crater-classic", False)):
        assert main(["show", name]) == 0
        assert ("\n  detector: Crater detector that finds" in capsys.readouterr().out) == takes

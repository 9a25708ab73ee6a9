"""The lines of a paper's table: whose a number is."""

from __future__ import annotations

from typing import cast

import pytest

from boresight.reports.kinds import Content
from boresight.reports.pages.paper import paper_grid, paper_lines
from boresight.reports.published import load_published
from boresight.reports.run.data import RunData
from boresight.reports.schema.records import Record
from boresight.reports.verdicts import compare, compare_claims


def made_by(labels: list[str]) -> Content:
    records = tuple(
        Record("eros-like-navigation", label, "orbit", "", "arc_rms_m", "m", "median", 10.0 + k, None, None, 1, 1)
        for k, label in enumerate(labels)
    )
    comparison = load_published("cheng2003-endtoend")
    return Content(cast("RunData", None), records, comparison, compare(records, comparison), (), ())


@pytest.mark.parametrize(
    ("labels", "ends"), [(["vote"], ["orbit"]), (["hybrid", "vote"], ["orbit, hybrid", "orbit, vote"])]
)
def test_estimators_are_named_where_there_are_several(labels, ends):
    content = made_by([*labels, "another's"])
    assert content.comparison is not None
    lines = [line for line in paper_lines("a run", content.comparison, content, labels) if line.ours != (None,)]
    assert [line.quantity.removeprefix("RMS position error over the arc, ") for line in lines] == ends
    assert [line.ours[0].value for line in lines if line.ours[0]] == [10.0 + k for k in range(len(labels))]


def test_a_share_of_trials_within_a_bound_says_so():
    comparison = load_published("cheng2003-orbit")
    within = Record("eros", "batch-filter", "orbit", "", "arc_rms_m", "%", "within 100", 75.0, 53.0, 89.0, 15, 20)
    content = Content(cast("RunData", None), (within,), comparison, (), compare_claims([within], comparison), ())
    (line,) = [one for one in paper_lines("a run", comparison, content, []) if one.ours == (within,)]
    assert (line.statistic, line.verdict) == ("% of trials within 100 m", "differs (lower)")
    assert paper_grid([line]).keep("ours [95 %]", "ok").rows == (("75.0 [53.0, 89.0]", "15/20"),)

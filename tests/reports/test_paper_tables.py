"""The tables of a paper as drawings: what stands in them, under which number."""

from __future__ import annotations

from dataclasses import replace

import pytest

from boresight.reports.pages.paper import PaperLine, draw_table, lines_by_table, table_figure
from boresight.reports.schema.grid import Grid
from boresight.reports.schema.records import Record

OURS = Record("s", "ekf", "sequence", "", "landmark_rmse_m", "m", "mean", 3.5, 3.0, 4.0, 9, 10)
LINE = PaperLine("c", "s", "ekf", "Table 3", "landmark RMSE", "mean", "3.72 m", (OURS,), None, "context")


def test_lines_belong_to_the_table_that_their_place_begins_with():
    places = ["table 12", "Table 3, second row", "section 4, after table 3", "table 3", "figure 4", "tables of others"]
    found = lines_by_table([replace(LINE, place=place) for place in places])
    assert {number: [line.place for line in lines] for number, lines in found.items()} == {
        "3": ["Table 3, second row", "table 3"],
        "12": ["table 12"],
    }


def test_a_table_shows_the_paper_s_number_ours_and_the_verdict():
    named = table_figure("3", [LINE, replace(LINE, ours=(None,), verdict="not measured")])
    assert named.stem == "table_03"
    assert named.caption.startswith("Table 3. ")
    texts = [text.get_text() for text in named.figure.axes[0].texts]
    assert {"3.72 m", "3.50 [3.00, 4.00]", "9/10", "context", "not measured"} <= set(texts)
    assert "tolerance" not in texts, "nothing stands in that column"


@pytest.mark.parametrize("rows", [1, 40])
def test_no_cell_of_a_drawn_table_touches_another(rows):
    cells = [(f"a name of row {i}" * (1 + i % 3), f"{10**i % 977}", "x" * (i % 7)) for i in range(rows)]
    figure = draw_table(Grid("A table", ("what", "number", "remark"), tuple(cells), frozenset({0, 2})))
    figure.draw_without_rendering()
    boxes = [text.get_window_extent() for text in figure.axes[0].texts if text.get_text()]
    for i, one in enumerate(boxes):
        assert one.x0 >= 0.0
        assert one.x1 <= figure.bbox.width
        assert not any(one.overlaps(other) for other in boxes[i + 1 :])

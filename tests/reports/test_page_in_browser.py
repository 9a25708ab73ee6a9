"""Pages in a real browser: they open from their files, sort, answer the pointer, print and fit a phone."""

from __future__ import annotations

import re

import numpy as np
import pytest
from browser import needs_chromium, opened
from stored_runs import ESTIMATOR, RunBuilder

from boresight.reports.compare import compare_runs
from boresight.reports.pages.build import write_board, write_report
from boresight.reports.pages.comparison import write_comparison

pytestmark = needs_chromium


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """Report two estimators whose errors are 1, 2, ... m and 10, 20, ... m; one trial of the latter fails."""
    builder = RunBuilder(tmp_path_factory.mktemp("run"))
    for trial in range(20):
        far = (np.array([1.0, 2.0, 40.0 + trial]), 1.0)
        builder.trial(trial, far, (np.array([0.0, 0.0, trial + 1.0]), 0.1), n_landmarks=9)
        other = None if trial == 7 else (np.array([0.0, 0.0, 10.0 * (trial + 1)]), 0.3)
        builder.trial(trial, far, other, estimator="mine", reason="" if other else "nothing was found", n_landmarks=3)
    return write_report(builder.write(estimators=[ESTIMATOR, "mine"]))


@pytest.fixture(scope="module")
def page(report):
    with opened(report.html) as page:
        yield page


def column(page, table, heading):
    """Return a table's cells under a heading, from the top."""
    headings = [text.strip() for text in table.locator("thead th").all_inner_texts()]
    return [row.locator("td").nth(headings.index(heading)).inner_text() for row in table.locator("tbody tr").all()]


def test_a_click_on_a_heading_sorts_and_a_second_turns_it_round(page):
    table = page.locator("table.sortable").first
    heading = table.locator("thead th.number").first
    name = heading.inner_text().strip()
    before = column(page, table, name)
    heading.click()
    assert heading.get_attribute("aria-sort") == "ascending"
    ascending = column(page, table, name)
    assert sorted(ascending) == sorted(before)
    numbers = [float(re.search(r"[\d.]+", cell)[0]) for cell in ascending if re.search(r"\d", cell)]
    assert numbers == sorted(numbers)
    heading.press("Enter")
    assert heading.get_attribute("aria-sort") == "descending"
    turned = [float(re.search(r"[\d.]+", cell)[0]) for cell in column(page, table, name) if re.search(r"\d", cell)]
    assert turned == sorted(numbers, reverse=True)


def test_it_prints(page):
    assert page.pdf().startswith(b"%PDF")


def test_all_of_it_is_there_without_its_script(report):
    text = report.html.read_text(encoding="utf-8")
    bare = re.sub(r"<script>.*?</script>", "", text, flags=re.S)
    assert "nothing was found" in bare
    assert not re.search(r"""(src|href)=["'](https?:)?//""", text), "nothing comes from elsewhere"


NARROW, WIDE = 390, 1280
STAYS = """table => {
  const region = table.closest(".scroll"), cell = table.querySelector("tbody td");
  const before = cell.getBoundingClientRect().left;
  region.scrollLeft = 10000;
  return [region.scrollLeft, cell.getBoundingClientRect().left - before];
}"""
"""Scrolls a table to its right end; returns how far it went, and how far its first cell moved."""


def test_every_page_fits_its_window_and_wide_tables_keep_their_first_column(page, report, tmp_path):
    compared, _ = write_comparison(compare_runs([report.folder.parent]), tmp_path / "compared")
    board, refused = write_board([report.folder.parent], tmp_path / "board", "boresight board")
    assert refused == ()
    before = page.viewport_size
    for path in (compared, board, report.html):
        page.goto(path.resolve().as_uri())
        for width in (WIDE, NARROW):
            page.set_viewport_size({"width": width, "height": 900})
            assert page.evaluate("document.documentElement.scrollWidth") == width, (path.name, width)
            if path == report.html:
                picture = page.locator("figure img").first.bounding_box()
                assert picture["y"] + picture["height"] < 2 * 900, "the first picture is on the first two screens"
        moves = [table.evaluate(STAYS) for table in page.locator("table").all()]
        assert max(far for far, _ in moves) > 100.0, "some table is wider than a phone"
        assert [moved for far, moved in moves if far and moved] == []
    page.set_viewport_size(before)
    page.goto(board.as_uri())
    page.locator("td a").click()
    assert page.title() == report.content.run.manifest.title

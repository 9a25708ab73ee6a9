"""A report that would be the same is not made again; any other is."""

from __future__ import annotations

import io
import shutil
from contextlib import redirect_stdout

import pytest
from tiny_campaign import run

from boresight import campaign
from boresight.campaign.cli import report as printed
from boresight.campaign.store import RunFolder
from boresight.scenarios.errors import BoresightError


def reported(file, folder):
    """Run a campaign that is finished; return what is printed of its report."""
    out = io.StringIO()
    with redirect_stdout(out):
        assert run(file, folder, "--worst", 0) == 0
    return out.getvalue().partition("24 of 24 trials")[2]


@pytest.fixture(scope="module")
def first(tiny_run, tmp_path_factory):
    """A finished run with its report, and what was printed of that."""
    folder = tmp_path_factory.mktemp("reported") / "run"
    shutil.copytree(tiny_run.folder, folder, ignore=shutil.ignore_patterns("report"))
    return folder, reported(tiny_run.file, folder)


def test_the_same_command_leaves_the_report_and_prints_its_tables(tiny_run, first):
    folder, said = first
    before = {path: path.stat().st_mtime_ns for path in (folder / "report").rglob("*")}
    assert reported(tiny_run.file, folder) == said
    assert "landmark-harris" in said
    assert {path: path.stat().st_mtime_ns for path in (folder / "report").rglob("*")} == before


@pytest.mark.parametrize("change", ["deleted", "changed", "record", "other source"])
def test_a_report_that_is_not_as_it_was_is_made_again(first, tmp_path, change):
    folder = RunFolder(tmp_path / "run")
    shutil.copytree(first[0], folder.path)
    source = printed.source_of(folder, 0, False)
    assert printed.printed_before(folder, source) is not None
    table, record = (folder.path / "report" / name for name in ("table.csv", "made.json"))
    if change == "deleted":
        table.unlink()
    elif change == "changed":
        table.write_text(table.read_text() + "\n")
    elif change == "record":
        record.write_text('{"source": 3}')
    assert printed.printed_before(folder, source + "x" * (change == "other source")) is None


def test_a_damaged_table_is_refused_beside_a_report_that_is_as_it_was(first, tmp_path):
    folder = RunFolder(tmp_path / "run")
    shutil.copytree(first[0], folder.path)
    rows = next((folder.path / "rows").glob("*.parquet"))
    rows.write_bytes(rows.read_bytes()[:-1])
    with pytest.raises(BoresightError, match="damaged"):
        printed.printed_before(folder, printed.source_of(folder, 0, False))


def test_rows_options_manifest_and_code_decide(first, tmp_path, monkeypatch):
    folder = RunFolder(tmp_path / "run")
    shutil.copytree(first[0], folder.path)
    code = tmp_path / "code"
    for name in printed._PACKAGES:
        (code / name).mkdir(parents=True)
    monkeypatch.setattr(campaign, "__file__", str(code / "campaign" / "__init__.py"))
    sources = [
        printed.source_of(folder, 0, False),
        printed.source_of(folder, 0, False),
        printed.source_of(folder, 2, False),
        printed.source_of(folder, 0, True),
    ]
    (code / "reports" / "page.html").write_text("<p>")
    sources.append(printed.source_of(folder, 0, False))
    manifest = folder.read_manifest()
    folder.write_manifest({**manifest, "start": 1000, "finished": "2030-01-01"})
    sources.append(printed.source_of(folder, 0, False))
    folder.write_manifest({**manifest, "title": "Another"})
    sources.append(printed.source_of(folder, 0, False))
    sums = next((folder.path / "checksums").glob("*.sha256"))
    sums.write_text(sums.read_text().replace("0", "1", 1))
    sources.append(printed.source_of(folder, 0, False))
    assert sources[0] == sources[1]
    assert sources[4] == sources[5]
    assert len(set(sources)) == 6

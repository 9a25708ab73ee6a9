"""A report that would be the same is not made again; any other is."""

from __future__ import annotations

import shutil

import pytest
from tiny_campaign import run

import campaign
from campaign.cli import printed
from campaign.store import RunFolder


@pytest.fixture(scope="module")
def reported(tiny_run, tmp_path_factory):
    """A finished run with its report; tests work on copies."""
    folder = tmp_path_factory.mktemp("reported") / "run"
    shutil.copytree(tiny_run.folder, folder)
    assert run(tiny_run.file, folder, "--worst", 0) == 0
    return folder


@pytest.fixture
def mine(reported):
    """The run itself, at the path that its command names, with its report as it was."""
    kept = reported.with_name("kept")
    shutil.copytree(reported, kept)
    yield reported
    shutil.rmtree(reported)
    kept.rename(reported)


def written(folder):
    """Return when each file of the report was written, but for what was printed."""
    return {path: path.stat().st_mtime_ns for path in (folder / "report").rglob("*") if path.is_file()}


def again(tiny_run, folder, capsys, worst=0):
    """Run the command again; return the files of the report that are new, and what was printed of the report."""
    before = written(folder)
    capsys.readouterr()
    assert run(tiny_run.file, folder, "--worst", worst) == 0
    said = capsys.readouterr().out
    assert said.rstrip().endswith("report.html")
    after = written(folder)
    return {path.name for path in after if after[path] != before.get(path)}, said


def test_the_same_command_leaves_the_report_and_prints_its_tables(tiny_run, mine, capsys):
    (mine / "report" / "made.json").unlink()
    new, first = again(tiny_run, mine, capsys)
    assert {"report.html", "report.md", "table.csv", "made.json"} <= new
    new, second = again(tiny_run, mine, capsys)
    assert new == set()
    assert "landmark-harris" in second
    tables = [text[text.index("stored already") if "stored already" in text else 0 :] for text in (first, second)]
    assert tables[0] == tables[1]


@pytest.mark.parametrize("change", ["deleted", "changed", "another option", "damaged record"])
def test_a_report_that_is_not_as_it_was_is_made_again(tiny_run, mine, capsys, change):
    page = mine / "report" / "table.csv"
    if change == "deleted":
        page.unlink()
    elif change == "changed":
        page.write_text(page.read_text() + "\n")
    elif change == "damaged record":
        (mine / "report" / "made.json").write_text('{"source": 3}')
    new, _ = again(tiny_run, mine, capsys, worst=1 if change == "another option" else 0)
    assert {"report.html", "table.csv", "made.json"} <= new
    assert not page.read_text().endswith("\n\n")


def test_rows_options_manifest_and_code_decide(reported, tmp_path, monkeypatch):
    folder = RunFolder(tmp_path / "run")
    shutil.copytree(reported, folder.path)
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

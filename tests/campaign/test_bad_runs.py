"""A run that is not whole, or another version's, for every command that takes a run: one line, exit code 2, no file."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest
from stored_runs import seal

from boresight.campaign.cli import main
from boresight.campaign.papers.page import finished_runs, gather_runs
from boresight.campaign.store import run_folders

COMMANDS = {
    "compare": ("compare", "RUN", "--out", "OUT"),
    "inspect a trial": ("inspect", "RUN", "--trial", "0", "--out", "OUT"),
    "inspect the worst": ("inspect", "RUN", "--worst", "1", "--out", "OUT"),
    "look": ("inspect", "RUN", "--look", "--out", "OUT"),
    "report": ("report", "RUN"),
    **{f"export {kind}": ("export", "RUN", "--to", kind, "--out", "OUT") for kind in ("tum", "colmap", "csv", "latex")},
}
MANIFEST = "manifest.json: not readable as a manifest ("
AGAIN = "run the campaign again, into another folder (--out)"


def rewritten(**changes: object) -> Callable[[Path], None]:
    """Replace entries of a manifest; None takes one away."""

    def damage(run: Path) -> None:
        manifest = json.loads((run / "manifest.json").read_text()) | changes
        kept = {key: value for key, value in manifest.items() if value is not None}
        (run / "manifest.json").write_text(json.dumps(kept))

    return damage


def cut(name: str, checked: bool) -> Callable[[Path], None]:
    """Leave half of a table's file, and its checksum or none."""

    def damage(run: Path) -> None:
        block = next((run / name).glob("*.parquet"))
        block.write_bytes(block.read_bytes()[: block.stat().st_size // 2])
        if not checked:
            seal(run)

    return damage


def older_columns(run: Path) -> None:
    for block in (run / "rows").glob("*.parquet"):
        pd.read_parquet(block).drop(columns="prior_position_error_m").to_parquet(block)
    seal(run)


def half_manifest(run: Path) -> None:
    text = (run / "manifest.json").read_text()
    (run / "manifest.json").write_text(text[: len(text) // 2])


# name: (what is done to a run, what the line must say, whether a manifest alone tells it)
DAMAGES = {
    "no manifest": (lambda run: (run / "manifest.json").unlink(), ["no run there", "run it first"], True),
    "half a manifest": (half_manifest, [MANIFEST, AGAIN], True),
    "a binary manifest": (lambda run: (run / "manifest.json").write_bytes(b"\x80\x81"), [MANIFEST, AGAIN], True),
    "no seed": (rewritten(seed=None), ["not a manifest of boresight, which has a seed"], True),
    "an older format": (rewritten(format=1), ["run: stored in format 1, and this version of", "reads 3", AGAIN], True),
    "no format": (rewritten(format=None), ["stored in format unknown", AGAIN], True),
    "no rows": (lambda run: shutil.rmtree(run / "rows"), ["no finished trial is stored; continue the run"], False),
    "half the rows": (cut("rows", checked=True), ["/rows/scene-00000", ".parquet: damaged", "run the campaign"], True),
    "half the rows, unchecked": (cut("rows", checked=False), ["rows: not readable as a stored table", AGAIN], True),
    "no checksums": (lambda run: shutil.rmtree(run / "checksums"), ["/checksums/scene", "damaged, missing"], True),
    "half a table": (cut("stages", checked=True), ["/stages/scene-00000", ".parquet: damaged", "again"], False),
    "half a table, unchecked": (
        cut("stages", checked=False), ["stages: not readable as a stored table", AGAIN], False,
    ),
    "older columns": (older_columns, ["prior_position_error_m are missing", AGAIN], False),
}  # fmt: skip


@pytest.mark.parametrize("fault", DAMAGES)
def test_every_command_refuses_a_run_that_is_not_whole(tiny_run, tmp_path, monkeypatch, capsys, fault):
    monkeypatch.chdir(tmp_path)
    run, out = tmp_path / "run", tmp_path / "out"
    shutil.copytree(tiny_run.folder, run)
    shutil.rmtree(run / "report", ignore_errors=True)
    damage, expected, for_status = DAMAGES[fault]
    damage(run)
    before = sorted(tmp_path.rglob("*"))
    commands = COMMANDS | ({"status": ("status", "RUN")} if for_status else {})
    for name, words in commands.items():
        assert main([word.replace("RUN", str(run)).replace("OUT", str(out)) for word in words]) == 2, name
        said = capsys.readouterr()
        assert said.err.startswith("boresight: "), name
        assert said.err.count("\n") == 1, f"{name}: {said.err}"
        assert all(part in said.err for part in expected), f"{name}: {said.err}"
        assert len(said.err) < 500, f"{name}: {said.err}"
        assert said.out == "", f"{name}: {said.out}"
    assert sorted(tmp_path.rglob("*")) == before


def test_a_figure_is_not_drawn_of_what_another_version_stored(tiny_run, tmp_path):
    for number in (1, 2):
        shutil.copytree(tiny_run.folder, tmp_path / "runs" / f"tiny-{number}")
    rewritten(format=1, start=99)(tmp_path / "runs" / "tiny-1")
    folders = run_folders(tmp_path / "runs")
    assert finished_runs(folders, "tiny")[0][0].folder.path.name == "tiny-2"
    cut("rows", checked=False)(tmp_path / "runs" / "tiny-2")
    gathered = gather_runs(folders, ["tiny"])
    assert gathered.found == {}
    older, unread = gathered.refused
    assert "tiny-1: stored in format 1" in older
    assert "tiny-2/rows: not readable as a stored table" in unread


def test_a_run_goes_on_in_no_folder_of_another_format(tiny_run, tmp_path, refused):
    shutil.copytree(tiny_run.folder, tmp_path / "run")
    rewritten(format=1)(tmp_path / "run")
    before = sorted((path, path.stat().st_mtime_ns) for path in (tmp_path / "run").rglob("*.parquet"))
    assert "stored in format 1" in refused("run", tiny_run.file, "--out", tmp_path / "run")
    assert sorted((path, path.stat().st_mtime_ns) for path in (tmp_path / "run").rglob("*.parquet")) == before

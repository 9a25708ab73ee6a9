"""The run folder: whole blocks or none, one process at a time, faults in one clear line."""

from __future__ import annotations

import itertools
import resource
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest

from boresight.campaign.store import Block, BlockState, RunFolder, blocks, run_lock
from boresight.campaign.trial.score import pose_error
from boresight.reports.schema.tables import TABLES, columns_of, schema
from boresight.scenarios.atomic import write_text
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import look_at

ERROR_KEYS = ("attitude_error_deg", *(f"position_error_{axis}m" for axis in ("", "x_", "y_", "z_")))


def record(trial: int, estimator: str = "prior") -> dict[str, object]:
    errors = {name: float(trial) for name in ERROR_KEYS}
    return {
        "trial": trial, "scenario": "a", "estimator": estimator, "status": "ok", "reason": "",
        **errors, **{f"prior_{name}": value for name, value in errors.items()},
        "n_landmarks": 5, "image": "", "range_m": 2000.0, "phase_deg": 30.0,
    }  # fmt: skip


def test_blocks_cover_every_trial_once():
    found = list(blocks(["a", "b"], 25, 10))
    for scenario in "ab":
        mine = [b for b in found if b.scenario == scenario]
        assert [t for b in mine for t in range(b.first, b.last)] == list(range(25))
        assert [b.number for b in mine] == [0, 1, 2]


def test_scenarios_take_turns_in_rounds():
    """A change of scenario opens another world: it must be rare beside the blocks, and no scenario must wait long."""
    found = [b.scenario for b in blocks(["a", "b", "c"], 2000, 10)]
    changes = sum(before != after for before, after in itertools.pairwise(found))
    assert len(found) == 600
    assert changes == 3 * 4 - 1
    assert found.index("c") == 100


def test_a_stored_block_reads_back_in_the_order_of_trials(tmp_path):
    folder = RunFolder(tmp_path)
    for block in reversed(list(blocks(["a"], 25, 10))):
        folder.write_block(block, {"rows": [record(t) for t in range(block.first, block.last)]}, "single-image")
    rows = pd.read_parquet(tmp_path / "rows")
    assert rows["trial"].tolist() == list(range(25))
    assert list(rows.columns) == [c.name for c in columns_of("rows", "single-image")]


def test_details_are_written_first_then_checksums_and_rows_last(tmp_path, monkeypatch):
    written, write = [], RunFolder._write

    def noted(self, name, content):
        written.append(name.partition("/")[0])
        write(self, name, content)

    monkeypatch.setattr(RunFolder, "_write", noted)
    seconds = [{"trial": 0, "scenario": "a", "estimator": "prior", "stage": "image", "seconds": 1.0}]
    RunFolder(tmp_path).write_block(Block("a", 0, 1, 0), {"rows": [record(0)], "timings": seconds}, "single-image")
    assert written == ["timings", "checksums", "rows"]


def test_a_block_that_is_redone_keeps_no_table_that_it_no_longer_has(tmp_path):
    folder, block, rows = RunFolder(tmp_path), Block("a", 0, 2, 0), [record(0), record(1)]
    seconds = [{"trial": 0, "scenario": "a", "estimator": "prior", "stage": "image", "seconds": 1.0}]
    folder.write_block(block, {"rows": rows, "timings": seconds}, "single-image")
    assert len(folder.table("timings")) == 1
    folder.write_block(block, {"rows": rows, "timings": []}, "single-image")
    assert len(folder.table("timings")) == 0
    assert folder.state(block, 1) is BlockState.WHOLE


def test_a_trial_is_found_in_the_one_file_that_holds_it(tmp_path):
    folder, methods = RunFolder(tmp_path), ("prior", "other")
    for block in blocks(["a", "a-0000001"], 35, 10):
        rows = [record(t, m) | {"scenario": block.scenario} for t in range(block.first, block.last) for m in methods]
        folder.write_block(block, {"rows": rows}, "single-image")
    (tmp_path / "rows" / "a-0000001.parquet").unlink()  # a detail table has no file where a block has nothing for it
    for scenario in ("a", "a-0000001"):
        for trial in range(36):
            found = folder.of_trial("rows", scenario, "other", trial).to_pylist()
            there = trial < 35 and (scenario != "a" or not 10 <= trial < 20)
            assert [(r["scenario"], r["trial"], r["estimator"]) for r in found] == [(scenario, trial, "other")] * there
    (tmp_path / "rows" / "a-0000000.parquet").write_bytes(b"")
    with pytest.raises(BoresightError, match=r"a-0000000\.parquet"):
        folder.of_trial("rows", "a", "prior", 3)


def test_a_block_is_whole_only_when_its_rows_are(tmp_path):
    folder, block = RunFolder(tmp_path), Block("a", 0, 10, 0)
    assert folder.state(block, 1) is BlockState.ABSENT
    folder.write_block(Block("a", 0, 5, 0), {"rows": [record(t) for t in range(5)]}, "single-image")
    assert folder.state(block, 1) is BlockState.SHORT
    assert folder.state(Block("a", 0, 5, 0), 1) is BlockState.WHOLE
    folder.write_block(block, {"rows": [record(t) for t in range(10)]}, "single-image")
    assert folder.state(block, 1) is BlockState.WHOLE
    assert folder.state(Block("a", 0, 5, 0), 1) is BlockState.WHOLE, "more trials than asked for are kept"


@pytest.fixture
def stored(tmp_path):
    """A block with rows and details."""
    folder, block = RunFolder(tmp_path), Block("a", 0, 10, 0)
    key = {"scenario": "a", "estimator": "prior"}
    timings = [{"trial": t, **key, "stage": "image", "seconds": 0.1} for t in range(10)]
    rows = [record(t) for t in range(10)]
    folder.write_block(block, {"rows": rows, "timings": timings, "stages": []}, "single-image")
    return folder, block


def test_a_flipped_bit_or_a_missing_end_is_found_wherever_it_is(stored):
    folder, block = stored
    rng = np.random.default_rng(8)
    for name in ("rows/a-0000000.parquet", "timings/a-0000000.parquet", "checksums/a-0000000.sha256"):
        path = folder.path / name
        whole = path.read_bytes()
        for at in (0, len(whole) - 1, *rng.integers(len(whole), size=20)):
            damaged = bytearray(whole)
            damaged[at] ^= 1 << int(rng.integers(8))
            path.write_bytes(damaged)
            assert folder.state(block, 1) is BlockState.DAMAGED, f"{name}, byte {at} of {len(whole)}"
            path.write_bytes(whole[:at])
            assert folder.state(block, 1) is BlockState.DAMAGED, f"{name}, cut after {at} of {len(whole)}"
        path.write_bytes(whole)
        assert folder.state(block, 1) is BlockState.WHOLE
    (folder.path / "timings" / block.file_name).unlink()
    assert folder.state(block, 1) is BlockState.DAMAGED


def test_a_damaged_table_is_not_read(stored):
    folder, block = stored
    path = folder.path / "timings" / block.file_name
    path.write_bytes(path.read_bytes()[:-7])
    assert len(folder.table("rows")) == 10
    with pytest.raises(BoresightError, match=r"timings/a-0000000.parquet: damaged.* run\sthe campaign again") as caught:
        folder.table("timings")
    assert "\n" not in str(caught.value)


def test_checksums_are_those_of_another_program(stored):
    folder, _ = stored
    checked = subprocess.run(
        ["sha256sum", "--strict", "-c", "checksums/a-0000000.sha256"], cwd=folder.path, capture_output=True, check=False
    )
    assert checked.returncode == 0, checked.stderr
    assert checked.stdout.count(b": OK") == 2


@pytest.mark.parametrize("table", ["rows", "timings", None])
def test_a_block_without_all_of_its_checksums_is_damaged(stored, table):
    folder, block = stored
    sums = folder.path / "checksums" / block.checksums_name
    if table is None:
        sums.unlink()
    else:
        lines = sums.read_text().splitlines(keepends=True)
        sums.write_text("".join(line for line in lines if f"{table}/" not in line))
        (folder.path / table / block.file_name).write_bytes((folder.path / "rows" / block.file_name).read_bytes())
    assert folder.state(block, 1) is BlockState.DAMAGED
    for read in (lambda: folder.table("rows"), lambda: folder.table("timings")):
        with pytest.raises(BoresightError, match=r"checksums/a-0000000.sha256: damaged, missing.* run the campaign"):
            read()


def test_half_of_a_block_that_was_never_finished_is_no_damage(stored):
    folder, block = stored
    (folder.path / "rows" / block.file_name).unlink()
    assert folder.state(block, 1) is BlockState.ABSENT
    assert folder.table("rows").empty
    assert len(folder.table("timings")) == 10


def test_missing_values_are_nan_and_not_infinite(tmp_path):
    folder, block = RunFolder(tmp_path), Block("a", 0, 1, 0)
    folder.write_block(
        block,
        {
            "rows": [
                {**{k: v for k, v in record(0).items() if k not in ERROR_KEYS}, "status": "failed", "reason": "dark"}
            ]
        },
        "single-image",
    )
    row = folder.table("rows").iloc[0]
    assert np.isnan(row["position_error_m"])
    assert row["reason"] == "dark"


def test_every_column_says_what_it_means():
    for name, columns in TABLES.items():
        assert [f.metadata[b"meaning"].decode() for f in schema(name)] == [c.meaning for c in columns]
        assert all(c.meaning for c in columns)


def test_an_empty_table_has_its_columns(tmp_path):
    assert RunFolder(tmp_path).table("landmarks").columns.tolist() == [c.name for c in TABLES["landmarks"]]


def test_a_second_process_is_refused(tmp_path):
    code = f"""
import sys
from pathlib import Path
from boresight.campaign.store import run_lock
from boresight.scenarios.errors import BoresightError
try:
    run_lock(Path({str(tmp_path)!r})).__enter__()
except BoresightError as error:
    print(error); sys.exit(7)
"""
    with run_lock(tmp_path):
        held = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    free = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert held.returncode == 7
    assert "another boresight process" in held.stdout
    assert free.returncode == 0


def test_a_full_disk_leaves_nothing_half_written(tmp_path):
    # The limit on a file's size stands for the full disk: both end in an OSError in the middle of a write.
    code = f"""
import itertools
import resource, signal, sys
from pathlib import Path
from boresight.scenarios.atomic import write_text
from boresight.scenarios.errors import BoresightError
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
try:
    write_text(Path({str(tmp_path)!r}) / "big.txt", "x" * 5000)
except BoresightError as error:
    sys.stderr.write(str(error)); sys.exit(7)
"""
    write_text(tmp_path / "big.txt", "before")
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert result.returncode == 7
    assert "big.txt: could not be written: the file size limit" in result.stderr
    assert (tmp_path / "big.txt").read_text() == "before"
    assert [p.name for p in tmp_path.iterdir()] == ["big.txt"]
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] != 1000


def test_a_part_of_the_path_that_is_a_file(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(BoresightError, match="part of that path is a file: choose another folder with --out"):
        write_text(tmp_path / "file" / "rows.txt", "y")
    with pytest.raises(BoresightError, match="--out"), run_lock(tmp_path / "file" / "run"):
        pass


def test_a_foreign_manifest_is_refused(tmp_path):
    folder = RunFolder(tmp_path)
    assert folder.read_manifest() is None
    for text in ("{", "[]", '{"name": "x"}'):
        (folder.path / "manifest.json").write_text(text)
        with pytest.raises(BoresightError, match="manifest"):
            folder.read_manifest()


def test_pose_error_by_hand():
    true = look_at(np.array([2000.0, 0, 0]))
    # 2 deg about the camera's y axis swings the camera by 2000 m x 2 sin(1 deg) about the body.
    turned = true.perturbed(np.array([0, np.radians(2), 0]), np.zeros(3))
    error = pose_error(turned, true)
    assert error["attitude_error_deg"] == pytest.approx(2.0)
    assert error["position_error_m"] == pytest.approx(4000 * np.sin(np.radians(1)))
    shifted = pose_error(true.perturbed(np.zeros(3), np.array([3.0, -4.0, 12.0])), true)
    assert shifted["position_error_m"] == pytest.approx(13.0)
    # The body moved by +3 in the camera's x: the camera moved by -3 along its own x in the body.
    assert [shifted[f"position_error_{axis}_m"] for axis in "xyz"] == pytest.approx([-3.0, 4.0, -12.0])

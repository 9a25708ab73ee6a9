"""Processor time of the tests by folder: what is added up, and when a folder is reported."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from folder_times import read_times, table

ROOT = Path(__file__).parents[1]


def test_a_folder_is_reported_that_takes_half_as_much_again():
    seconds = {"tests/a": 3.2, "tests/b": 2.9, "tests/c": 5.0}
    lines = table(seconds, 0.1, {"tests/a": 20, "tests/b": 20, "all": 80}).splitlines()
    told = {line.split()[0]: line.split()[2:] for line in lines[1:-1]}
    assert told["tests/a"] == ["32", "20", "WARNING:", "1.6", "times", "as", "much"]
    assert told["tests/b"] == ["29", "20"]
    assert told["tests/c"] == ["50", "new"]
    assert told["all"] == ["111", "80"]
    assert lines[-1] == "one yardstick: 0.100 s"


def test_a_folder_without_times_is_one_line(tmp_path):
    with pytest.raises(SystemExit, match=r"no times of tests: run them with BORESIGHT_TEST_TIMES="):
        read_times(tmp_path)


def test_tests_write_their_times_and_those_of_their_processes(tmp_path):
    """A test in a tree of its own with the conftest of all: its child counts, and a yardstick before and after."""
    burn = "import time\nwhile time.process_time() < 0.4: pass"
    folder = tmp_path / "tests" / "burning"
    folder.mkdir(parents=True)
    (tmp_path / "tests" / "conftest.py").write_bytes((ROOT / "tests" / "conftest.py").read_bytes())
    (folder / "test_burn.py").write_text(
        "import os, subprocess, sys\n\ndef test_burn():\n"
        f"    subprocess.run([sys.executable, '-c', {burn!r}], check=True)\n"
        "    assert 'BORESIGHT_TEST_TIMES' not in os.environ\n"
    )
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = data\n")
    times = tmp_path / "times"
    times.mkdir()
    places = os.pathsep.join([str(ROOT), str(ROOT / "tests" / "helpers"), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-n", "1", "tests"], cwd=tmp_path, capture_output=True, text=True,
        check=False, env={**os.environ, "PYTHONPATH": places, "BORESIGHT_TEST_TIMES": str(times)},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
    (file,) = times.iterdir()
    assert [json.loads(line)[0] for line in file.read_text().splitlines()].count("yardstick") == 2
    seconds, yardstick_s = read_times(times)
    assert 0.4 <= seconds["tests/burning"] < 2.4
    assert set(seconds) == {"tests/burning", "collecting"}
    assert 0.01 < yardstick_s < 5.0

"""Hostile input for every reader: no traceback, no hang, no flood of memory, and complaints in printable lines."""

from __future__ import annotations

import os
import subprocess
import sys
import traceback
from collections.abc import Iterable
from pathlib import Path

import pytest
from fuzz.guard import LIMIT_BYTES, TooMuchError, TooSlowError, fed
from fuzz.mutations import drawn
from fuzz.readers import READERS, SEEDS, found, valid

from boresight.scenarios.errors import BoresightError

ROOT = Path(__file__).parents[2]
OURS = ("/scenarios/", "/renderers/", "/estimators/", "/reports/", "/campaign/")
FEW, MANY = 100, 10_000


def faults(name: str, contents: Iterable[bytes], folder: Path) -> dict[str, bytes]:
    """Feed a reader; return the shortest input of each fault, by its kind and the innermost line of boresight."""
    shortest: dict[str, bytes] = {}
    for content in contents:
        try:
            fed(READERS[name].read, content, folder)
        except BaseException as error:
            if isinstance(error, KeyboardInterrupt):
                raise
            ours = [f for f in traceback.extract_tb(error.__traceback__) if any(part in f.filename for part in OURS)]
            place = f"{Path(ours[-1].filename).name}:{ours[-1].lineno}" if ours else "?"
            kind = f"{type(error).__name__} at {place}"
            if len(content) < len(shortest.get(kind, content + b" ")):
                shortest[kind] = content
    return shortest


def test_seeds_belong_to_a_reader():
    assert {folder.name for folder in SEEDS.iterdir()} <= set(READERS)


@pytest.mark.parametrize("name", READERS)
def test_valid_files_are_read(tmp_path, name):
    assert valid(name)
    for content in valid(name):
        assert fed(READERS[name].read, content, tmp_path) is None


@pytest.mark.parametrize("name", READERS)
def test_what_once_broke_a_reader_and_damaged_files_give_a_value_or_lines(tmp_path, name):
    reader = READERS[name]
    damaged = drawn(valid(name), reader.words, FEW // reader.cost, 2003)
    assert faults(name, (*found(name), *damaged), tmp_path) == {}


@pytest.mark.long
@pytest.mark.parametrize("name", READERS)
def test_very_many_damaged_files_give_a_value_or_lines(tmp_path, name):
    assert faults(name, drawn(valid(name), READERS[name].words, MANY, 2004), tmp_path) == {}


def python(*words: object) -> subprocess.CompletedProcess[str]:
    """Run Python with what is here to be imported."""
    places = os.pathsep.join([str(ROOT), str(ROOT / "tests"), os.environ.get("PYTHONPATH", "")])
    return subprocess.run(
        [sys.executable, *map(str, words)],
        capture_output=True, text=True, errors="replace", check=False, env={**os.environ, "PYTHONPATH": places},
    )  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("name", READERS)
def test_inputs_that_follow_the_code_give_a_value_or_lines(tmp_path, name):
    """Atheris: edits that reach new lines of ours and of the parsers in Python are edited further."""
    pytest.importorskip("atheris", reason='atheris is absent: pip install -e ".[fuzz]"')
    done = python("-m", "fuzz.atheris_run", name, tmp_path, MANY)
    assert done.returncode == 0, done.stdout + done.stderr[-3000:]


HARMFUL = {
    "code": (lambda: 1 // 0, ZeroDivisionError),
    "loop": (lambda: all(True for _ in iter(int, 1)), TooSlowError),
    "flood": (lambda: bytearray(b"x") * (LIMIT_BYTES + (LIMIT_BYTES >> 1)), TooMuchError),
}


@pytest.mark.long
@pytest.mark.parametrize("harm", HARMFUL)
def test_the_guard_sees_what_a_reader_must_not_do(tmp_path, harm):
    """A guard that sees nothing would let every reader pass."""
    act, raised = HARMFUL[harm]
    for _ in range(2):  # what one input took hides nothing that the next one takes
        with pytest.raises(raised):
            fed(lambda *_: act(), b"", tmp_path)


def test_a_complaint_steers_no_terminal(tmp_path):
    def refuse(*_):
        raise BoresightError("\x1b[31mred")

    assert str(fed(refuse, b"", tmp_path)) == "\\x1b[31mred"


def test_who_waits_for_ever_is_ended():
    waiting = (
        "import threading; from pathlib import Path; from fuzz import guard; guard.LONGEST_WAIT_S = 0.5;"
        "guard.fed(lambda *_: threading.Event().wait(), b'', Path())"
    )
    done = python("-c", waiting)
    assert done.returncode != 0
    assert "Timeout" in done.stderr

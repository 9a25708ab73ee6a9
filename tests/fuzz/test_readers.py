"""Hostile input for every reader: no traceback, no hang, no flood of memory, and complaints in printable lines.

``python -m hostile.survey`` (with ``PYTHONPATH=tests/helpers``) lists all that goes wrong in one of them at once.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from hostile.found import FOUND
from hostile.guard import LIMIT_BYTES, TooMuchError, TooSlowError, fed
from hostile.mutations import drawn, mutated
from hostile.target import Target
from hostile.targets import TARGETS
from hypothesis import HealthCheck, Phase, example, given, seed, settings

from boresight.scenarios.errors import BoresightError

# Inputs are files: told of in full where they are the fault, however long.
pytestmark = pytest.mark.filterwarnings("ignore:Generating overly large repr")

ROOT = Path(__file__).parents[2]
FEW, MANY = 200, 10_000
_SHOWN = 2000


def fuzz(name: str, inputs: int, folder: Path) -> None:
    """Feed a reader what once broke it, then damaged files as hypothesis draws them; the same ones each time."""

    def feed(content: bytes) -> None:
        fed(TARGETS[name], content, folder)

    trial = given(mutated(TARGETS[name]))(feed)
    for content in FOUND.get(name, ()):
        trial = example(content)(trial)
    checks = settings(
        max_examples=inputs,
        deadline=None,
        database=None,
        phases=[Phase.explicit, Phase.generate, Phase.shrink],
        suppress_health_check=list(HealthCheck),
    )
    checks(seed(2003)(trial))()


def python(*words: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run Python with what is here to be imported."""
    places = os.pathsep.join([str(ROOT), str(ROOT / "tests" / "helpers"), os.environ.get("PYTHONPATH", "")])
    return subprocess.run(
        [sys.executable, *map(str, words)],
        capture_output=True, text=True, errors="replace", check=False, cwd=cwd,
        env={**os.environ, "PYTHONPATH": places},
    )  # fmt: skip


def test_what_is_found_belongs_to_a_reader():
    assert set(FOUND) <= set(TARGETS)


@pytest.mark.parametrize("name", TARGETS)
def test_valid_files_are_read(tmp_path, name):
    for content in TARGETS[name].seeds():
        assert fed(TARGETS[name], content, tmp_path) is None


@pytest.mark.parametrize("name", TARGETS)
def test_damaged_files_give_a_value_or_lines(tmp_path, name):
    target = TARGETS[name]
    for content in (*FOUND.get(name, ()), *drawn(target, FEW // target.cost, 2003)):
        try:
            fed(target, content, tmp_path)
        except BaseException as error:
            error.add_note(f"read: {content[:_SHOWN]!r}")
            raise


@pytest.mark.long
@pytest.mark.parametrize("name", TARGETS)
def test_very_many_damaged_files_give_a_value_or_lines(tmp_path, name):
    fuzz(name, MANY, tmp_path)


@pytest.mark.long
def test_inputs_that_follow_the_code_give_a_value_or_lines(tmp_path):
    """Atheris: edits that reach new lines of ours and of the parsers in Python are edited further."""
    pytest.importorskip("atheris", reason='atheris is absent: pip install -e ".[fuzz]"')
    done = python("-m", "hostile.atheris_run", "--runs", MANY, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr[-3000:]
    assert [line.partition(":")[0] for line in done.stdout.splitlines()] == list(TARGETS)


HARMFUL = {
    "code": (lambda: 1 // 0, ZeroDivisionError),
    "loop": (lambda: all(True for _ in iter(int, 1)), TooSlowError),
    "flood": (lambda: bytearray(b"x") * (LIMIT_BYTES + (LIMIT_BYTES >> 1)), TooMuchError),
    "terminal": (lambda: refuse("\x1b[31mred"), None),
}


def refuse(text: str) -> None:
    raise BoresightError(text)


@pytest.mark.long
@pytest.mark.parametrize("harm", HARMFUL)
def test_the_guard_sees_what_a_reader_must_not_do(tmp_path, harm):
    """A guard that sees nothing would let every reader pass."""
    act, raised = HARMFUL[harm]
    target = Target(lambda _content, _folder: act(), lambda: (b"",))
    if raised is None:
        assert str(fed(target, b"", tmp_path)) == "\\x1b[31mred"
        return
    for _ in range(2):  # what one input took hides nothing that the next one takes
        with pytest.raises(raised):
            fed(target, b"", tmp_path)


def test_who_waits_for_ever_is_ended():
    waiting = (
        "import threading; from pathlib import Path; from hostile import guard; from hostile.target import Target;"
        "guard.LONGEST_WAIT_S = 0.5;"
        "guard.fed(Target(lambda *_: threading.Event().wait(), lambda: (b'',)), b'', Path())"
    )
    done = python("-c", waiting)
    assert done.returncode != 0
    assert "Timeout" in done.stderr

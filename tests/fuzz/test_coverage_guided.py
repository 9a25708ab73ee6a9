"""Hostile input that follows the coverage of the code; a file of its own, so that it runs beside test_readers.py."""

import pytest
from hostile.process import python
from hostile.targets import TARGETS

RUNS = 10_000


@pytest.mark.long
def test_inputs_that_follow_the_code_give_a_value_or_lines(tmp_path):
    """Atheris: edits that reach new lines of ours and of the parsers in Python are edited further."""
    pytest.importorskip("atheris", reason="atheris is absent: pip install 'boresight[fuzz]'")
    done = python("-m", "hostile.atheris_run", "--runs", RUNS, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr[-3000:]
    assert [line.partition(":")[0] for line in done.stdout.splitlines()] == list(TARGETS)

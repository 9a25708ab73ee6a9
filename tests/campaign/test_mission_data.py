"""Mission data reach the tests alone that say that they read them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from mission_data import data_file, needs_data

from boresight.scenarios.data import find_data_file
from boresight.scenarios.errors import BoresightError

ROOT = Path(__file__).parents[2]
SHAPE = "shapes/apophis_lightcurve.obj"


def test_an_unmarked_test_does_not_see_the_data_folder():
    with pytest.raises(pytest.fail.Exception, match="mark the test with needs_data"):
        data_file(SHAPE)
    with pytest.raises(BoresightError, match="not found"):
        find_data_file(SHAPE, (), "shapes", "body.shape")


@needs_data(SHAPE)
def test_a_marked_test_sees_it():
    assert data_file(SHAPE).is_file()


@pytest.mark.parametrize(
    ("body", "outcome"),
    [
        (
            'import os\nif os.environ["BORESIGHT_DATA"]: pytest.skip("set BORESIGHT_DATA")',
            "1 failed",
        ),
        ('pytest.skip("no LaTeX")', "1 skipped"),
        ("from mission_data import skip_without\n    skip_without('no/such/file')", "1 failed"),
    ],
)
def test_a_test_that_skips_for_lack_of_data_without_the_marker_fails(tmp_path, body, outcome):
    lines = body.replace("\n", "\n    ") if "\n    " not in body else body
    (tmp_path / "test_it.py").write_text(f"import pytest\ndef test_it():\n    {lines}\n")
    (tmp_path / "conftest.py").write_text((ROOT / "tests" / "conftest.py").read_text())
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests" / "helpers")])}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", os.devnull, str(tmp_path)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert outcome in done.stdout

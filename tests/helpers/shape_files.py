"""Shapes that are not part of the project."""

import os
from pathlib import Path

import pytest


def shape_file(name):
    """Return the path of a shape below BORESIGHT_DATA, or skip the test by its name."""
    path = Path(os.environ.get("BORESIGHT_DATA", "")) / "shapes" / name
    if "BORESIGHT_DATA" not in os.environ or not path.is_file():
        pytest.skip(f"needs shapes/{name} under BORESIGHT_DATA")
    return path

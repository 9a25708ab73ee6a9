"""Python in a process of its own, which finds what the tests find."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[3]


def python(*words: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run Python with what is here to be imported."""
    places = os.pathsep.join([str(ROOT), str(ROOT / "tests" / "helpers"), os.environ.get("PYTHONPATH", "")])
    return subprocess.run(
        [sys.executable, *map(str, words)],
        capture_output=True, text=True, errors="replace", check=False, cwd=cwd,
        env={**os.environ, "PYTHONPATH": places},
    )  # fmt: skip

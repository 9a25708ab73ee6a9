"""The decorator of the kernels of motion."""

from __future__ import annotations

from pathlib import Path

from scenarios.compiled import compiler

FOLDER = Path(__file__).parent

kernel = compiler(FOLDER)

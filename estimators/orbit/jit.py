"""The decorator of the kernels of orbit determination."""

from __future__ import annotations

from pathlib import Path

from scenarios.compiled import compiler

kernel = compiler(Path(__file__).parent)

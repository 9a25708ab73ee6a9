"""Numba kernels of the windowed adjustment on flat arrays: strict IEEE arithmetic, one thread."""

from __future__ import annotations

from pathlib import Path

from boresight.scenarios.compiled import compiler

kernel, inner = compiler(Path(__file__).parent)

"""Orbital dynamics about a small body: gravity, solar radiation pressure and propagation."""

from pathlib import Path

from boresight.scenarios.compiled import compiler

kernel, inner = compiler(Path(__file__).parent)
"""The decorators of the kernels of this package."""

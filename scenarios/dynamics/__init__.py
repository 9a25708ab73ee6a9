"""Orbital dynamics about a small body: gravity, solar radiation pressure and propagation."""

from pathlib import Path

from boresight.scenarios.compiled import compiler

kernel = compiler(Path(__file__).parent)
"""The decorator of the kernels of this package."""

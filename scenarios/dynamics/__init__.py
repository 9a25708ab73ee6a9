"""What moves a spacecraft about a small body: forces, and motion under them."""

from pathlib import Path

from scenarios.compiled import compiler

kernel = compiler(Path(__file__).parent)
"""The decorator of the kernels of this package."""

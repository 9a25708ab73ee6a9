"""A figure with what is said of it, and the stem of its files."""

from __future__ import annotations

import re
from dataclasses import dataclass

from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True, eq=False)
class NamedFigure:
    """A figure with the stem of its files, its caption and a description for those who cannot see it."""

    stem: str
    figure: Figure
    caption: str
    alt: str


def file_stem(*parts: str) -> str:
    """Make a file name that is valid on every system."""
    return re.sub(r"[^A-Za-z0-9._-]+", "-", "_".join(parts))

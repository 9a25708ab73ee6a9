"""How much a comparison of speeds does."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Settings:
    """How much is done.

    Parameters
    ----------
    rounds
        How often works are done in turn; the least time of each counts.
    facets
        At least so many of the body whose images are timed.
    views
        Images that are timed.
    blender
        The interpreter that has ``bpy``, where it is named.
    """

    rounds: int = 4
    facets: int = 3_100_000
    views: int = 4
    blender: Path | None = None

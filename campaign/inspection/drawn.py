"""What drawing a case gives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from reports.named_figure import NamedFigure


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """Figures of a case, the credits that they carry, and sentences above them."""

    figures: Sequence[NamedFigure]
    credits: Sequence[str] = ()
    notes: Sequence[str] = field(default=())

"""Parts of a detector."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field

NonNegative = Annotated[float, Field(ge=0)]


def _has_area(value: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    left, top, right, bottom = value
    if not (left < right and top < bottom):
        raise ValueError(f"[{left:g}, {top:g}, {right:g}, {bottom:g}] has no area: write [left, top, right, bottom]")
    return value


Rectangle = Annotated[tuple[NonNegative, NonNegative, NonNegative, NonNegative], AfterValidator(_has_area)]

"""Values that a scenario or a method may leave out: so many pixels, a share of the body, or a number by its size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from pydantic import Field
from pydantic.fields import FieldInfo

Sides = tuple[float, float, float]

LEFT_OUT = "left_out"
"""Key of the JSON Schema of a field: what its value follows from."""

_THOMSEN = 1.6075


def length(
    default_m: float,
    description: str,
    *,
    px: float | None = None,
    body: float | None = None,
    gt: float | None = None,
    ge: float | None = None,
) -> Any:
    """Describe a field with a length, m, that follows from the scenario where a file leaves it out.

    It is then ``px`` pixels at the median range of the images, or ``body`` of the longest side of the body's box; of
    both the smaller. Without a scenario, in a model that is made in Python, it is ``default_m``.
    """
    rule = {unit: amount for unit, amount in (("px", px), ("body", body)) if amount is not None}
    extra: dict[str, Any] = {LEFT_OUT: rule}
    words = {"px": "{:g} px at the median range", "body": "{:g} of the body's length"}
    amounts = [words[unit].format(amount) for unit, amount in rule.items()]
    left_out = f"{description}; left out: {' or '.join(amounts)}{', the smaller' if len(amounts) > 1 else ''}"
    return Field(default_m, description=left_out, json_schema_extra=extra, gt=gt, ge=ge)


def number(default: int, description: str, *, each_px2: float, ge: int, le: int) -> Any:
    """Describe a field with a number of features in an image that follows from the scenario where a file leaves it out.

    It is then so many times the default as the body's area in the image has ``each_px2``, rounded; the default at
    least, and where there is no scenario.
    """
    left_out = f"{description}; left out: {default} for each {each_px2:g} px^2 of the body, {default} at least"
    rule: dict[str, Any] = {LEFT_OUT: {"each_px2": each_px2, "most": le}}
    return Field(default, description=left_out, json_schema_extra=rule, ge=ge, le=le)


def rule_of(field: FieldInfo) -> dict[str, float] | None:
    """Return the rule of a value that is left out, by ``px``, ``body`` or both, or by ``each_px2``; else None."""
    extra = field.json_schema_extra
    return cast("dict[str, float] | None", extra.get(LEFT_OUT)) if isinstance(extra, dict) else None


@dataclass(frozen=True, slots=True)
class Scale:
    """Pixel, body and frame of a scenario, by which values are measured; called when a value needs them.

    They return the length across the line of sight that a pixel covers at the median range, the sides of the body's
    box, m, and the area of an image, px^2.
    """

    m_per_px: Callable[[], float | None]
    sides_m: Callable[[], Sides | None]
    frame_px2: Callable[[], float | None]

    def value(self, rule: dict[str, float], default: object) -> float | int | None:
        """Return the value of a rule; None if it is not known, or if it is a number that stays at its default."""
        if "each_px2" not in rule:
            return self.length_m(rule)
        times = max(1, round((self._body_px2() or 0.0) / rule["each_px2"]))
        return min(times * default, int(rule["most"])) if isinstance(default, int) and times > 1 else None

    def _body_px2(self) -> float | None:
        """Return the area of the body in the image, averaged over all directions, px^2; at most that of the image."""
        sides_m, m_per_px, frame_px2 = self.sides_m(), self.m_per_px(), self.frame_px2()
        if sides_m is None or m_per_px is None or frame_px2 is None:
            return None
        # A convex body's silhouette is a quarter of its surface on average (Cauchy). Of the ellipsoid in the box, as
        # facets of a rough shape have a larger surface: Thomsen's formula, good to 1.1 %.
        a, b, c = ((0.5 * side_m) ** _THOMSEN for side_m in sides_m)
        area_m2 = float(np.pi * ((a * b + a * c + b * c) / 3.0) ** (1.0 / _THOMSEN))
        return min(area_m2 / m_per_px**2, frame_px2)

    def length_m(self, rule: dict[str, float]) -> float | None:
        """Return the length of a rule, m; None if it is not known.

        Four digits are kept, so that a number can be read, and does not depend on the machine.
        """
        ones_m = {unit: self.m_per_px() if unit == "px" else max(self.sides_m() or (), default=None) for unit in rule}
        known_m = [rule[unit] * one_m for unit, one_m in ones_m.items() if one_m is not None]
        return float(f"{min(known_m):.4g}") if known_m else None

"""Lengths that a scenario or a method may leave out: so many pixels of the images, or a share of the body."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

from pydantic import Field
from pydantic.fields import FieldInfo

LEFT_OUT = "left_out"
"""Key of the JSON Schema of a field: what its length follows from."""


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

    Parameters
    ----------
    default_m
        The length where there is no scenario: of a model that is made in Python.
    description
        What the length is.
    px, body
        Where it is left out: so many pixels at the median range of the images, or such a share of the longest side of
        the body's box; of both the smaller.
    gt, ge
        As of `pydantic.Field`.
    """
    rule = {unit: amount for unit, amount in (("px", px), ("body", body)) if amount is not None}
    extra: dict[str, Any] = {LEFT_OUT: rule}
    words = {"px": "{:g} px at the median range", "body": "{:g} of the body's length"}
    amounts = [words[unit].format(amount) for unit, amount in rule.items()]
    left_out = f"{description}; left out: {' or '.join(amounts)}{', the smaller' if len(amounts) > 1 else ''}"
    return Field(default_m, description=left_out, json_schema_extra=extra, gt=gt, ge=ge)


def rule_of(field: FieldInfo) -> dict[str, float] | None:
    """Return what a length that is left out follows from, ``{"px": amount, "body": amount}`` or one; else None."""
    extra = field.json_schema_extra
    return cast("dict[str, float] | None", extra.get(LEFT_OUT)) if isinstance(extra, dict) else None


@dataclass(frozen=True, slots=True)
class Scale:
    """Pixel and body of a scenario, by which its lengths are measured; called when a length needs them.

    Parameters
    ----------
    m_per_px
        Returns the length across the line of sight that a pixel covers at the median range.
    body_m
        Returns the longest side of the body's box, m.
    """

    m_per_px: Callable[[], float | None]
    body_m: Callable[[], float | None]

    def length_m(self, rule: dict[str, float]) -> float | None:
        """Return the length of a rule, m; None if it is not known.

        Four digits are kept, so that a number can be read, and does not depend on the machine.
        """
        ones_m = {unit: self.m_per_px() if unit == "px" else self.body_m() for unit in rule}
        known_m = [rule[unit] * one_m for unit, one_m in ones_m.items() if one_m is not None]
        return float(f"{min(known_m):.4g}") if known_m else None

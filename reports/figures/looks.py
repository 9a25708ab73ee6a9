"""One look for one estimator: the same colour in every figure of the product, lines and marks that tell them apart."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from reports.figures.style import (
    BLUE,
    GREEN,
    GREY,
    LINE_STYLES,
    ORANGE,
    PURPLE,
    SERIES_COLOURS,
    SKY,
    VERMILION,
    LineStyle,
)

MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*", "<", ">")

# Six colours serve more methods: those that stand in one figure most often have different ones. Controls are grey.
_COLOURS: Mapping[str, str] = MappingProxyType(
    {
        "prior": GREY,
        "landmark-harris": BLUE,
        "whole-image": SKY,
        "landmark-ransac": ORANGE,
        "minimal-sets": SKY,
        "photometric": PURPLE,
        "lmaps": GREEN,
        "landmark-altimeter": VERMILION,
        "landmark-sift": VERMILION,
        "landmark-orb": PURPLE,
        "crater-pose": SKY,
        "dead-reckoning": GREY,
        "ba-slam": BLUE,
        "ekf-slam": ORANGE,
        "iterated-ekf-slam": VERMILION,
        "consistent-ekf-slam": PURPLE,
        "fixed-lag": GREEN,
        "batch": SKY,
        "dynamic-smoother": VERMILION,
        "loop-smoother": PURPLE,
        "gtsam-fixed-lag": ORANGE,
        "gtsam-isam2": VERMILION,
        "crater-classic": BLUE,
        "crater-learned": ORANGE,
        "correlation": PURPLE,
        "context": BLUE,
        "invariants": VERMILION,
        "hybrid": ORANGE,
        "vote": GREEN,
        "batch-filter": BLUE,
    }
)


@dataclass(frozen=True, slots=True)
class PlotStyle:
    """How an estimator is drawn: Matplotlib's colour, line style and marker."""

    colour: str
    line: LineStyle
    marker: str


def plot_styles(labels: Iterable[str]) -> dict[str, PlotStyle]:
    """Give the estimators of a figure their looks, by label.

    The colour is that of the method whose name the label is or begins with (``ba-slam-5`` is a ``ba-slam``), of an
    unknown one always the same by its name. Neighbours differ in line style too, for print in grey, and labels of one
    colour do; no two have the same marker.
    """
    found: dict[str, PlotStyle] = {}
    for place, label in enumerate(dict.fromkeys(labels)):
        colour = colour_of(label)
        taken = {look.line for look in found.values() if look.colour == colour}
        lines = LINE_STYLES[place % len(LINE_STYLES) :] + LINE_STYLES[: place % len(LINE_STYLES)]
        line = next((line for line in lines if line not in taken), lines[0])
        found[label] = PlotStyle(colour, line, MARKERS[place % len(MARKERS)])
    return found


def colour_of(label: str) -> str:
    """Return the colour of a label, whatever else a figure shows."""
    known = [name for name in _COLOURS if label == name or label.startswith(f"{name}-")]
    if known:
        return _COLOURS[max(known, key=len)]
    return SERIES_COLOURS[zlib.crc32(label.encode()) % len(SERIES_COLOURS)]

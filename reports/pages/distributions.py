"""Cumulative errors of a run as interactive SVG drawings: the page shows the share of trials at the pointer."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from boresight.reports.figures.style import PlotStyle, plot_styles
from boresight.reports.run.data import RunData, select

FloatArray = NDArray[np.float64]

_MOST, _STEPS = 12, 200
_WIDTH, _HEIGHT = 760.0, 300.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 52.0, 744.0, 12.0, 252.0
_DASHES = {"-": "none", "--": "7 4", "-.": "7 3 2 3", ":": "2 3"}


@dataclass(frozen=True, slots=True, eq=False)
class SolvedErrors:
    """The errors of an estimator: (k,) of the solved trials, ascending, and the number of all trials."""

    values: FloatArray
    trials: int

    def steps(self) -> FloatArray:
        """Return the errors at equal steps of the share of the solved trials; all of them where they are few."""
        if len(self.values) <= _STEPS:
            return self.values
        return np.quantile(self.values, np.arange(1, _STEPS + 1) / _STEPS, method="inverted_cdf")


@dataclass(frozen=True, slots=True, eq=False)
class Distribution:
    """A drawing: title, markup, and for each curve its label and a piece of its line."""

    title: str
    svg: Markup
    legend: tuple[tuple[str, Markup], ...]


def distributions(run: RunData) -> Iterator[Distribution]:
    """Draw the position errors of each scenario, estimator by estimator; of many scenarios the first."""
    for scenario in list(run.manifest.scenarios)[:_MOST]:
        found = {}
        for label in map(str, run.manifest.estimators):
            rows = select(run.rows, scenario, label)
            values = np.sort(rows["position_error_m"].dropna().to_numpy(dtype=np.float64))
            if len(values):
                found[label] = SolvedErrors(values, len(rows))
        if found and max(float(errors.values[-1]) for errors in found.values()) > 0.0:
            legend = tuple((label, _sample(look)) for label, look in plot_styles(found).items())
            yield Distribution(f"Position error, {scenario}", distribution_svg(found, "m"), legend)


def distribution_svg(curves: Mapping[str, SolvedErrors], unit: str) -> Markup:
    """Draw shares of all trials over a logarithmic error."""
    positive = np.concatenate([errors.values[errors.values > 0.0] for errors in curves.values()])
    low, high = _decades(float(np.quantile(positive, 0.005)), float(np.quantile(positive, 0.995)))
    look = plot_styles(curves)
    told = {
        "unit": unit,
        "across": [_LEFT, _RIGHT],
        "range": [low, high],
        "curves": [
            {
                "label": label,
                "trials": errors.trials,
                "solved": len(errors.values),
                "values": [float(f"{value:.4g}") for value in errors.steps()],
            }
            for label, errors in curves.items()
        ],
    }
    across = _LogAbscissa(low, high)
    parts = [
        Markup('<svg class="distribution" viewBox="0 0 {} {}" role="img"><desc>{}</desc>').format(
            _WIDTH, _HEIGHT, json.dumps(told)
        ),
        *_axes(across, unit),
        *(_curve(across, errors, look[label]) for label, errors in curves.items()),
        Markup('<line class="guide" y1="{}" y2="{}" visibility="hidden"/></svg>').format(_TOP, _BOTTOM),
    ]
    return Markup("").join(parts)


@dataclass(frozen=True, slots=True)
class _LogAbscissa:
    """The logarithmic abscissa."""

    low: float
    high: float

    def x(self, value: float) -> float:
        share = np.log(max(value, self.low) / self.low) / np.log(self.high / self.low)
        return float(_LEFT + min(share, 1.0) * (_RIGHT - _LEFT))

    def ticks(self) -> list[float]:
        decades = np.arange(np.floor(np.log10(self.low)), np.ceil(np.log10(self.high)) + 1)
        every = [float(f"{m * 10.0**d:.3g}") for d in decades for m in (1, 2, 5)]
        kept = [tick for tick in every if self.low * 0.999 <= tick <= self.high * 1.001]
        return kept if len(kept) <= 12 else [tick for tick in kept if f"{tick:e}".startswith("1.")]


def _decades(low: float, high: float) -> tuple[float, float]:
    """Widen a range to numbers of one digit, a factor of two at the least."""
    high = max(high, 2.0 * low)
    down, up = 10.0 ** np.floor(np.log10(low)), 10.0 ** np.floor(np.log10(high))
    return float(np.floor(low / down) * down), float(np.ceil(high / up) * up)


def _y(share: float) -> float:
    return _BOTTOM - share * (_BOTTOM - _TOP)


def _axes(across: _LogAbscissa, unit: str) -> Sequence[Markup]:
    lines = []
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        y = _y(share)
        lines.append(Markup('<line class="grid" x1="{}" x2="{}" y1="{y}" y2="{y}"/>').format(_LEFT, _RIGHT, y=y))
        lines.append(
            Markup('<text x="{}" y="{}" text-anchor="end">{:.0f} %</text>').format(_LEFT - 6, y + 4, 100 * share)
        )
    for tick in across.ticks():
        x = f"{across.x(tick):.1f}"
        lines.append(Markup('<line class="grid" x1="{x}" x2="{x}" y1="{}" y2="{}"/>').format(_TOP, _BOTTOM, x=x))
        lines.append(Markup('<text x="{}" y="{}" text-anchor="middle">{:g}</text>').format(x, _BOTTOM + 18, tick))
    middle = 0.5 * (_LEFT + _RIGHT)
    title = f"error, {unit}: share of all trials that is at most as large"
    lines.append(Markup('<text x="{}" y="{}" text-anchor="middle">{}</text>').format(middle, _BOTTOM + 38, title))
    return lines


def _curve(across: _LogAbscissa, errors: SolvedErrors, look: PlotStyle) -> Markup:
    """Draw the steps of one estimator."""
    values = errors.steps()
    shares = len(errors.values) / errors.trials * np.arange(1, len(values) + 1) / len(values)
    path, before = [f"M{_LEFT} {_y(0.0):.1f}"], 0.0
    for value, share in zip(values, shares, strict=True):
        path.append(f"L{across.x(float(value)):.1f} {_y(before):.1f}V{_y(float(share)):.1f}")
        before = float(share)
    path.append(f"H{_RIGHT}")
    return _path("".join(path), look)


def _path(data: str, look: PlotStyle) -> Markup:
    dash = _DASHES.get(str(look.line), "7 2 2 2 2 2")
    return Markup('<path d="{}" fill="none" stroke="{}" stroke-width="2" stroke-dasharray="{}"/>').format(
        data, look.colour, dash
    )


def _sample(look: PlotStyle) -> Markup:
    """Draw a piece of a line for the legend, long enough for twice its longest dashes."""
    return Markup('<svg viewBox="0 0 36 8" aria-hidden="true">{}</svg>').format(_path("M0 4H36", look))

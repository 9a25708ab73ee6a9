"""Subjects of a comparison in one figure: errors, success, and differences to the first of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reports.figures.log_axis import mark_decades
from reports.figures.style import GREY, add_credits, grid_figure, styled
from reports.statistics.measured import Measured

_LINE_IN = 0.32
_MARKS = (("RMS", "D"), ("75th", "|"), ("95th", "|"), ("99th", "|"))


@dataclass(frozen=True, slots=True)
class SubjectSummary:
    """One line of the figure.

    Parameters
    ----------
    label, colour
        On the axis, and of its marks.
    solved, counted
        Median, RMS and the percentiles 75, 95 and 99 over the solved trials, and over all with failures counted.
    success
        Success rate; None of a control.
    difference
        Median difference to the subject that it is held against; None of that itself.
    """

    label: str
    colour: str
    solved: Sequence[Measured]
    counted: Sequence[Measured]
    success: Measured | None
    difference: Measured | None


@styled
def draw_summaries(
    standings: Sequence[SubjectSummary], axis: str, against: str, title: str, credit_lines: Sequence[str] = ()
) -> Figure:
    """Draw errors, success rates and differences, a line for each subject.

    Parameters
    ----------
    standings
        From top to bottom.
    axis
        What the error is, with its unit.
    against
        What the differences are to; '' where there are none.
    title
        Printed above the panels.
    credit_lines
        Credits of real images.
    """
    shown = [True, any(one.success for one in standings), any(one.difference for one in standings)]
    widths = [width for width, there in zip((2.2, 1.0, 1.4), shown, strict=True) if there]
    height_in = 1.75 + _LINE_IN * len(standings)
    figure, places = grid_figure(1, 1, width_in=7.5 + 1.2 * shown[2], height_in=height_in)
    places[0, 0].remove()
    panels = list(figure.subplots(1, len(widths), squeeze=False, sharey=True, width_ratios=widths)[0])
    _draw_errors(panels[0], standings, axis)
    if shown[1]:
        _draw_success(panels[1], standings)
    if shown[2]:
        _draw_differences(panels[-1], standings, axis, against)
    panels[0].set_yticks(range(len(standings)), [one.label for one in standings])
    panels[0].set_ylim(len(standings) - 0.4, -0.6)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    figure.suptitle(title, fontsize=9.5)
    add_credits(figure, credit_lines)
    return figure


def _draw_errors(axes: Axes, standings: Sequence[SubjectSummary], axis: str) -> None:
    for row, one in enumerate(standings):
        median, *further = one.solved
        _draw_interval(axes, row, median, one.colour)
        for (name, marker), measured in zip(_MARKS, further, strict=True):
            if measured.value is not None:
                size = 4 if marker == "D" else 7 + 3 * (name == "95th") + 6 * (name == "99th")
                axes.plot(measured.value, row, marker, color=one.colour, markersize=size, markerfacecolor="white")
        counted = one.counted[0].value
        if counted is not None and np.isfinite(counted) and counted != median.value:
            axes.plot(counted, row, "o", color=one.colour, markersize=7, markerfacecolor="none")
    _add_legend(axes)
    axes.set_xlabel(axis)
    if axes.dataLim.x0 <= 0.0:  # A share of nothing at all has no place on a logarithmic axis.
        return
    axes.set_xscale("log")
    mark_decades(axes.xaxis)


def _add_legend(axes: Axes) -> None:
    """Tell the marks, whatever the colour."""
    marks = {"o": "median, 95 % interval", "D": "RMS", "|": "75th, 95th, 99th percentile"}
    for marker, label in marks.items():
        axes.plot([], [], marker, color=GREY, label=label, markerfacecolor="white" if marker == "D" else GREY)
    axes.plot([], [], "o", color=GREY, markerfacecolor="none", markersize=7, label="median, failures counted")


def _draw_interval(axes: Axes, row: int, measured: Measured, colour: str) -> None:
    """Draw a value as a point, and its interval as a thick bar."""
    if measured.value is None:
        return
    if measured.low is not None and measured.high is not None:
        axes.hlines(row, measured.low, measured.high, color=colour, linewidth=4.0, alpha=0.45)
    axes.plot(measured.value, row, "o", color=colour, markersize=5)


def _draw_success(axes: Axes, standings: Sequence[SubjectSummary]) -> None:
    for row, one in enumerate(standings):
        if one.success is not None:
            _draw_interval(axes, row, _scaled_interval(one.success, 100.0), one.colour)
    low, high = axes.get_xlim()
    axes.set_xlim(max(low, 0.0), min(high, 101.0))
    axes.set_xlabel("success, %")


def _draw_differences(axes: Axes, standings: Sequence[SubjectSummary], axis: str, against: str) -> None:
    axes.axvline(0.0, color=GREY, linewidth=1.0)
    for row, one in enumerate(standings):
        if one.difference is not None:
            _draw_interval(axes, row, one.difference, one.colour)
    low, high = axes.get_xlim()
    edge = 0.06 * (max(high, 0.0) - min(low, 0.0))
    axes.set_xlim(min(low, -edge), max(high, edge))
    unit = axis.rsplit(", ", 1)[-1] if ", " in axis else ""
    axes.set_xlabel(f"median difference to\n{against}{f', {unit}' if unit else ''}")


def _scaled_interval(measured: Measured, scale: float) -> Measured:
    return Measured(*(None if x is None else scale * x for x in (measured.value, measured.low, measured.high)))

"""Errors of several methods in one histogram (the paper's figure 5)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reports.figures.style import (
    LINE_STYLES,
    SERIES_COLOURS,
    FloatArray,
    add_credits,
    grid_figure,
    raise_top,
    shared_edges,
    step_histogram,
    styled,
)

_METHODS_INSIDE = 4
_LEGEND_TITLE = "median (share beyond the axis)"
_SHARE_TOLD = 1.0
_METHOD_PANELS = (
    ("attitude_error_deg", "attitude error, deg", "frequency per degree"),
    ("position_error_m", "position error, m", "frequency per metre"),
)


@styled
def draw_method_errors(
    groups: Mapping[str, Mapping[str, pd.DataFrame]], title: str, credit_lines: Sequence[str] = ()
) -> Figure:
    """Draw normalised histograms of the errors of methods, a row of panels for each group of them.

    Parameters
    ----------
    groups
        Title of each row, and its methods: label to errors with columns ``attitude_error_deg`` and
        ``position_error_m``. All rows share their axes. A method of the same label has one colour in all rows.
    title
        Printed above the panels.
    credit_lines
        Credits of real images.
    """
    figure, rows = grid_figure(
        len(groups), 2, height_in=0.5 + sum(_row_height_in(len(methods)) for methods in groups.values())
    )
    labels = list(dict.fromkeys(label for methods in groups.values() for label in methods))
    for column, (name, label, frequency) in enumerate(_METHOD_PANELS):
        samples = {
            row: {method: np.asarray(errors[name].dropna(), dtype=np.float64) for method, errors in methods.items()}
            for row, methods in groups.items()
        }
        edges = _common_edges([sample for methods in samples.values() for sample in methods.values()])
        for axes, (row, methods) in zip(rows[:, column], samples.items(), strict=True):
            _draw_methods(axes, methods, labels, edges)
            axes.set(xlabel=label, ylabel=frequency, title=row)
        top = max(axes.get_ylim()[1] for axes in rows[:, column])
        for axes in rows[:, column]:
            axes.set_ylim(0.0, top)
    figure.suptitle(title, fontsize=9.5)
    add_credits(figure, credit_lines)
    return figure


def _row_height_in(methods: int) -> float:
    """Leave room for a legend below the panels, where it is too long to stand in them."""
    return 2.9 if methods <= _METHODS_INSIDE else 2.9 + 0.18 * methods


def _common_edges(samples: Sequence[FloatArray]) -> FloatArray:
    """Choose bins in which most methods fit, so that one that fails does not flatten the others."""
    ends = [float(np.percentile(sample, 99.0)) for sample in samples if len(sample)]
    return shared_edges([np.array([1.2 * float(np.median(ends))])] if ends else [], bins=60)


def _draw_methods(axes: Axes, methods: Mapping[str, FloatArray], labels: Sequence[str], edges: FloatArray) -> None:
    for method, sample in methods.items():
        index = labels.index(method)
        line = {
            "color": SERIES_COLOURS[index % len(SERIES_COLOURS)],
            "linestyle": LINE_STYLES[index % len(LINE_STYLES)],
            "linewidth": 1.5,
        }
        share = 100.0 * np.count_nonzero(sample > edges[-1]) / max(len(sample), 1)
        median = f"{np.median(sample):.3g}" if len(sample) else "none"
        beyond = f" ({share:.0f} %)" if share >= _SHARE_TOLD else ""
        step_histogram(axes, sample, edges, label=f"{method}: {median}{beyond}", **line)
    axes.set_xlim(0.0, edges[-1])
    if len(methods) <= _METHODS_INSIDE:
        raise_top(axes, len(methods))
        legend = axes.legend(loc="upper right", title=_LEGEND_TITLE, title_fontsize=7.5, fontsize=7.5)
        legend.set_in_layout(False)
    else:
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), title=_LEGEND_TITLE, title_fontsize=8.0)

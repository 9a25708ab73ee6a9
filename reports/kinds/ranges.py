"""Figures of single images whose range varies: errors of the trials over it, with the limits that are required."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from textwrap import fill

import pandas as pd
from matplotlib.figure import Figure

from boresight.reports.compare.figures import binned_errors
from boresight.reports.compare.trials import ESTIMATOR, SCENARIO, tabulate_trials, trial_numbers
from boresight.reports.figures.named import NamedFigure, file_stem
from boresight.reports.figures.style import GREY, draw_points, finish, grid_figure, mark_decades, plot_styles, styled
from boresight.reports.kinds.requirements import required_values
from boresight.reports.run.data import RunData
from boresight.reports.schema.column import POSE_COLUMNS
from boresight.reports.schema.records import CONTROL, as_title
from boresight.reports.schema.tables import measure_of

OVER_RANGE = "error_over_range"
"""The stems of these figures begin with it."""
_VARIES, _FAR_M = 1.2, 1e4
"""Ratio of the ranges of a scenario above which errors are drawn over them, and the farthest that is in metres."""
_LOG_RANGE, _LOG_ERROR = 10.0, 30.0
"""Ratio of the ranges, and of the largest error to the lower quartile, above which an axis is logarithmic."""


def range_figures(run: RunData) -> Iterator[NamedFigure]:
    """Draw the measures with a required limit, or else the position error, over the range, by scenario."""
    limits = [(one.measure, scene, label, one.limit) for one, scene, label, _ in required_values(run) if one.limit]
    known = trial_numbers(run)
    for name in [one for one in dict.fromkeys(one[0] for one in limits) if one in known] or POSE_COLUMNS[:1]:
        trials = tabulate_trials([run], metric := measure_of(name), (ESTIMATOR, SCENARIO))
        for scenario in map(str, trials[SCENARIO].unique()):
            own = trials[trials[SCENARIO] == scenario]
            here = [(label, limit) for measure, scene, label, limit in limits if (measure, scene) == (name, scenario)]
            if not (far_m := own["range_m"].max()) > _VARIES * own["range_m"].min() or own["value"].isna().all():
                continue
            unit, metres = ("km", 1e3) if far_m > _FAR_M else ("m", 1.0)
            own = own.assign(over=own["range_m"] / metres)
            labels = sorted(map(str, own[ESTIMATOR].unique()), key=run.place_of)
            tables = {label: own[own[ESTIMATOR] == label] for label in labels}
            title = f"{as_title(metric.label)} over range, {scenario}"
            yield NamedFigure(
                file_stem(OVER_RANGE, name, scenario),
                _draw(tables, here, (title, f"range, {unit}", metric.axis), run.manifest.credits),
                f"{title}: a point for each trial with an estimate, a cross at the top for each without one. Large"
                " marks: medians in bins of equal numbers of trials, with 95 % intervals."
                f"{' Grey: the prior.' if CONTROL in tables else ''}{' Dashed: the required limit.' if here else ''}",
                f"{as_title(metric.label)} of every trial against the range, for {', '.join(tables)}.",
            )


@styled
def _draw(
    tables: Mapping[str, pd.DataFrame], limits: Sequence[tuple[str, float]], words: Sequence[str], credit: Sequence[str]
) -> Figure:
    """Draw ``value`` (NaN: no estimate) over ``over``, a panel for each method; ``words`` are title and both labels."""
    shown = {label: table for label, table in tables.items() if label != CONTROL} or tables
    columns = min(len(shown), 3)
    rows, styles = -(-len(shown) // columns), plot_styles(shown)
    figure, places = grid_figure(rows, columns, width_in=max(4.5, 2.5 * columns), height_in=1.3 + 2.4 * rows)
    medians, whole = dict(binned_errors(shown, "value", "over")), pd.concat(tables.values())
    highest = max(whole["value"].max(), *(limit for _, limit in limits), 0.0)
    small = whole.groupby(ESTIMATOR)["value"].quantile(0.25).min()
    for axes, (label, table) in zip(places.ravel(), shown.items(), strict=False):
        if (prior := tables.get(CONTROL)) is not None and label != CONTROL:
            axes.plot(prior["over"], prior["value"], ".", color=GREY, alpha=0.4, markersize=3, label="prior")
        colour, failed = styles[label].colour, table.loc[table["value"].isna(), "over"]
        axes.plot(table["over"], table["value"], ".", color=colour, alpha=0.5, markersize=5, label="a trial")
        axes.plot(failed, 0.97 + 0.0 * failed, "kx", ms=5, transform=axes.get_xaxis_transform(), label="no estimate")
        if label in medians:
            draw_points(axes, medians[label], styles[label], markersize=6, markeredgecolor="0.1", label="median")
        for limit in (limit for estimator, limit in limits if estimator == label):
            axes.axhline(limit, color="0.1", linewidth=1.0, linestyle="--", label="required")
        solved = f"{label}: solved {table['value'].count()}/{len(table)}"
        axes.set(title=solved, xlabel=words[1], ylim=(0.0, 1.15 * highest))
        if whole["over"].max() > _LOG_RANGE * whole["over"].min() > 0.0:
            axes.set_xscale("log")
            mark_decades(axes.xaxis)
        if highest > _LOG_ERROR * small > 0.0:
            axes.set(yscale="log", ylim=(whole.loc[whole["value"] > 0.0, "value"].min() / 1.5, highest * 2.5))
            mark_decades(axes.yaxis)
    for axes in places.ravel()[len(shown) :]:
        axes.set_visible(False)
    figure.supylabel(fill(words[2], 40), fontsize=9.0)
    return finish(figure, words[0], credit, legend=places[0, 0], columns=5)

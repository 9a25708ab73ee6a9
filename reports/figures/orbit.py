"""Orbit determination over time: residuals in pixels (figure 10 of Cheng et al. 2003), and position errors."""

from __future__ import annotations

import pandas as pd
from matplotlib.figure import Figure

from reports.figures.looks import looks
from reports.figures.style import BLUE, GREY, ORANGE, grid_figure, new_figure, styled


@styled
def draw_residuals(residuals: pd.DataFrame, title: str) -> Figure:
    """Draw residuals of columns above those of rows.

    Parameters
    ----------
    residuals
        Columns ``time_days``, ``u_px``, ``v_px`` and ``used``; what was edited is left out.
    title
        Printed above.
    """
    figure, axes = grid_figure(2, 1, width_in=7.0, height_in=4.4)
    used = residuals[residuals["used"].astype(bool)]
    for (panel,), name, colour, label in zip(axes, ("u_px", "v_px"), (BLUE, ORANGE), ("column", "row"), strict=True):
        panel.plot(used["time_days"], used[name], ".", color=colour, markersize=1.5)
        panel.set(ylabel=f"{label} residual, px")
        panel.axhline(0.0, color=GREY, linewidth=0.8)
    axes[1, 0].set(xlabel="time after the epoch, days")
    figure.suptitle(f"{title}: {len(used):,} of {len(residuals):,} sightings", fontsize=9.5)
    return figure


@styled
def draw_orbit_errors(errors: pd.DataFrame, title: str) -> Figure:
    """Draw the position error over time, median and band over the trials, for each estimator.

    Parameters
    ----------
    errors
        Columns ``estimator``, ``trial``, ``time_days``, ``position_error_m``, ``position_sigma_m`` and ``predicted``.
    title
        Printed above.
    """
    figure, (axes,) = new_figure(1, width_in=6.0)
    drawn = looks(map(str, errors["estimator"].unique()))
    for name, own in errors.groupby("estimator", sort=False):
        colour = drawn[str(name)].colour
        over = own.groupby("time_days")
        median = over["position_error_m"].median()
        low, high = (over["position_error_m"].quantile(q) for q in (0.05, 0.95))
        axes.plot(median.index, median, color=colour, linestyle=drawn[str(name)].line, label=str(name))
        axes.fill_between(median.index, low, high, color=colour, alpha=0.2, linewidth=0)
        axes.plot(median.index, over["position_sigma_m"].median(), color=colour, linestyle="--", linewidth=0.9)
    arc = errors[~errors["predicted"].astype(bool)]
    axes.axvline(float(arc["time_days"].max()), color=GREY, linewidth=0.8)
    axes.set(xlabel="time after the epoch, days", ylabel="position error, m", yscale="log")
    axes.legend(loc="upper left")
    figure.suptitle(title, fontsize=9.5)
    return figure

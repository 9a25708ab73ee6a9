"""Coverage of the covariances that estimators claim."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import binom, chi2

from reports.figures.style import GREY, LINE_STYLES, FloatArray, add_credits, new_figure, styled

_POINTS = np.linspace(0.0, 1.0, 201)


@dataclass(frozen=True, slots=True, eq=False)
class Claim:
    """One curve.

    Parameters
    ----------
    label, colour
        Of the curve.
    squares, degrees
        (n,) weighed squares and the degrees of freedom of each.
    independent
        How many of them are independent.
    """

    label: str
    colour: str
    squares: FloatArray
    degrees: FloatArray
    independent: int


@styled
def draw_calibration(claims: Sequence[Claim], title: str, credit_lines: Sequence[str] = ()) -> Figure:
    """Draw the share of trials within each claimed share of the chi-square distribution.

    Parameters
    ----------
    claims
        The curves. The band is that of the fewest independent trials among them.
    title
        Printed above the panel.
    credit_lines
        Credits of real images.
    """
    figure, (axes,) = new_figure(1, width_in=4.6, height_in=4.4 + 0.17 * len(claims))
    fewest = min(one.independent for one in claims)
    low, high = (binom.ppf(tail, fewest, _POINTS) / fewest for tail in (0.025, 0.975))
    axes.fill_between(_POINTS, low, high, color=GREY, alpha=0.2, linewidth=0)
    axes.plot([0.0, 1.0], [0.0, 1.0], color=GREY, linewidth=0.9)
    for i, one in enumerate(claims):
        reached = np.sort(chi2.cdf(one.squares, one.degrees))
        share = np.searchsorted(reached, _POINTS, side="right") / len(reached)
        axes.plot(_POINTS, share, color=one.colour, linestyle=LINE_STYLES[i % len(LINE_STYLES)], label=one.label)
    axes.set(xlabel="share claimed by the covariance", ylabel="share of trials within", xlim=(0, 1), ylim=(0, 1.005))
    axes.set_aspect("equal", adjustable="box")
    figure.legend(loc="outside lower center", ncols=1, fontsize=7.5)
    figure.suptitle(title, fontsize=9.5)
    add_credits(figure, credit_lines)
    return figure

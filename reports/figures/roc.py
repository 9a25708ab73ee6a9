"""Receiver operating characteristics (ROC) of scores that distinguish bad solutions from good ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure

from boresight.reports.figures.style import GREY, finish, new_figure, plot_styles, styled
from boresight.scenarios.arrays import FloatArray

MOST_CURVES = 5
"""Largest number of curves in a panel that can still be distinguished."""


@dataclass(frozen=True, slots=True, eq=False)
class RocCurve:
    """ROC curve of one score: its name, (m,) ascending false and true positive rates, and the area below it (AUC)."""

    name: str
    false_positives: FloatArray
    true_positives: FloatArray
    area: float


@styled
def draw_roc(panels: Mapping[str, Sequence[RocCurve]], title: str, credit_lines: Sequence[str] = ()) -> Figure:
    """Draw a panel of curves for each definition of a bad solution.

    Parameters
    ----------
    panels
        Definition of a bad solution to at most `MOST_CURVES` curves.
    """
    figure, axes = new_figure(len(panels), width_in=3.9 * max(1, len(panels)), height_in=4.2)
    drawn = plot_styles(curve.name for curves in panels.values() for curve in curves)
    for place, (definition, curves) in zip(axes, panels.items(), strict=True):
        place.plot([0, 1], [0, 1], color=GREY, linewidth=0.9, linestyle=":")
        for curve in curves:  # a score has the same style in all panels
            label, style = f"{curve.name}: AUC {curve.area:.2f}", drawn[curve.name]
            x, y = curve.false_positives, curve.true_positives
            place.plot(x, y, color=style.colour, linestyle=style.line, linewidth=1.4, label=label)
        place.set(xlabel="good solutions flagged", ylabel="bad solutions flagged", xlim=(0, 1), ylim=(0, 1.01))
        place.set_box_aspect(1)
        place.legend(loc="lower right")
        place.set_title(f"bad: {definition}")
    return finish(figure, title, credit_lines)

"""The figures of a comparison."""

from __future__ import annotations

from collections.abc import Iterator

from reports.compare.grids import changed
from reports.compare.subjects import RunComparison
from reports.figures.standings import Standing, draw_standings
from reports.figures.style import GREY, SERIES_COLOURS
from reports.named_figure import NamedFigure
from reports.records import CONTROL
from reports.statistics import Measured


def comparison_figures(found: RunComparison) -> Iterator[NamedFigure]:
    """Draw every figure that the trials allow."""
    yield standings_figure(found)


def colours(found: RunComparison) -> dict[tuple[str, ...], str]:
    """Give each subject a colour: that of its estimator where each is of one, else one of its own; grey the control."""
    keys = [one.estimator or found.label(one.names) for one in found.subjects]
    named = [key for key in dict.fromkeys(keys) if key != CONTROL]
    own = {key: SERIES_COLOURS[i % len(SERIES_COLOURS)] for i, key in enumerate(named)}
    return {one.names: own.get(key, GREY) for one, key in zip(found.subjects, keys, strict=True)}


def credits_of(found: RunComparison) -> list[str]:
    """Credit lines of all runs, each once."""
    return list(dict.fromkeys(line for run in found.runs for line in run.manifest.credits))


def standings_figure(found: RunComparison) -> NamedFigure:
    """Draw errors, success and differences of all subjects."""
    own = colours(found)
    bases = _bases(found)
    standings = [
        Standing(
            found.label(one.names),
            own[one.names],
            one.solved,
            one.counted,
            None if one.estimator == CONTROL else one.success,
            bases[one.names][1] if one.names in bases else None,
        )
        for one in found.subjects
    ]
    against = {name for name, _ in bases.values()}
    title = ", ".join(filter(None, (found.metric.label.capitalize(), found.shared)))
    counts = "; ".join(f"{found.label(one.names)} {one.n_ok}/{one.n}" for one in found.subjects)
    return NamedFigure(
        "compare",
        draw_standings(
            standings, found.metric.axis, against.pop() if len(against) == 1 else "the first", title, credits_of(found)
        ),
        f"{title}: median with its 95 % interval, RMS and percentiles over the solved trials, the median of all trials"
        " with failures counted, success rates, and the median difference trial by trial to the first of those that"
        f" differ from it in one thing. Solved trials: {counts}.",
        f"Errors, success rates and differences of {', '.join(found.label(one.names) for one in found.subjects)}.",
    )


def _bases(found: RunComparison) -> dict[tuple[str, ...], tuple[str, Measured]]:
    """Find for every subject the first one that it is held against: what differs in it, and the difference."""
    order = {one.names: place for place, one in enumerate(found.subjects)}
    held: dict[tuple[str, ...], tuple[str, Measured]] = {}
    for one in sorted(found.contrasts, key=lambda contrast: order[contrast.second]):
        held.setdefault(one.first, (changed(one), one.median))
    return held

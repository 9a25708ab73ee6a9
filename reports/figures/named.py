"""A figure with its caption, the stem of its files, and the runs and trials that it is of."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from matplotlib.figure import Figure

from boresight.reports.figures.style import add_footer
from boresight.reports.run.data import RunData
from boresight.reports.schema.records import count_of

_FEW = 6


@dataclass(frozen=True, slots=True, eq=False)
class NamedFigure:
    """A figure with the stem of its files, its caption and a description for those who cannot see it."""

    stem: str
    figure: Figure
    caption: str
    alt: str


def file_stem(*parts: str) -> str:
    """Make a file name that is valid on every system."""
    return re.sub(r"[^A-Za-z0-9._-]+", "-", "_".join(parts))


def run_label(run: RunData) -> str:
    """Describe a run on one line: campaign, trials (of those asked for), seed, commit, draft and embedded bodies."""
    manifest, (done, asked) = run.manifest, run.progress()
    trials = count_of(manifest.trials, "trial") if done == asked else f"{done:,} of {count_of(asked, 'trial')}"
    commit = f", commit {manifest.commit}" if manifest.commit else ""
    embedded = f", {', '.join(manifest.embedded)}" if manifest.embedded else ""
    draft = f", a draft of scale {manifest.draft:g}" if manifest.draft < 1.0 else ""
    return f"boresight {manifest.name}, {trials}, seed {manifest.seed}{commit}{draft}{embedded}"


def add_provenance(figure: Figure, runs: Sequence[RunData]) -> None:
    """Print the runs behind a figure in its footer."""
    add_footer(figure, list(dict.fromkeys(map(run_label, runs))))


def with_trial_counts(figure: NamedFigure, runs: Sequence[RunData]) -> NamedFigure:
    """Append to a caption how many trials the runs have, and how many of them each method solved."""
    told = [_counts(run) for run in runs]
    named = told if len(told) == 1 else [f"{run.manifest.name} {one}" for run, one in zip(runs, told, strict=True)]
    return replace(figure, caption=f"{figure.caption} Of {'; '.join(dict.fromkeys(named))}.")


def _counts(run: RunData) -> str:
    """Count the trials of a run over all scenarios, and those that methods solved."""
    trials, several = run.progress()[0], run.rows["scenario"].nunique()
    solved = (run.rows["status"] == "ok").groupby(run.rows["estimator"], sort=False).sum()
    if len(solved) > _FEW:
        whose = f"{solved.min()} to {solved.max()} by each of {len(solved)} methods"
    else:
        whose = ", ".join(f"{label} {solved[label]}" for label in sorted(map(str, solved.index), key=run.place_of))
    of = f" of {several} scenarios" if several > 1 else ""
    return f"{count_of(trials, 'trial')}{of}, solved: {whose}"

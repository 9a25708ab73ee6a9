"""Where a figure comes from, printed in its footer, so that it tells so when it stands alone."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure

from reports.figures.style import add_footer
from reports.run_data import Manifest, RunData


def made_by(manifest: Manifest) -> str:
    """Name a run: campaign, trials, seed and commit."""
    commit = f", commit {manifest.commit}" if manifest.commit else ""
    trials = "1 trial" if manifest.trials == 1 else f"{manifest.trials} trials"
    return f"boresight {manifest.name}, {trials}, seed {manifest.seed}{commit}"


def stamp(figure: Figure, runs: Sequence[RunData]) -> None:
    """Print the runs that a figure is of in its footer."""
    add_footer(figure, list(dict.fromkeys(made_by(run.manifest) for run in runs)))

"""Write a sensitivity analysis: table, samples and figure."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from reports.compare.global_sensitivity import Sensitivity, VariedKey
from reports.compare.metrics import Metric
from reports.figures.global_sensitivity import EstimatorPanels, draw_sensitivity
from reports.figures.provenance import add_provenance
from reports.figures.style import save_figure
from reports.run.data import RunData
from reports.schema.grid import Grid
from reports.statistics.intervals import FloatArray


def write_sensitivity(
    run: RunData,
    found: Sequence[Sensitivity],
    grid: Grid,
    varied: Sequence[VariedKey],
    samples: FloatArray,
    metric: Metric,
) -> Path:
    """Write ``sensitivity/`` into the run folder; return the page.

    ``sensitivity.md``, ``samples.csv`` (every sample with its outcomes), ``indices.csv`` and the figure.
    """
    folder = run.folder / "sensitivity"
    folder.mkdir(parents=True, exist_ok=True)
    keys = [one.key for one in varied]
    table = pd.DataFrame(samples, columns=keys).assign(**{one.estimator: one.outcomes for one in found})
    table.to_csv(folder / "samples.csv", index=False, lineterminator="\n")
    indices = [
        {"estimator": one.estimator, "key": key, "index": name, "value": m.value, "low": m.low, "high": m.high}
        for one in found
        for name, shares in one.shares.items()
        for key, m in zip(keys, shares, strict=True)
    ]
    pd.DataFrame(indices).to_csv(folder / "indices.csv", index=False, lineterminator="\n")
    rows = [EstimatorPanels(one.estimator, one.outcomes, one.base, one.shares) for one in found]
    figure = draw_sensitivity(rows, keys, samples, metric.axis, "Sensitivity")
    add_provenance(figure, [run])
    save_figure(figure, folder / "sensitivity")
    unmoved = [f"- {key} changes no result of {one.estimator}, bit for bit." for one in found for key in one.unmoved]
    parts = [grid.markdown(), "\n".join(unmoved), "![Indices and outcomes of each varied key](sensitivity.png)"]
    (folder / "sensitivity.md").write_text("\n\n".join(part for part in parts if part) + "\n", encoding="utf-8")
    return folder / "sensitivity.md"

"""Write a sensitivity analysis: indices and samples as CSV, and a page with the figure of the indices."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from boresight.reports.compare.global_sensitivity import Sensitivity, VariedKey
from boresight.reports.compare.metrics import Metric
from boresight.reports.figures.global_sensitivity import EstimatorPanels, draw_sensitivity
from boresight.reports.figures.provenance import add_provenance
from boresight.reports.pages.document import ON_BOARD, Document, write_document
from boresight.reports.run.data import RunData
from boresight.reports.schema.grid import Grid
from boresight.reports.schema.labels import count_of
from boresight.reports.schema.named_figure import NamedFigure
from boresight.scenarios.arrays import FloatArray


def write_sensitivity(
    run: RunData,
    found: Sequence[Sensitivity],
    grid: Grid,
    varied: Sequence[VariedKey],
    samples: FloatArray,
    metric: Metric,
) -> Path:
    """Write a sensitivity analysis into the folder ``sensitivity`` of a run; return the path of the page.

    The files are ``sensitivity.html``, ``sensitivity.md``, ``samples.csv`` (every sample with its outcomes),
    ``indices.csv`` and the figure.
    """
    folder = run.folder / "sensitivity"
    keys = [one.key for one in varied]
    table = pd.DataFrame(samples, columns=keys).assign(**{one.estimator: one.outcomes for one in found})
    indices = [
        {"estimator": one.estimator, "key": key, "index": name, "value": m.value, "low": m.low, "high": m.high}
        for one in found
        for name, shares in one.shares.items()
        for key, m in zip(keys, shares, strict=True)
    ]
    rows = [EstimatorPanels(one.estimator, one.outcomes, one.base, one.shares) for one in found]
    figure = draw_sensitivity(rows, keys, samples, metric.axis, "Sensitivity")
    add_provenance(figure, [run])
    manifest = run.manifest
    page = Document(
        product="boresight sensitivity",
        title=f"Sensitivity of the {metric.label}, {manifest.name}",
        facts=[
            *(("Varied", f"{one.key} from {one.low:g} to {one.high:g}") for one in varied),
            ("Samples", f"{len(samples)}, of {count_of(manifest.trials, 'trial')} each, seed {manifest.seed}"),
            (ON_BOARD, grid.known),
            *(
                ("No effect", f"{key} changes no result of {one.estimator}, bit for bit.")
                for one in found
                for key in one.unmoved
            ),
        ],
        grids=[grid],
        lead=NamedFigure(
            "sensitivity",
            figure,
            "Indices of each varied key with their 95 % intervals, and the outcome of every sample against each key."
            " The dashed line is the outcome with no key varied.",
            "Indices and outcomes of each varied key",
        ),
        command=manifest.command,
        credits=manifest.credits,
    )
    path = write_document(page, folder, "sensitivity.html", "sensitivity.md")
    table.to_csv(folder / "samples.csv", index=False, lineterminator="\n")
    pd.DataFrame(indices).to_csv(folder / "indices.csv", index=False, lineterminator="\n")
    return path

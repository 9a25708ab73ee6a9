"""What a report says, worked out once and then written as page, Markdown, CSV, figures and terminal text."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path

import pandas as pd

from reports.kinds.kind import Content, report_kind
from reports.kinds.sequence.tables import pooled_alone
from reports.pages.notes import notes
from reports.published import Comparison, load_published
from reports.run.data import RunData, read_run
from reports.run.known import known_lines
from reports.schema.records import Record
from reports.statistics.consistency import consistency_records
from reports.statistics.measures import measure_run
from reports.statistics.paired import paired_records
from reports.statistics.roc import outlier_records
from reports.verdicts.comparison import ComparedClaim, ComparedValue, compare, compare_claims


def read_content(folder: Path) -> Content:
    """Read a run folder and work out what is to be said.

    Raises
    ------
    BoresightError
        If the folder is not a run, holds no finished trial, or names unknown published values.
    """
    return content_of(read_run(folder))


def content_of(run: RunData) -> Content:
    """Work out what is to be said of a run that is read.

    Raises
    ------
    BoresightError
        If it names unknown published values.
    """
    comparison = load_published(run.manifest.report) if run.manifest.report else None
    own = report_kind(run).records(run, comparison)
    records = (*measure_run(run), *own, *outlier_records(run), *paired_records(run), *consistency_records(run))
    compared, claims = beside_published(run, records, comparison) if comparison else ((), ())
    return Content(run, records, comparison, compared, claims, tuple(notes(run, comparison)))


def summary(folder: str | PathLike[str]) -> pd.DataFrame:
    """Work out every number of a run's report, as its table.csv has them: one row each, with n_ok, n and interval.

    Its ``attrs["known"]`` are the lines of what on board was identical with the truth, and what was not.

    Raises
    ------
    BoresightError
        If the folder is not a run, or holds no finished trial.
    """
    content = read_content(Path(folder))
    table = content.table()
    table.attrs["known"] = list(known_lines(content.run))
    return table


def beside_published(
    run: RunData, records: Sequence[Record], comparison: Comparison
) -> tuple[tuple[ComparedValue, ...], tuple[ComparedClaim, ...]]:
    """Set published values and orders beside ours; of sets of images that are pooled, beside the pool alone."""
    judged = pooled_alone(run, records)
    return compare(judged, comparison), compare_claims(judged, comparison)

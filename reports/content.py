"""What a report says, worked out once and then written as page, Markdown, CSV, figures and terminal text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from os import PathLike
from pathlib import Path

import pandas as pd

from reports.comparison import ComparedClaim, ComparedValue, compare, compare_claims
from reports.consistency import consistency_records
from reports.contrasts import cycle_ratio_records, ratio_records, reduction_records
from reports.crater_matching import matching_records
from reports.craters import crater_records
from reports.derived import derived_records
from reports.detection import outlier_records
from reports.known import known_lines
from reports.measures import measure_run
from reports.navigation import navigation_records
from reports.notes import notes
from reports.orbits import orbit_records
from reports.paired import paired_records
from reports.published import Comparison, load_published
from reports.records import Record
from reports.run_data import RunData, read_run
from reports.sequences import pooled_alone
from reports.vision import vision_records

_BESIDE = ["published", "tolerance", "verdict", "place"]


@dataclass(frozen=True, slots=True, eq=False)
class Content:
    """A run and all that is said of it.

    Parameters
    ----------
    run
        The stored tables.
    records
        Every measured number.
    comparison, compared
        Published values and our numbers beside them; None and empty if the campaign names none.
    claims
        Published orders and our medians in them.
    notes
        What a reader must know before trusting the numbers.
    """

    run: RunData
    records: tuple[Record, ...]
    comparison: Comparison | None
    compared: tuple[ComparedValue, ...]
    claims: tuple[ComparedClaim, ...]
    notes: tuple[str, ...]

    def table(self) -> pd.DataFrame:
        """Every measured number, beside the published one where there is one."""
        beside = {id(c.ours): c for c in self.compared if c.ours is not None}
        lines = []
        for record in self.records:
            match = beside.get(id(record))
            published = {
                "published": match.published.value if match else None,
                "tolerance": match.published.tolerance if match else None,
                "verdict": match.verdict if match else "",
                "place": match.published.place if match else "",
            }
            lines.append(asdict(record) | published)
        return pd.DataFrame(lines, columns=[field.name for field in fields(Record)] + _BESIDE)


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
    derived = derived_records(run, comparison.radius_m) if comparison and comparison.radius_m else ()
    reductions = tuple(reduction_records(run, comparison)) if comparison else ()
    beside = (*paired_records(run), *ratio_records(run), *cycle_ratio_records(run), *consistency_records(run))
    craters = (*matching_records(run), *crater_records(run), *navigation_records(run))
    seen = (*vision_records(run), *craters, *orbit_records(run))
    records = (*measure_run(run), *seen, *derived, *reductions, *outlier_records(run), *beside)
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

"""Whether the covariances that subjects claim are true: NEES and NIS beside their bands."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from reports.compare.looks import credit_lines, figure_title, subject_colours, subjects_by_group
from reports.compare.subjects import RunComparison, Subject
from reports.figures.comparison import CoverageCurve, draw_coverage
from reports.run.data import TRIAL_KEY
from reports.schema.grid import Grid, number
from reports.schema.named_figure import NamedFigure, file_stem
from reports.schema.records import CONTROL
from reports.statistics.intervals import FloatArray
from reports.statistics.weighed import Judged, judge, weighed_errors, weighed_label
from reports.tables.cells import interval


@dataclass(frozen=True, slots=True, eq=False)
class _NormalisedErrors:
    """What a subject claims of one kind: (n,) weighed errors, their degrees of freedom and what is independent."""

    subject: Subject
    kind: str
    expected: int
    ratios: FloatArray
    degrees: FloatArray
    clusters: NDArray[np.generic]

    def judged(self) -> Judged:
        return judge(self.ratios, self.degrees, self.expected, self.clusters)


def _normalised_errors(found: RunComparison) -> Iterator[_NormalisedErrors]:
    """Yield the claims of every subject, kind by kind; the control's are those of the scenario."""
    kinds: dict[str, int] = {}
    tables: dict[str, list[pd.DataFrame]] = {}
    for run in found.runs:
        for weighed in weighed_errors(run):
            kinds[weighed.name] = weighed.expected
            tables.setdefault(weighed.name, []).append(weighed.table.assign(run=run.folder.name))
    for kind, expected in kinds.items():
        weighed_rows = pd.concat(tables[kind], ignore_index=True)
        for subject in found.subjects:
            own = found.of(subject)[[*TRIAL_KEY, "run", "cluster"]].merge(weighed_rows, on=[*TRIAL_KEY, "run"])
            if len(own) and subject.estimator != CONTROL:
                ratios, degrees = (own[name].to_numpy(dtype=np.float64) for name in ("ratio", "degrees"))
                yield _NormalisedErrors(subject, kind, expected, ratios, degrees, own["cluster"].to_numpy())


def consistency_grid(found: RunComparison) -> Grid | None:
    """Tabulate NEES and NIS beside their bands; None where no subject claims a covariance."""
    rows = []
    for one in _normalised_errors(found):
        judged = one.judged()
        rows.append(
            (
                *found.levels(one.subject.names),
                f"{weighed_label(one.kind)} ({one.expected} expected)",
                f"{judged.n}/{one.subject.n}",
                interval(judged.mean),
                f"{number(judged.band.low)} to {number(judged.band.high)}",
                interval(judged.median),
                interval(judged.inside, 100.0),
            )
        )
    heads = (*found.varied, "weighed", "trials", "mean [95 %]", "95 % band", "median [95 %]", "within 95 % [95 %]")
    note = (
        "Squared errors (NEES) and innovations (NIS) weighed by the covariance that the estimator itself claims. Where"
        " it is true the mean of so many trials lies in the band 95 times of 100, and so many per cent of the trials"
        " within the central 95 % of the distribution; a mean above the band tells a covariance that is too small. Of a"
        " filter that gates its innovations, those that it refused are no part of the NIS."
    )
    text = frozenset(range(len(found.varied) + 1))
    return Grid("Covariances", heads, tuple(rows), text, note) if rows else None


def consistency_table(found: RunComparison) -> pd.DataFrame:
    """Tabulate the same as numbers."""
    rows = []
    for one in _normalised_errors(found):
        row: dict[str, object] = dict(zip(found.factors, one.subject.names, strict=True))
        row |= {"weighed": one.kind, "expected": one.expected, "n": one.subject.n}
        for name, value in asdict(one.judged()).items():
            if isinstance(value, dict):
                row |= {name: value["value"], f"{name}_low": value["low"], f"{name}_high": value["high"]}
            else:
                row["n_ok"] = value
        rows.append(row)
    return pd.DataFrame(rows)


def consistency_figures(found: RunComparison) -> Iterator[NamedFigure]:
    """Draw, for each kind of weighed error, how many trials lie within the share that the covariance claims."""
    claims = list(_normalised_errors(found))
    for kind in dict.fromkeys(one.kind for one in claims):
        for group, subjects in subjects_by_group(found).items():
            labels = {one.names: label for label, one in subjects.items()}
            own = [one for one in claims if one.kind == kind and one.subject.names in labels]
            if own:
                yield _consistency_figure(found, group, {labels[one.subject.names]: one for one in own})


def _consistency_figure(found: RunComparison, group: str, claims: Mapping[str, _NormalisedErrors]) -> NamedFigure:
    own = subject_colours(found)
    kind = next(iter(claims.values())).kind
    drawn = [
        CoverageCurve(
            f"{label} (n = {len(one.ratios)})",
            own[one.subject.names],
            one.ratios * one.degrees / one.expected,
            one.degrees,
            len(np.unique(one.clusters)),
        )
        for label, one in claims.items()
    ]
    title = figure_title(found, weighed_label(kind), group)
    return NamedFigure(
        file_stem("consistency", kind, group) if group else file_stem("consistency", kind),
        draw_coverage(drawn, title, credit_lines(found)),
        f"{title}: share of the trials whose weighed square is within the share of its distribution that the covariance"
        " claims; on the diagonal it is true, below it too small. Grey: where 95 % of curves of as many independent"
        " trials as the fewest lie at each abscissa.",
        f"Coverage against claimed coverage for {', '.join(claims)}.",
    )

"""The tables of a comparison."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from boresight.reports.compare.pairs import Contrast
from boresight.reports.compare.subjects import STATISTICS, RunComparison, Subject
from boresight.reports.compare.trials import run_names
from boresight.reports.run.data import TRIAL_KEY
from boresight.reports.run.limits import short_line
from boresight.reports.run.outcomes import MEANING
from boresight.reports.schema.grid import NO_VALUE, Grid, number
from boresight.reports.schema.labels import as_title
from boresight.reports.schema.records import CONTROL, FAILURES_AT_PRIOR
from boresight.reports.statistics.consistency import (
    ConsistencyTest,
    consistency_test,
    normalised_errors,
    normalised_label,
)
from boresight.reports.statistics.measured import Measured
from boresight.reports.tables import chance, interval
from boresight.scenarios.arrays import FloatArray

FAILURES_WORST = "failures-worst"
"""Stage in which a trial without an error counts as worse than any that has one."""
SOLVED = "solved"
_WORDS = {SOLVED: "solved", FAILURES_AT_PRIOR: "failures at prior", FAILURES_WORST: "failures worst"}
_HEADS = ("median", "RMS", "75th", "95th", "99th")


def subject_lines(found: RunComparison, subject: Subject) -> list[tuple[str, tuple[Measured, ...], int]]:
    """List the lines of a subject: how failures count, the statistics and the trials behind them."""
    lines = [(SOLVED, subject.solved, subject.n_ok)]
    if subject.n_ok < subject.n and found.metric.is_error:
        lines.append((FAILURES_AT_PRIOR if subject.at_prior else FAILURES_WORST, subject.counted, subject.n))
    return lines


def subject_grid(found: RunComparison) -> Grid:
    """Tabulate each subject: over the trials that it solved and, where it failed in some, over all."""
    unit, has_prior = _unit(found), found.trials["prior"].notna().any()
    prior = (f"prior{unit}",) if has_prior else ()
    statistics = (f"{name}{unit} [95 %]" for name in _HEADS)
    heads = (*found.varied, "trials", "solved", "success % [95 %]", *prior, *statistics)
    rows = []
    for subject in found.subjects:
        known = found.of(subject)["prior"].dropna()
        before = [number(None if known.empty else float(known.median()))] if has_prior else []
        for how, values, n in subject_lines(found, subject):
            estimates = how == SOLVED and subject.estimator != CONTROL
            success = interval(subject.success, 100.0) if estimates else NO_VALUE
            told = (_WORDS[how], f"{n}/{subject.n}", success, *before)
            rows.append((*found.levels(subject.names), *told, *map(interval, values)))
    note = (
        f"{as_title(found.metric.label)}, with 95 % intervals of whole trials (real images: of whole"
        f" images). {MEANING} Lines of solved trials: those with a number."
    )
    if has_prior:
        note += " Prior: the median error of the trials' priors."
    if found.metric.is_error:
        note += (
            " Failures at prior: every trial, one without an error with that of its prior. Failures worst: every trial,"
            " one without an error worse than any (∞ where the quantile is such)."
        )
    text = frozenset(range(len(found.varied) + 1))
    title = f"{as_title(found.metric.label)}{f', {found.shared}' if found.shared else ''}"
    return Grid(title, heads, tuple(rows), text, note, short_line(*found.runs))


def _unit(found: RunComparison) -> str:
    return f" {found.metric.unit}" if found.metric.unit else ""


def contrast_grid(found: RunComparison) -> Grid | None:
    """Tabulate the differences; None where there are none."""
    if not found.contrasts:
        return None
    is_error, unit = found.metric.is_error, _unit(found)
    order = ("negative is better", "Better", "the better") if is_error else ("negative is less", "Less", "the smaller")
    note = (
        f"Differences trial by trial of the same views, priors or tracks, over the trials that both solved: {order[0]}."
        f" {order[1]}: share of the trials in which the subject is {order[2]} of the two, and p of the sign test."
        " Failures: difference of the failure rates, negative where there are fewer."
        + (" Of all: a failure loses against what did not fail." if is_error else "")
        + " Holm: p corrected for all tests of this table."
    )
    if any(not one.paired for one in found.contrasts):
        note += (
            " Lines marked 'unpaired' compare independent samples: differences of medians and means, the chance that a"
            " trial of the one is better than one of the other, and p of the test of Mann and Whitney; failures by the"
            " method of Newcombe, of Wilson's ends."
        )
    heads = (
        *found.varied, "against", "both ok", f"median difference{unit} [95 %]", f"mean difference{unit} [95 %]",
        "better %", "p", "p (Holm)", "failures % [95 %]", "better % of all", "p of all", "p of all (Holm)",
    )  # fmt: skip
    rows = tuple(
        (
            *found.levels(one.first),
            differing_level(one),
            f"{one.n_both}/{one.n}" if one.paired else f"{one.n_both} and {one.n}, unpaired",
            interval(one.median),
            interval(one.mean),
            interval(Measured(one.better.value), 100.0),
            chance(one.p),
            chance(one.p_holm),
            interval(one.failures, 100.0),
            interval(Measured(one.better_of_all.value), 100.0),
            chance(one.p_of_all),
            chance(one.p_of_all_holm),
        )
        for one in found.contrasts
    )
    whole = Grid("Differences", heads, rows, frozenset(range(len(found.varied) + 1)), note)
    if is_error:
        return whole
    # Numbers that are not errors have no order of better and worse.
    kept = whole.keep(*(name for name in heads if "of all" not in name))
    return replace(kept, columns=tuple(name.replace("better", "less") for name in kept.columns))


def differing_level(one: Contrast) -> str:
    """Return the one level in which the second subject of a contrast differs."""
    return next(b for a, b in zip(one.first, one.second, strict=True) if a != b)


def subject_table(found: RunComparison) -> pd.DataFrame:
    """Tabulate the numbers of the subjects, a row for each statistic."""
    rows = []
    for subject in found.subjects:
        key = dict(zip(found.factors, subject.names, strict=True)) | {"metric": found.metric.name}
        success = {"trials": "all", "statistic": "success rate", "unit": "", **asdict(subject.success)}
        rows.append(key | success | {"n_ok": subject.n_ok, "n": subject.n})
        for how, values, n_ok in subject_lines(found, subject):
            for statistic, measured in zip(STATISTICS, values, strict=True):
                about = {"trials": how, "statistic": statistic.name, "unit": found.metric.unit, **asdict(measured)}
                rows.append(key | about | {"n_ok": n_ok, "n": subject.n})
    return pd.DataFrame(rows)


def contrast_table(found: RunComparison) -> pd.DataFrame:
    """Tabulate the numbers of the differences, a row for each."""
    rows = []
    for one in found.contrasts:
        numbers = {name: value for name, value in asdict(one).items() if name not in ("first", "second")}
        rows.append({"subject": ", ".join(one.first), "against": ", ".join(one.second)} | _flat(numbers))
    return pd.DataFrame(rows)


def _flat(numbers: Mapping[str, object]) -> dict[str, object]:
    """Return values and the ends of their intervals as columns of one row."""
    row: dict[str, object] = {}
    for name, value in numbers.items():
        if isinstance(value, dict):
            row |= {name: value["value"], f"{name}_low": value["low"], f"{name}_high": value["high"]}
        else:
            row[name] = value
    return row


@dataclass(frozen=True, slots=True, eq=False)
class SubjectConsistency:
    """Errors of a subject, normalised by its covariance: (n,) ratios, degrees of freedom and clusters."""

    subject: Subject
    kind: str
    expected: int
    ratios: FloatArray
    degrees: FloatArray
    clusters: NDArray[np.generic]

    def judged(self) -> ConsistencyTest:
        """Evaluate mean, band, median and coverage."""
        return consistency_test(self.ratios, self.degrees, self.expected, self.clusters)


def subject_consistencies(found: RunComparison) -> Iterator[SubjectConsistency]:
    """Yield the normalised errors of every subject, kind by kind, without the control."""
    kinds: dict[str, int] = {}
    tables: dict[str, list[pd.DataFrame]] = {}
    for run, name in zip(found.runs, run_names(found.runs), strict=True):
        for weighed in normalised_errors(run):
            kinds[weighed.name] = weighed.expected
            tables.setdefault(weighed.name, []).append(weighed.table.assign(run=name))
    for kind, expected in kinds.items():
        weighed_rows = pd.concat(tables[kind], ignore_index=True)
        for subject in found.subjects:
            own = found.of(subject)[[*TRIAL_KEY, "run", "cluster"]].merge(weighed_rows, on=[*TRIAL_KEY, "run"])
            if len(own) and subject.estimator != CONTROL:
                ratios, degrees = (own[name].to_numpy(dtype=np.float64) for name in ("ratio", "degrees"))
                yield SubjectConsistency(subject, kind, expected, ratios, degrees, own["cluster"].to_numpy())


def consistency_grid(found: RunComparison) -> Grid | None:
    """Tabulate NEES and NIS with their bands; None where no subject claims a covariance."""
    rows = []
    for one in subject_consistencies(found):
        judged = one.judged()
        rows.append(
            (
                *found.levels(one.subject.names),
                f"{normalised_label(one.kind)} ({one.expected} expected)",
                f"{judged.n}/{one.subject.n}",
                interval(judged.mean),
                f"{number(judged.band.low)} to {number(judged.band.high)}",
                interval(judged.median),
                interval(judged.inside, 100.0),
            )
        )
    heads = (*found.varied, "weighed", "trials", "mean [95 %]", "95 % band", "median [95 %]", "within 95 % [95 %]")
    note = (
        "Squared errors (NEES) and innovations (NIS), normalised by the covariance that the estimator itself claims. If"
        " it is true, the mean over this number of trials lies in the band with a probability of 95 %, and 95 % of the"
        " trials lie within the central 95 % of the distribution. A mean above the band means that the covariance is"
        " too small. Innovations that a filter's own gate rejected are not part of the NIS."
    )
    text = frozenset(range(len(found.varied) + 1))
    return Grid("Covariances", heads, tuple(rows), text, note) if rows else None


def consistency_table(found: RunComparison) -> pd.DataFrame:
    """Tabulate NEES and NIS as numbers."""
    rows = []
    for one in subject_consistencies(found):
        row: dict[str, object] = dict(zip(found.factors, one.subject.names, strict=True))
        row |= {"weighed": one.kind, "expected": one.expected, "n": one.subject.n}
        judged = asdict(one.judged())
        rows.append(row | _flat({"n_ok" if name == "n" else name: value for name, value in judged.items()}))
    return pd.DataFrame(rows)

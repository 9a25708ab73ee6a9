"""The tables of a comparison: printed, and as numbers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace

import pandas as pd

from boresight.reports.compare.pairs import Contrast
from boresight.reports.compare.subjects import STATISTICS, RunComparison, Subject
from boresight.reports.compare.trials import run_names
from boresight.reports.run.data import TRIAL_KEY
from boresight.reports.run.limits import short_line
from boresight.reports.run.outcomes import MEANING
from boresight.reports.schema.grid import NO_VALUE, Grid, number
from boresight.reports.schema.labels import as_title
from boresight.reports.schema.records import CONTROL, FAILURES_AT_PRIOR
from boresight.reports.statistics.consistency import NormalisedErrors, normalised_errors, normalised_label
from boresight.reports.statistics.measured import Measured
from boresight.reports.tables import chance, interval

FAILURES_WORST = "failures-worst"
"""Stage in which a trial without an error counts as worse than any that has one."""
SOLVED = "solved"
_WORDS = {SOLVED: "solved", FAILURES_AT_PRIOR: "failures at prior", FAILURES_WORST: "failures worst"}
_HEADS = ("median", "RMS", "75th", "95th", "99th")


def subject_tables(found: RunComparison) -> tuple[Grid, pd.DataFrame]:
    """Tabulate each subject: over the trials that it solved and, where it failed in some, over all.

    Returns
    -------
    grid, numbers
        The printed table, and a row for each statistic.
    """
    unit, has_prior = _unit(found), found.trials["prior"].notna().any()
    prior = (f"prior{unit}",) if has_prior else ()
    statistics = (f"{name}{unit} [95 %]" for name in _HEADS)
    heads = (*found.varied, "trials", "solved", "success % [95 %]", *prior, *statistics)
    cells, numbers = [], []
    for subject in found.subjects:
        known = found.of(subject)["prior"].dropna()
        before = [number(None if known.empty else float(known.median()))] if has_prior else []
        key = dict(zip(found.factors, subject.names, strict=True)) | {"metric": found.metric.name}
        success = {"trials": "all", "statistic": "success rate", "unit": "", **asdict(subject.success)}
        numbers.append(key | success | {"n_ok": subject.n_ok, "n": subject.n})
        lines = [(SOLVED, subject.solved, subject.n_ok)]
        if subject.n_ok < subject.n and found.metric.is_error:
            lines.append((FAILURES_AT_PRIOR if subject.at_prior else FAILURES_WORST, subject.counted, subject.n))
        for how, values, n in lines:
            estimates = how == SOLVED and subject.estimator != CONTROL
            share = interval(subject.success, 100.0) if estimates else NO_VALUE
            counts = (_WORDS[how], f"{n}/{subject.n}", share, *before)
            cells.append((*found.levels(subject.names), *counts, *map(interval, values)))
            for statistic, measured in zip(STATISTICS, values, strict=True):
                about = {"trials": how, "statistic": statistic.name, "unit": found.metric.unit, **asdict(measured)}
                numbers.append(key | about | {"n_ok": n, "n": subject.n})
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
    title = f"{as_title(found.metric.label)}{f', {found.shared}' if found.shared else ''}"
    grid = Grid(title, heads, tuple(cells), frozenset(range(len(found.varied) + 1)), note, short_line(*found.runs))
    return grid, pd.DataFrame(numbers)


def _unit(found: RunComparison) -> str:
    return f" {found.metric.unit}" if found.metric.unit else ""


def contrast_tables(found: RunComparison) -> tuple[Grid | None, pd.DataFrame]:
    """Tabulate the differences, printed (None where there are none) and as numbers, a row for each."""
    cells, numbers = [], []
    for one in found.contrasts:
        cells.append((
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
        ))  # fmt: skip
        fields = {name: value for name, value in asdict(one).items() if name not in ("first", "second")}
        numbers.append({"subject": ", ".join(one.first), "against": ", ".join(one.second)} | _flat(fields))
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
    grid = Grid("Differences", heads, tuple(cells), frozenset(range(len(found.varied) + 1)), note)
    if not is_error:  # Such numbers have no order of better and worse.
        grid = grid.keep(*(name for name in heads if "of all" not in name))
        grid = replace(grid, columns=tuple(name.replace("better", "less") for name in grid.columns))
    return grid if cells else None, pd.DataFrame(numbers)


def differing_level(one: Contrast) -> str:
    """Return the one level in which the second subject of a contrast differs."""
    return next(b for a, b in zip(one.first, one.second, strict=True) if a != b)


def _flat(numbers: Mapping[str, object]) -> dict[str, object]:
    """Return values and the ends of their intervals as columns of one row."""
    row: dict[str, object] = {}
    for name, value in numbers.items():
        if isinstance(value, dict):
            row |= {name: value["value"], f"{name}_low": value["low"], f"{name}_high": value["high"]}
        else:
            row[name] = value
    return row


def subject_consistencies(found: RunComparison) -> Iterator[tuple[Subject, NormalisedErrors]]:
    """Yield the normalised errors of every subject, kind by kind, without the control; they have a ``cluster`` each."""
    kinds: dict[str, list[NormalisedErrors]] = {}
    for run, name in zip(found.runs, run_names(found.runs), strict=True):
        for kind in normalised_errors(run):
            kinds.setdefault(kind.name, []).append(replace(kind, table=kind.table.assign(run=name)))
    for first, *others in kinds.values():
        whole = pd.concat([one.table for one in (first, *others)], ignore_index=True)
        for subject in found.subjects:
            own = found.of(subject)[[*TRIAL_KEY, "run", "cluster"]].merge(whole, on=[*TRIAL_KEY, "run"])
            if len(own) and subject.estimator != CONTROL:
                yield subject, replace(first, table=own)


def consistency_tables(found: RunComparison) -> tuple[Grid | None, pd.DataFrame]:
    """Tabulate NEES and NIS, printed with their bands (None where no subject claims a covariance) and as numbers."""
    cells, numbers = [], []
    for subject, errors in subject_consistencies(found):
        test = errors.test(errors.table["cluster"].to_numpy())
        cells.append((
            *found.levels(subject.names),
            f"{normalised_label(errors.name)} ({errors.expected} expected)",
            f"{test.n}/{subject.n}",
            interval(test.mean),
            f"{number(test.band.low)} to {number(test.band.high)}",
            interval(test.median),
            interval(test.inside, 100.0),
        ))  # fmt: skip
        row: dict[str, object] = dict(zip(found.factors, subject.names, strict=True))
        row |= {"weighed": errors.name, "expected": errors.expected, "n": subject.n}
        numbers.append(row | _flat({"n_ok" if name == "n" else name: value for name, value in asdict(test).items()}))
    heads = (*found.varied, "weighed", "trials", "mean [95 %]", "95 % band", "median [95 %]", "within 95 % [95 %]")
    note = (
        "Squared errors (NEES) and innovations (NIS), normalised by the covariance that the estimator itself claims. If"
        " it is true, the mean over this number of trials lies in the band with a probability of 95 %, and 95 % of the"
        " trials lie within the central 95 % of the distribution. A mean above the band means that the covariance is"
        " too small. Innovations that a filter's own gate rejected are not part of the NIS."
    )
    grid = Grid("Covariances", heads, tuple(cells), frozenset(range(len(found.varied) + 1)), note)
    return grid if cells else None, pd.DataFrame(numbers)

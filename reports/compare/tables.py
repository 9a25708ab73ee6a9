"""The tables of a comparison: printed, and as numbers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace

import pandas as pd

from boresight.reports.compare.remarks import counted_tests, equal_pairs, pooled_lines
from boresight.reports.compare.subjects import STATISTICS, Contrast, RunComparison, Subject
from boresight.reports.compare.trials import run_names
from boresight.reports.run.data import TRIAL_KEY
from boresight.reports.run.limits import short_line
from boresight.reports.run.outcomes import MEANING
from boresight.reports.schema.grid import NO_VALUE, Grid, number, row_grid
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
    """Tabulate each subject, printed and as numbers, a row for each statistic.

    Lines are over the trials that a subject solved and, where it failed in some, over all.
    """
    unit, has_prior = _unit(found), found.trials["prior"].notna().any()
    rows, numbers = [], []
    for subject in found.subjects:
        known = found.of(subject)["prior"].dropna()
        before = {f"prior{unit}": number(None if known.empty else float(known.median()))} if has_prior else {}
        key = dict(zip(found.factors, subject.names, strict=True)) | {"metric": found.metric.name}
        success = {"trials": "all", "statistic": "success rate", "unit": "", **asdict(subject.success)}
        numbers.append(key | success | {"n_ok": subject.n_ok, "n": subject.n})
        lines = [(SOLVED, subject.solved, subject.n_ok)]
        if subject.n_ok < subject.n and found.metric.error:
            lines.append((FAILURES_AT_PRIOR if subject.at_prior else FAILURES_WORST, subject.counted, subject.n))
        for how, values, n in lines:
            estimates = how == SOLVED and subject.estimator != CONTROL
            share = interval(subject.success, 100.0) if estimates else NO_VALUE
            rows.append(
                found.levels(subject.names)
                | {"trials": _WORDS[how], "solved": f"{n}/{subject.n}", "success % [95 %]": share}
                | before
                | {f"{head}{unit} [95 %]": interval(value) for head, value in zip(_HEADS, values, strict=True)}
            )
            for statistic, measured in zip(STATISTICS, values, strict=True):
                about = {"trials": how, "statistic": statistic.name, "unit": found.metric.unit, **asdict(measured)}
                numbers.append(key | about | {"n_ok": n, "n": subject.n})
    note = (
        f"{as_title(found.metric.label)}, with 95 % intervals of whole trials (real images: of whole"
        f" images). {MEANING} Lines of solved trials: those with a number."
    )
    if has_prior:
        note += " Prior: the median error of the trials' priors."
    if found.metric.error:
        note += (
            " Failures at prior: every trial, one without an error with that of its prior. Failures worst: every trial,"
            " one without an error worse than any (∞ where the quantile is such)."
        )
    note = " ".join(filter(None, (note, pooled_lines(found))))
    title = f"{as_title(found.metric.label)}{f', {found.shared}' if found.shared else ''}"
    return row_grid(title, rows, (*found.varied, "trials"), note, short_line(*found.runs)), pd.DataFrame(numbers)


def _unit(found: RunComparison) -> str:
    return f" {found.metric.unit}" if found.metric.unit else ""


def contrast_tables(found: RunComparison) -> tuple[Grid | None, pd.DataFrame]:
    """Tabulate the differences, printed (None where there are none) and as numbers, a row for each."""
    is_error, unit = found.metric.error, _unit(found)
    order = ("negative is better", "Better", "the better") if is_error else ("negative is less", "Less", "the smaller")
    share, rows, numbers = order[1].lower(), [], []
    for one in found.contrasts:
        row = found.levels(one.first) | {
            "against": differing_level(one),
            "both ok": f"{one.n_both}/{one.n}" if one.paired else f"{one.n_both} and {one.n}, unpaired",
            f"median difference{unit} [95 %]": interval(one.median),
            f"mean difference{unit} [95 %]": interval(one.mean),
            f"{share} %": interval(Measured(one.better.value), 100.0),
            "p": chance(one.p),
            "p (Holm)": chance(one.p_holm),
            "failures % [95 %]": interval(one.failures, 100.0),
        }
        if is_error:  # Other numbers have no order of better and worse.
            row |= {
                "better % of all": interval(Measured(one.better_of_all.value), 100.0),
                "p of all": chance(one.p_of_all),
                "p of all (Holm)": chance(one.p_of_all_holm),
            }
        rows.append(row)
        fields = {name: value for name, value in asdict(one).items() if name not in ("first", "second")}
        numbers.append({"subject": ", ".join(one.first), "against": ", ".join(one.second)} | _flat(fields))
    note = (
        f"Differences trial by trial of the same views, priors or tracks, over the trials that both solved: {order[0]}."
        f" {order[1]}: share of the trials in which the subject is {order[2]} of the two, and p of the sign test."
        " Failures: difference of the failure rates, negative where there are fewer."
        + (" Of all: a failure loses against what did not fail." if is_error else "")
    )
    note = " ".join(filter(None, (note, equal_pairs(found), counted_tests(found))))
    if any(not one.paired for one in found.contrasts):
        note += (
            " Lines marked 'unpaired' compare independent samples: differences of medians and means, the chance that a"
            " trial of the one is better than one of the other, and p of the test of Mann and Whitney; failures by the"
            " method of Newcombe, of Wilson's ends."
        )
    return row_grid("Differences", rows, (*found.varied, "against"), note) if rows else None, pd.DataFrame(numbers)


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
    rows, numbers = [], []
    for subject, errors in subject_consistencies(found):
        test = errors.test(errors.table["cluster"].to_numpy())
        rows.append(found.levels(subject.names) | {
            "weighed": f"{normalised_label(errors.name)} ({errors.expected} expected)",
            "trials": f"{test.n}/{subject.n}",
            "mean [95 %]": interval(test.mean),
            "95 % band": f"{number(test.band.low)} to {number(test.band.high)}",
            "median [95 %]": interval(test.median),
            "within 95 % [95 %]": interval(test.inside, 100.0),
        })  # fmt: skip
        row: dict[str, object] = dict(zip(found.factors, subject.names, strict=True))
        row |= {"weighed": errors.name, "expected": errors.expected, "n": subject.n}
        numbers.append(row | _flat({"n_ok" if name == "n" else name: value for name, value in asdict(test).items()}))
    note = (
        "Squared errors (NEES) and innovations (NIS), normalised by the covariance that the estimator itself claims. If"
        " it is true, the mean over this number of trials lies in the band with a probability of 95 %, and 95 % of the"
        " trials lie within the central 95 % of the distribution. A mean above the band means that the covariance is"
        " too small. Innovations that a filter's own gate rejected are not part of the NIS."
    )
    return row_grid("Covariances", rows, (*found.varied, "weighed"), note) if rows else None, pd.DataFrame(numbers)

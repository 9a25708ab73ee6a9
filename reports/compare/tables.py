"""The tables of a comparison, printed and as numbers, and what limits it."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace

import pandas as pd

from boresight.reports.compare.subjects import (
    MOST_PAIRS,
    STATISTICS,
    Contrast,
    RunComparison,
    Subject,
    has_too_many_pairs,
    one_factor_apart,
)
from boresight.reports.compare.trials import (
    ESTIMATOR,
    KEY,
    NAMES,
    SCENARIO,
    differences,
    is_pooled_control,
    json_text,
    run_names,
)
from boresight.reports.run.data import TRIAL_KEY, RunData
from boresight.reports.run.limits import short_line
from boresight.reports.run.outcomes import MEANING
from boresight.reports.schema.grid import NO_VALUE, Grid, chance, number, row_grid
from boresight.reports.schema.records import CONTROL, FAILURES_AT_PRIOR, as_title, count_of, shortened
from boresight.reports.statistics.consistency import NormalisedErrors, normalised_errors, normalised_label
from boresight.reports.statistics.measured import Measured
from boresight.reports.tables import interval

_MOST_KEYS = 8
_MOST_CHARACTERS = 40


def limits(found: RunComparison) -> Iterator[tuple[str, str]]:
    """Yield names and texts of what limits a comparison: lines for the terminal and for the page."""
    if differing := scenario_differences(found.runs):
        yield "Scenarios differ", differing
    n = sum(len(run.rows) for run in found.runs)
    pooled = sum(int(is_pooled_control(run, found.factors).sum()) for run in found.runs)
    if pooled:
        yield "Left out", f"the {CONTROL}, which is no estimator, as all estimators are pooled"
    if len(found.trials) < n - pooled:
        yield "Left out", f"trials without a crater to go by, {n - pooled - len(found.trials)} of {n - pooled}"
    if reason := not_paired(found):
        yield "Not paired", reason


def scenario_differences(runs: Sequence[RunData]) -> str:
    """Name the keys in which scenarios of the same name differ between runs, with values; '' if none.

    The only scenarios of runs are compared whatever their names. Values are in the order of the runs, and left out if
    they vary between scenarios. Of a section of another kind its kind is named alone.
    """
    if len(runs) < 2:
        return ""
    specs = [run.manifest.scenarios for run in runs]
    names = dict.fromkeys(name for one in specs for name in one)
    shared = [name for name in names if all(name in one for one in specs)]
    rows = [[one[name] for one in specs] for name in shared]
    if all(len(one) == 1 for one in specs):
        rows, shared = [[next(iter(one.values())) for one in specs]], list(names)
    keys: dict[str, set[str]] = {}
    for row in rows:
        whole = [{key: value for key, value in spec.items() if key not in NAMES} for spec in row]
        for key, values in differences(whole):
            keys.setdefault(key, set()).add(
                " and ".join(shortened(json_text(value), _MOST_CHARACTERS) for value in values)
            )
    parts = [
        f"{key} is {''.join(texts)}" if len(texts) == 1 else key
        for key, texts in keys.items()
        if key.endswith(".kind") or f"{key.rpartition('.')[0]}.kind" not in keys
    ]
    if len(parts) > _MOST_KEYS:
        parts = [*parts[:_MOST_KEYS], f"and {count_of(len(parts) - _MOST_KEYS, 'key')} more"]
    if alone := [name for name in names if name not in shared]:
        parts.append(f"not in all runs: {', '.join(alone)}")
    return "; ".join(parts)


def not_paired(found: RunComparison) -> str:
    """Say why lines that differ in one factor have no difference; '' if all have one."""
    named = [one for one in found.subjects if one.estimator != CONTROL]
    pairs = one_factor_apart(found.subjects)
    if len(named) > 1 and not pairs:
        return f"all lines differ in two or more of {', '.join(found.varied)}: give --by with one of them"
    known = {(one.first, one.second) for one in found.contrasts}
    reasons = Counter(
        _reason(found.of(first), found.of(second))
        for first, second in pairs
        if (first.names, second.names) not in known
    )
    if not reasons:
        return ""
    whole = f"{reasons.total()} of {count_of(len(pairs), 'pair')} of lines"
    return f"{whole}: {'; '.join(reasons)}. --unpaired compares them as independent samples"


def _reason(one: pd.DataFrame, other: pd.DataFrame) -> str:
    """Say why two subjects have no trial in common."""
    seed, draws, rest, _ = KEY
    if not set(one[seed]) & set(other[seed]):
        return "their seeds differ"
    if not set(one[draws]) & set(other[draws]):
        keys = _keys(one[draws].iloc[0], other[draws].iloc[0])
        return f"{', '.join(keys)} {_differ(keys)}, so that views, priors or tracks are not the same"
    if not set(one[rest]) & set(other[rest]):
        keys = _keys(one[rest].iloc[0], other[rest].iloc[0]) or [ESTIMATOR]
        return f"{', '.join(keys)} {_differ(keys)} and {'is' if len(keys) == 1 else 'are'} not in --by"
    return "they have no trial in common"


def _keys(one: str, other: str) -> list[str]:
    """List the keys in which two texts of JSON differ; what follows the JSON is ignored."""
    read = json.JSONDecoder().raw_decode
    values = [read(text)[0] if text.startswith("{") else {} for text in (one, other)]
    return [key for key, _ in differences(values)]


def _differ(keys: Sequence[str]) -> str:
    return "differs" if len(keys) == 1 else "differ"


def pooled_lines(found: RunComparison) -> str:
    """Say which estimators and how many scenarios lines pool; '' if none does."""
    parts = []
    for factor in (ESTIMATOR, SCENARIO):
        levels = [found.of(one)[factor].unique() for one in found.subjects]
        if max(map(len, levels)) > 1:
            every = list(dict.fromkeys(str(level) for own in levels for level in own))
            parts.append(f"{factor}s ({', '.join(every) if factor == ESTIMATOR else len(every)})")
    return f"Lines pool the trials of several {' and '.join(parts)}." if parts else ""


def first_alone(found: RunComparison) -> str:
    """Say that each line is compared with the first alone; '' if with all."""
    many = f"More than {MOST_PAIRS:,} pairs: of lines that differ in one factor each is compared with the first alone."
    return many if has_too_many_pairs(found.subjects) else ""


def counted_tests(found: RunComparison) -> str:
    """Say which tests Holm's correction counts; '' if there are none."""
    solved, of_all = ([getattr(one, name) is not None for one in found.contrasts] for name in ("p", "p_of_all"))
    if not any(solved + of_all):
        return ""
    text = f"Holm: p corrected for {count_of(sum(solved + of_all), 'test')}"
    if any(of_all):
        text += f", {sum(solved)} of the trials that both solved (p) and {sum(of_all)} of all trials"
        text += " (p of all, which the terminal leaves out)"
    return f"{text}."


def equal_pairs(found: RunComparison) -> str:
    """Say how many pairs of trials are equal, and so have no better one; '' if none is."""
    ties = [
        f"{found.label(one.first)} against {found.label(one.second)} {one.equal} of {one.n_both}"
        for one in found.contrasts
        if one.equal
    ]
    share = "better" if found.metric.error else "less"
    return f"Equal pairs, which {share} % and p leave out: {'; '.join(ties)}." if ties else ""


FAILURES_WORST = "failures-worst"
"""Stage in which a trial without an error counts as worse than any that has one."""
SOLVED = "solved"
_WORDS = {SOLVED: "solved", FAILURES_AT_PRIOR: "failures at prior", FAILURES_WORST: "failures worst"}
_HEADS = ("median", "RMS", "75th", "95th", "99th")


def subject_tables(found: RunComparison) -> tuple[Grid, pd.DataFrame]:
    """Tabulate each subject, printed and as numbers, a row for each statistic.

    Lines are over the trials that a subject solved and, where it failed in some, over all.
    """
    unit, has_prior = _unit(found), any(one.prior is not None for one in found.subjects)
    rows, numbers = [], []
    for subject in found.subjects:
        before = {f"prior{unit}": number(subject.prior)} if has_prior else {}
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
    note = " ".join(filter(None, (note, first_alone(found), equal_pairs(found), counted_tests(found))))
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
        mean, median, band, inside, *wrong = errors.test(errors.table["cluster"].to_numpy()).values()
        rows.append(found.levels(subject.names) | {
            "weighed": f"{normalised_label(errors.name)} ({errors.expected} expected)",
            "trials": f"{len(errors.table)}/{subject.n}",
            "mean [95 %]": interval(mean),
            "95 % band": f"{number(band.low)} to {number(band.high)}",
            "median [95 %]": interval(median),
            "in 95 %, % [95 %]": interval(inside, 100.0),
            "worse and sure, % [95 %]": interval(wrong[0], 100.0) if wrong else NO_VALUE,
        })  # fmt: skip
        row: dict[str, object] = dict(zip(found.factors, subject.names, strict=True))
        row |= {"weighed": errors.name, "expected": errors.expected, "n": subject.n}
        parts = dict(
            zip(("mean", "median", "band", "inside", "wrong"), (mean, median, band, inside, *wrong), strict=False)
        )
        numbers.append(row | {"n_ok": len(errors.table)} | _flat({name: asdict(part) for name, part in parts.items()}))
    note = (
        "Squared errors (NEES) and innovations (NIS), normalised by the covariance that the estimator itself claims. If"
        " it is true, the mean over this number of trials lies in the band with a probability of 95 %, and 95 % of the"
        " trials lie in the ellipsoid that should hold them. Worse and sure are poses that are worse than the prior"
        " with a NEES of five times the expected one. A mean above the band means that the covariance is too small."
        " Innovations that a filter's own gate rejected are not part of the NIS."
    )
    return row_grid("Covariances", rows, (*found.varied, "weighed"), note) if rows else None, pd.DataFrame(numbers)

"""Limits of a comparison: scenarios that differ, lines that pool trials or are not paired, and the tests that count."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Sequence

import pandas as pd

from boresight.reports.compare.subjects import RunComparison, one_factor_apart
from boresight.reports.compare.trials import (
    ESTIMATOR,
    KEY,
    NAMES,
    SCENARIO,
    differences,
    is_pooled_control,
    json_text,
)
from boresight.reports.run.data import RunData
from boresight.reports.schema.labels import count_of
from boresight.reports.schema.records import CONTROL

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
            keys.setdefault(key, set()).add(" and ".join(map(_short, values)))
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


def _short(value: object) -> str:
    text = json_text(value)
    return text if len(text) <= _MOST_CHARACTERS else f"{text[: _MOST_CHARACTERS - 3]}..."


def not_paired(found: RunComparison) -> str:
    """Say why lines that differ in one factor have no difference; '' if all have one."""
    named = [one for one in found.subjects if one.estimator != CONTROL]
    pairs = list(one_factor_apart(found.subjects))
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

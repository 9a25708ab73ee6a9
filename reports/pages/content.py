"""Content of a report: records, verdicts and notes, computed once for all formats."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from os import PathLike
from pathlib import Path

import pandas as pd

from boresight.reports.compare.subjects import Subject, subject_of
from boresight.reports.compare.trials import ESTIMATOR, choose_metric, tabulate_trials, trial_numbers
from boresight.reports.kinds import Content, report_kind
from boresight.reports.kinds.pooled import ONLY_ERRORS, WHERE, cell_records, is_huge, is_wide
from boresight.reports.kinds.sequence import without_pooled
from boresight.reports.published import Comparison, load_published
from boresight.reports.run.clusters import clusters_of, image_set
from boresight.reports.run.data import RunData, read_run
from boresight.reports.run.limits import database_line, known_lines
from boresight.reports.run.outcomes import unsolved_lines
from boresight.reports.schema.column import Measure
from boresight.reports.schema.grid import NO_VALUE, WITHOUT_VALUE, number
from boresight.reports.schema.records import CONTROL, Record, count_of
from boresight.reports.schema.tables import kind_schema
from boresight.reports.statistics.consistency import consistency_records, nees_of_all
from boresight.reports.statistics.measured import MEAN, MEDIAN, measure, measure_run
from boresight.reports.statistics.paired import paired_records
from boresight.reports.statistics.requirements import read_requirement
from boresight.reports.statistics.roc import outlier_records
from boresight.reports.tables import interval
from boresight.reports.verdicts import (
    ComparedClaim,
    ComparedValue,
    compare,
    compare_claims,
    on_embedded_body,
    verdict_tally,
)
from boresight.scenarios.errors import BoresightError

_MOST_IN_HEADLINE = 3
_MOST_COVARIANCES = 12


def notes(run: RunData, comparison: Comparison | None) -> Iterator[str]:
    """Yield the notes in the order of the report: what the run is, how its numbers are made, what is not there."""
    yield from filter(None, [run.manifest.description])
    for name, spec in run.manifest.scenarios.items() if run.manifest.grid is None else ():
        if spec.get("description"):
            yield f"Scenario {name}: {spec['description']}"
    yield from known_lines(run)
    done, total = run.progress()
    if done < total:
        yield f"The run is not finished: {done} of {total} trials."
    yield from unsolved_lines(run)
    yield (
        "Intervals are of 95 %: of medians and percentiles between order statistics, of means by the studentised"
        " bootstrap (2,000 resamples of whole trials or, for real images, of whole images, because the noise"
        " realisations of one image are not independent), of fewer than ten by Student's t. The intervals of an RMS of"
        " few trials, some far worse than the others, cover the true value less often than 95 %. Percentiles beyond"
        f" which less than one trial is expected are left out. {NO_VALUE!r} in a table is {WITHOUT_VALUE}."
    )
    yield from filter(None, [database_line(run)])
    scenarios = [name for name in dict.fromkeys(run.rows["scenario"]) if image_set(run.manifest.scenarios[name])]
    if scenarios:
        starts = len(run.rows.loc[run.rows["scenario"].isin(scenarios), ["scenario", "trial"]].drop_duplicates())
        sets = len({image_set(run.manifest.scenarios[name]) for name in scenarios})
        yield (
            f"{count_of(sets, 'set')} of images (one for each body and texture), {count_of(starts, 'start')}."
            " The starts on one set share the errors of its features: intervals and sign tests take the set for what"
            " is independent, and one set by itself has no interval."
        )
    posed = bool(run.posed_pairs())
    if posed:
        yield (
            "Position error is the difference of camera positions in the body frame, its components turned into the"
            " true camera's axes. Failed trials have no error: statistics after a stage are over the trials that"
            " reached it, beside their number, and the line 'failures at prior' counts every trial."
        )
    elif kind_schema(run.manifest.experiment).frames:
        yield (
            "Position error is that of the camera about the body, in inertial axes. A trial that failed has no error"
            " from the frame on at which it ended: statistics after a revolution are over the trials that came so far,"
            " beside their number."
        )
    drawn = [spec["images"].get("rendered", False) for spec in run.manifest.scenarios.values() if spec.get("images")]
    if not all(drawn):
        yield (
            f"These are real images{', but for the scenarios with images.rendered' if any(drawn) else ''}. The pose"
            " that they are scored against is itself an estimate, and so is every further reference pose: neither is"
            " exact truth, and each error below contains the reference's own error."
        )
    if comparison is not None:
        yield f"Published values: {comparison.source}. {comparison.conditions}"
        yield f"Bounds of the verdicts: {comparison.bounds}"
    if is_wide(run):
        yield (
            f"The grid has {len(run.manifest.scenarios):,} scenarios and {len(run.pairs()):,} cells of a scenario with"
            f" an estimator. A page cannot show each: {WHERE}. Figures of single scenarios are left out."
            f"{ONLY_ERRORS if is_huge(run) else ''}"
        )
    absent = [name for name in ("stages", "landmarks", "timings") if run.table(name).empty]
    if posed and absent:
        yield f"Not stored in this run, so left out: {', '.join(absent)}."
    yield from run.manifest.notes


def read_content(folder: Path) -> Content:
    """Read a run folder and compute the content of its report.

    Raises `BoresightError` if the folder is not a run, holds no finished trial, or names unknown published values.
    """
    return content_of(read_run(folder))


def content_of(run: RunData) -> Content:
    """Compute the content of the report of a run; raise `BoresightError` if it names unknown published values."""
    comparison = load_published(run.manifest.report) if run.manifest.report else None
    if is_huge(run):
        records = tuple(cell_records(run))
    else:
        own = report_kind(run).records(run, comparison)
        records = (*measure_run(run), *own, *outlier_records(run), *paired_records(run), *consistency_records(run))
    compared, claims = beside_published(run, records, comparison) if comparison else ((), ())
    return Content(run, records, comparison, compared, claims, tuple(notes(run, comparison)))


def summary(folder: str | PathLike[str]) -> pd.DataFrame:
    """Compute every number of a run's report, as its table.csv has them: one row each, with n_ok, n and interval.

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
    """Compare published values and orders with ours; of pooled sets of images, with the pool alone."""
    judged = without_pooled(run, records)
    compared, claims = compare(judged, comparison), compare_claims(judged, comparison)
    if run.manifest.embedded:
        return tuple(map(on_embedded_body, compared)), tuple(map(on_embedded_body, claims))
    return compared, claims


def estimator_results(run: RunData) -> tuple[Measure, list[Subject]]:
    """Measure the median of each estimator over all scenarios, by the one measure with a required limit or the usual.

    Raises `BoresightError` if the trials have no number to go by.
    """
    asked = {read_requirement(one.that, run.manifest.experiment) for one in run.manifest.requirements}
    limited = {one.measure for one in asked if one.limit is not None} & trial_numbers(run).keys()
    metric = choose_metric(limited.pop() if len(limited) == 1 else None, [run])
    trials = tabulate_trials([run], metric, (ESTIMATOR,))
    own = trials[trials[ESTIMATOR] != CONTROL].groupby(ESTIMATOR, sort=False)
    return metric, [subject_of(rows, (str(label),), (MEDIAN,)) for label, rows in own]


def headline(run: RunData) -> str:
    """Write the result of each estimator on one line; '' where trials have no number to go by."""
    try:
        metric, found = estimator_results(run)
    except BoresightError:
        return ""
    if len(found) > _MOST_IN_HEADLINE:
        return f"{len(found)} estimators: see the table"
    unit = f" {metric.unit}" if metric.unit else ""
    parts: list[str] = []
    for one in found:
        solved = f"{one.estimator}: solved {one.n_ok}/{one.n}"
        median = f"median {'' if parts else f'{metric.label} '}{interval(one.solved[0])}{unit}"
        if one.prior is None:
            parts.append(f"{solved}, {median}")
        else:
            # The share of n trials, made a number of trials again.
            success = round(one.n * (one.success.value or 0.0))
            parts.append(f"{solved}, success {success}/{one.n}, {median}, prior {number(one.prior)}{unit}")
    several = len(run.manifest.scenarios)
    return "; ".join(parts) + (f"; over {several} scenarios" if parts and several > 1 else "")


def covariance_line(run: RunData) -> str:
    """Say of each estimator's covariances on one line whether they hold; '' without any."""
    found = nees_of_all(run)
    if not 0 < len(found) <= _MOST_COVARIANCES:
        return "see the table of consistency" if found else ""
    parts = []
    for name, own in found.items():
        mean = measure(own["ratio"].to_numpy(), clusters_of(run, own), (MEAN,))[0]
        small, large = mean.low is not None and mean.low > 1.0, mean.high is not None and mean.high < 1.0
        parts.append(f"{name} {interval(mean)}{', too small' if small else ', too large' if large else ''}")
    return f"mean NEES over the expected one (1 where they hold): {'; '.join(parts)}"


def verdict_counts(content: Content) -> str:
    """Count the verdicts on published values and claims, in words; '' if there are none."""
    values, claims = ([one.verdict for one in found] for found in (content.compared, content.claims))
    return verdict_tally([*values, *claims])

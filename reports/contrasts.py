"""Mean errors of sequences against each other: ratios between estimators, and the reductions that a paper prints.

Trials are resampled whole, both errors of a trial together, so that what two estimators have in common cancels.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import permutations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from reports.measures import REDUCTION, Record, unit_of
from reports.published import Comparison, PublishedValue
from reports.run_data import RunData, select
from reports.statistics import LEVEL, MEAN, RESAMPLES, Measured, content_rng

FloatArray = NDArray[np.float64]
Pair = tuple[str, str]
"""Scenario and estimator."""

RATIO = "ratio"
"""Stage of a mean error over that of another estimator, which the ``reference`` names."""
_ERRORS = {"error_after_1_ratio": "error_after_1_m", "error_after_2_ratio": "error_after_2_m"}


def ratio_records(run: RunData) -> Iterator[Record]:
    """Set the mean error of every estimator of sequences over that of every other one, on the same trials."""
    if run.epochs.empty:
        return
    for scenario in dict.fromkeys(scenario for scenario, _ in run.pairs()):
        labels = [name for where, name in run.pairs() if where == scenario]
        for one, other in permutations(labels, 2):
            for name, error in _ERRORS.items():
                record = _contrast(run, ((scenario, one), (scenario, other)), error, (RATIO, other, name), _ratio)
                if record.n_ok:
                    yield record


def reduction_records(run: RunData, comparison: Comparison) -> Iterator[Record]:
    """Work out the reductions that a paper prints: ``100 (1 - mean(e) / mean(e'))``.

    The trials of two scenarios are not the same tracks: resampling them together is one way of pairing what is
    independent.
    """
    for published in comparison.values:  # noqa: PD011  a tuple of published values, not a table
        if published.stage == REDUCTION:
            for one, other in _contrasted(run, published):
                error = f"{published.measure.removesuffix('_reduction')}_m"
                yield _contrast(run, (one, other), error, (REDUCTION, published.against, published.measure), _reduction)


def _contrasted(run: RunData, published: PublishedValue) -> Iterator[tuple[Pair, Pair]]:
    """List what is set against what: another scenario, or another estimator on the same one."""
    scenarios = {scenario for scenario, _ in run.pairs()}
    for scenario, estimator in run.pairs():
        if estimator == published.estimator and published.scenario in ("", scenario):
            other = (published.against, estimator) if published.against in scenarios else (scenario, published.against)
            if other in run.pairs():
                yield (scenario, estimator), other


def _contrast(
    run: RunData, pairs: tuple[Pair, Pair], error: str, said: tuple[str, str, str], of_means: Callable[..., FloatArray]
) -> Record:
    """Evaluate ``of_means`` over the trials of which both have an error; ``said``: stage, reference and measure."""
    both = pd.concat([select(run.rows, *pair).set_index("trial")[error] for pair in pairs], axis=1, join="inner")
    errors = both.dropna().to_numpy(dtype=np.float64)
    measured = _measured(errors, of_means) if len(errors) > 1 else Measured(None)
    (scenario, estimator), (stage, reference, name) = pairs[0], said
    return Record(
        scenario, estimator, stage, reference, name, unit_of(name), MEAN.name, measured.value, measured.low,
        measured.high, len(errors), len(both),
    )  # fmt: skip


def _measured(errors: FloatArray, of_means: Callable[..., FloatArray]) -> Measured:
    rng = content_rng(errors)
    drawn = of_means(errors[rng.integers(0, len(errors), size=(RESAMPLES, len(errors)))].mean(axis=1))
    low, high = np.percentile(drawn, [50.0 * (1.0 - LEVEL), 50.0 * (1.0 + LEVEL)])
    return Measured(float(of_means(errors.mean(axis=0))), float(low), float(high))


def _ratio(means: FloatArray) -> FloatArray:
    return np.asarray(means[..., 0] / means[..., 1], dtype=np.float64)


def _reduction(means: FloatArray) -> FloatArray:
    return np.asarray(100.0 * (1.0 - _ratio(means)), dtype=np.float64)

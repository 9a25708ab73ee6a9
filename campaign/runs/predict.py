"""Linear covariance of a campaign, from geometry and declared errors without images."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.runs.execute import build_products
from boresight.campaign.runs.manifest import RunRequest
from boresight.campaign.trial.kind import PerDatabase, Prediction, Record, WorkerContext, kind_named
from boresight.campaign.trial.score import MEASURES, measured_errors
from boresight.reports.run.clusters import clusters_of
from boresight.reports.run.data import RunData
from boresight.reports.statistics.intervals import Interval, interval_of_sums
from boresight.scenarios.errors import BoresightError, MachineError, text_of

_TOLD = 100
"""Scenarios after which progress is told."""
STATED = {"position_m": "position_sigma_m", "attitude_deg": "attitude_sigma_deg"}
"""Columns of a run with the RMS errors that the estimator states, by the measure."""


def with_predictors(campaign: ResolvedCampaign, wanted: Sequence[str] = ()) -> tuple[ResolvedCampaign, list[str]]:
    """Keep the estimators of a campaign that predict, of those with the labels ``wanted`` or of all.

    Also return the labels of the others. Raise BoresightError if a label is unknown, or no estimator is left.
    """
    kind, name = kind_named(campaign.spec.experiment), campaign.spec.name
    if unknown := [label for label in wanted if label not in campaign.labels]:
        raise BoresightError(
            f"--estimator {unknown[0]}: {name} has no such estimator; there are: {', '.join(campaign.labels)}"
        )
    asked = [entry for entry in campaign.spec.estimators if not wanted or entry.label in wanted]
    able = [entry for entry in asked if kind.predicts(entry)]
    others = [entry.label for entry in asked if entry not in able]
    if not able:
        raise BoresightError(
            f"{name}: no covariance can be predicted for {', '.join(others)}: the estimator has no method predict;"
            " run the campaign"
        )
    return replace(campaign, spec=campaign.spec.model_copy(update={"estimators": able})), others


def predict_errors(campaign: ResolvedCampaign, trials: int, folder: Path, tell: Callable[[str], None]) -> pd.DataFrame:
    """Predict the errors of all estimators of a campaign, which `with_predictors` returned, in the views of its trials.

    The views are drawn as in a run, so that predictions and rows of the same seed are pairs. Products are built in
    ``folder``. The result has a row for each scenario, trial and estimator, with RMS errors by `MEASURES` (NaN: none,
    or the geometry allows no estimate) and the processor time ``seconds``, without that of the draw.
    """
    build_products(campaign, RunRequest(folder, trials, jobs=1), tell)
    compiled: set[str] = set()
    context = WorkerContext(folder, 1, keep_images=False)
    records: list[Record] = []
    for number, scenario in enumerate(campaign.scenarios, 1):
        drawn = PerDatabase.open(campaign, scenario, context)
        for trial in range(trials):
            predictors = drawn.of(trial).predictors(trial)
            for label in campaign.labels:
                key: Record = {"scenario": scenario.spec.name, "estimator": label, "trial": trial}
                predict = predictors.get(label, lambda: None)
                if label not in compiled:
                    _predicted(predict, key)  # compiles, which is no part of the time
                    compiled.add(label)
                began = time.process_time()
                found = _predicted(predict, key)
                records.append({**key, **(found or {}), "seconds": time.process_time() - began})
        if number % _TOLD == 0 and number < len(campaign.scenarios):
            tell(f"{number} of {len(campaign.scenarios)} scenarios predicted")
    return pd.DataFrame(records, columns=["scenario", "estimator", "trial", *MEASURES, "seconds"])


def _predicted(predict: Prediction, key: Record) -> Mapping[str, float] | None:
    """Predict; raise BoresightError if the estimator raises, or returns no covariance."""
    try:
        return predict()
    except (KeyboardInterrupt, MachineError):
        raise
    except Exception as error:
        where = f"{key['scenario']}, {key['estimator']}, trial {key['trial']}"
        raise BoresightError(f"{where}: predict of the estimator failed: {text_of(error)}") from error


@dataclass(frozen=True, slots=True)
class PredictedError:
    """RMS of a measure over the trials of an estimator in a scenario.

    ``predicted`` is over ``n`` of ``trials`` trials with a prediction, and ``seconds`` the median processor time. With
    rows of a run: ``error`` and ``stated`` are over its ``n_ok`` successful trials among these, ``ratio`` is the RMS
    error over the RMS prediction of the same trials, with its 95 % interval. None: not known.
    """

    scenario: str
    estimator: str
    measure: str
    trials: int
    n: int
    predicted: float
    seconds: float
    n_ok: int = 0
    error: float | None = None
    stated: float | None = None
    ratio: float | None = None
    interval: Interval = (None, None)


def tabulate(found: Sequence[PredictedError], campaign: ResolvedCampaign, compared: bool) -> pd.DataFrame:
    """Tabulate predictions, a row for each scenario, estimator and error, with the levels of a campaign's grid.

    Columns: ``scenario``, the axes of the grid by name (one called as another column with ``_level`` behind it),
    ``estimator``, ``error`` (of `MEASURES`, with the unit at its end), ``predicted`` (RMS, NaN without a prediction),
    ``n`` of ``trials``, ``cpu_s`` of a trial; if they are ``compared``, ``n_ok``, ``rms_error``, ``rms_stated``,
    ``ratio``, ``ratio_low`` and ``ratio_high``.
    """
    rows = []
    for one in found:
        row: Record = {"scenario": one.scenario, "estimator": one.estimator, "error": one.measure}
        row |= {"predicted": one.predicted, "n": one.n, "trials": one.trials, "cpu_s": one.seconds}
        if compared:
            low, high = one.interval
            row |= {"n_ok": one.n_ok, "rms_error": one.error, "rms_stated": one.stated}
            row |= {"ratio": one.ratio, "ratio_low": low, "ratio_high": high}
        rows.append(row)
    table = pd.DataFrame(rows)
    axes = () if campaign.spec.grid is None else tuple(campaign.spec.grid.axes)
    for place, axis in enumerate(axes, 1):
        levels = {name: own.levels[axis] for name, own in campaign.variations.items()}
        table.insert(place, f"{axis}_level" if axis in table else axis, table["scenario"].map(levels))
    return table


def summarise(predicted: pd.DataFrame, run: RunData | None = None) -> Iterator[PredictedError]:
    """Pool predictions over trials, and compare them with a run of the same trials."""
    for (scenario, estimator), group in predicted.groupby(["scenario", "estimator"], sort=False):
        for measure in MEASURES:
            known = group[group[measure].notna()]
            if len(known) or measure == MEASURES[0]:
                one = PredictedError(
                    str(scenario), str(estimator), measure, len(group), len(known),
                    _rms(known[measure]), float(group["seconds"].median()),
                )  # fmt: skip
                yield one if run is None else _compared(one, known, run)


def _compared(one: PredictedError, known: pd.DataFrame, run: RunData) -> PredictedError:
    """Add the errors of the rows of the same scenario, estimator and trials."""
    own = run.of(one.scenario, one.estimator)
    own = own[own["status"] == "ok"]
    scored = ((row["trial"], measured_errors(row)) for row in own.to_dict("records"))
    errors = {int(trial): found[one.measure] for trial, found in scored if one.measure in found}
    pairs = known[known["trial"].isin(errors)].assign(error=lambda some: some["trial"].map(errors))
    if not len(pairs):
        return one
    squares = np.square(pairs[["error", one.measure]].to_numpy(dtype=np.float64))
    interval = interval_of_sums(
        squares, clusters_of(run, pairs), lambda sums: np.sqrt(sums[:, 0] / sums[:, 1]), positive=True
    )
    total, column = squares.sum(axis=0), STATED.get(one.measure)
    stated = own[own["trial"].isin(pairs["trial"])].get(column, pd.Series(dtype=np.float64)).dropna()
    return replace(
        one, n_ok=len(pairs), error=_rms(pairs["error"]), stated=_rms(stated) if len(stated) else None,
        ratio=float(np.sqrt(total[0] / total[1])), interval=interval,
    )  # fmt: skip


def _rms(values: pd.Series) -> float:
    return float(np.sqrt(np.mean(np.square(values.to_numpy(dtype=np.float64))))) if len(values) else float("nan")

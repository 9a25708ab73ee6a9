"""Which cases of a stored run are the worst; a failure is worse than any error."""

from __future__ import annotations

import numpy as np
import pandas as pd

from campaign.inspection.case import CONTROLS, Case, Choice, cases_of, chosen_rows
from reports.compare.metrics import N_FINDABLE, Metric, choose_metric, detection_counts, metric_names, metric_values
from reports.run.data import TRIAL_KEY, RunData, in_order_of

ORDER = "estimators that raised, then failures by their prior error, then solved trials by"
MISSED_OR_WRONG = "n_missed_or_wrong"
"""Craters that a trial missed and those that it made up or mixed up: what detection and matching are ranked by."""


def worst_cases(run: RunData, count: int, choice: Choice, metric: str | None) -> tuple[list[Case], str]:
    """Rank the trials of a run, the worst first.

    Estimators that raised come first, then failures, both with the largest prior error before others, then solved
    trials without the number, then those with the largest. Ties go by trial. Controls are left out unless asked for.

    Returns
    -------
    cases
        ``count`` of them, or all where there are fewer.
    name
        Of the number that they are ranked by.
    """
    rows = run.rows.reset_index(drop=True)
    values, name = _badness(run, metric)
    ranked = rows.assign(_badness=values.abs().to_numpy())
    ranked = chosen_rows(ranked, choice, str(run.folder))
    others = ranked[~ranked["estimator"].isin(CONTROLS)]
    if choice.estimator is None and not others.empty:
        ranked = others
    solved = ranked["status"] == "ok"
    rank = ranked["status"].map({"error": 0, "failed": 1}).fillna(2)
    number = np.where(solved, ranked["_badness"], ranked["prior_position_error_m"].astype(float))
    # What has no number cannot be called good: it stands before the others of its kind.
    ranked = ranked.assign(_rank=rank, _number=np.nan_to_num(number, nan=np.inf))
    ranked = ranked.sort_values(["_rank", "_number", "trial"], ascending=[True, False, True], kind="stable")
    return cases_of(ranked.head(count)), name


def _badness(run: RunData, metric: str | None) -> tuple[pd.Series, str]:
    """Return the number of each row that trials are ranked by, in the order of rows, and its name."""
    faults = crater_faults(run)
    if faults is not None and metric in (None, MISSED_OR_WRONG):
        return faults, MISSED_OR_WRONG
    if metric is None and not metric_names(run):
        return pd.Series(np.nan, index=run.rows.index), "nothing: no trial has a number"
    chosen: Metric = choose_metric(metric, [run])
    return metric_values(run, chosen), chosen.name


def crater_faults(run: RunData) -> pd.Series | None:
    """Count missed and wrong craters of each row; None in a run that is not about craters in images."""
    if not run.table("crater_matches").empty:
        matched = run.table("crater_matches")
        counted = matched.assign(faults=matched["n_missed"] + matched["n_wrong"])
    elif not run.table("crater_images").empty:
        counts = detection_counts(run)
        counted = counts.assign(faults=counts[N_FINDABLE] - counts["n_hits"] + counts["n_false"])
    else:
        return None
    return pd.Series(in_order_of(run.rows, counted.set_index(TRIAL_KEY)["faults"]), index=run.rows.index)

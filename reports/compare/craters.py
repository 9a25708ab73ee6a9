"""What each trial of crater detection and matching comes to: shares missed and wrong, and errors of centres."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from reports.run.data import TRIAL_KEY, RunData, in_order_of
from reports.schema.kinds.crater_detection import CENTRE_ERROR, COMMON_CENTRE_ERROR, FALSE_ALARMS, MISSED
from reports.schema.kinds.crater_matching import MATCHING, WRONG

N_FINDABLE = "n_there"
"""Craters that there were to be found, or matched."""


def crater_numbers(run: RunData) -> Mapping[str, pd.DataFrame]:
    """Return the numbers of a run that is about craters in images, by their names; none of another run.

    Each is a column of a table with a row for each trial and method (`TRIAL_KEY`), beside `N_FINDABLE`. A share of nothing
    is NaN: that of false alarms where no detection is false or of a detectable crater, that of missed craters where
    there are none.
    """
    if not run.table("crater_matches").empty:
        matched = run.table("crater_matches")
        made, common = matched["n_correct"] + matched["n_wrong"], matched["n_common"]
        shares = {MISSED: _percent(matched["n_missed"], common), WRONG: _percent(matched["n_wrong"], made)}
        return dict.fromkeys(MATCHING, matched.assign(**shares, **{N_FINDABLE: common}))
    if not run.table("crater_images").empty:
        counts = detection_counts(run)
        missed, false = counts[N_FINDABLE] - counts["n_hits"], counts["n_false"]
        shares = {MISSED: _percent(missed, counts[N_FINDABLE]), FALSE_ALARMS: _percent(false, false + counts["n_hits"])}
        numbers = dict.fromkeys((MISSED, FALSE_ALARMS, CENTRE_ERROR), counts.assign(**shares))
        return numbers | {COMMON_CENTRE_ERROR: _common_centres(run)}
    return {}


def detection_counts(run: RunData) -> pd.DataFrame:
    """Count the detections of each image that reach the detector's own threshold.

    Returns
    -------
    counts
        A row for each row of the run: `TRIAL_KEY`, `N_FINDABLE` (detectable craters), ``n_kept`` (detections), ``n_hits``
        (detectable craters found), ``n_false`` (detections that are no crater) and `CENTRE_ERROR` of the hits.
    """
    found = run.table("detections")[run.table("detections")["kept"].astype(bool)]
    hits = found[found["detectable"].astype(bool)]
    rows = run.rows[TRIAL_KEY].merge(
        run.table("crater_images")[["scenario", "trial", "n_detectable"]], on=["scenario", "trial"]
    )
    tables = {"n_kept": found, "n_hits": hits, "n_false": found[found["crater"] < 0]}
    counted = {name: _count(rows, table) for name, table in tables.items()}
    centre = in_order_of(rows, hits.groupby(TRIAL_KEY)[CENTRE_ERROR].median())
    return rows.rename(columns={"n_detectable": N_FINDABLE}).assign(**counted, **{CENTRE_ERROR: centre})


def _common_centres(run: RunData) -> pd.DataFrame:
    """Return `TRIAL_KEY`, `N_FINDABLE` (detectable craters that all methods found) and `COMMON_CENTRE_ERROR` of them."""
    found = run.table("detections")
    hits = found[found["kept"].astype(bool) & found["detectable"].astype(bool)]
    methods = run.rows.groupby("scenario")["estimator"].nunique()
    finders = hits.groupby(["scenario", "trial", "crater"])["estimator"].transform("nunique")
    common = hits[finders == hits["scenario"].map(methods)]
    centre = in_order_of(run.rows, common.groupby(TRIAL_KEY)[CENTRE_ERROR].median())
    return run.rows[TRIAL_KEY].assign(**{N_FINDABLE: _count(run.rows, common), COMMON_CENTRE_ERROR: centre})


def _count(rows: pd.DataFrame, table: pd.DataFrame) -> NDArray[np.float64]:
    """Count the lines of a table that belong to each row."""
    return np.nan_to_num(in_order_of(rows, table.groupby(TRIAL_KEY).size()), nan=0.0)


def _percent(part: pd.Series, whole: pd.Series) -> pd.Series:
    return 100.0 * part / whole.where(whole > 0)

"""The pose errors after each stage of an estimator, as the tables of a run hold them."""

from __future__ import annotations

import pandas as pd

from reports.run.data import RunData, select
from reports.schema.common import POSE_COLUMNS
from reports.schema.records import CONTROL


def final_stage(run: RunData, scenario: str, estimator: str) -> str:
    """Name the last stage that the estimator reports; its errors are those of the rows."""
    names = select(run.table("stages"), scenario, estimator)["stage"].unique()
    return str(names[-1]) if len(names) and names[-1] != CONTROL else "final"


def errors_by_stage(run: RunData, scenario: str, estimator: str) -> dict[str, pd.DataFrame]:
    """Collect pose errors (trial, POSE_COLUMNS) of the prior, each stage and the final estimate, in order.

    The prior is known for every trial, a stage for the trials that reached it, the final estimate for
    those that are ok.
    """
    rows = select(run.rows, scenario, estimator)
    prior = rows[["trial"]].assign(**{name: rows[f"prior_{name}"] for name in POSE_COLUMNS})
    stages = select(run.table("stages"), scenario, estimator)
    last = final_stage(run, scenario, estimator)
    between = [name for name in stages["stage"].unique() if name not in (CONTROL, last)]
    columns = ["trial", *POSE_COLUMNS]
    found = {CONTROL: prior} | {name: stages.loc[stages["stage"] == name, columns] for name in between}
    if estimator != CONTROL:
        found[last] = rows.loc[rows["status"] == "ok", columns]
    return found

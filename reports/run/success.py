"""What a success is: one definition for reports, the terminal, comparisons and trade-offs."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

MEANING = (
    "Solved: trials with an estimate. Success: those of them whose position error is not above that of their prior,"
    " where there is a prior."
)
"""Says in a table's note what its two counts are."""


def succeeded(rows: pd.DataFrame) -> NDArray[np.bool_]:
    """Tell which trials succeeded: an estimate, with a position error that is not above that of the trial's own prior.

    A trial has a prior where its row holds the prior's error: single images and pose convergence. In others the
    estimate alone decides, for there is nothing that the spacecraft would have without it: of sequences (dead reckoning
    is an estimator beside the others, and one more line), of orbits (the a priori orbit is as wrong as the scenario
    makes it), of images of craters and of data bases.
    """
    worse = rows["position_error_m"].to_numpy() > rows["prior_position_error_m"].to_numpy()
    return np.asarray((rows["status"] == "ok").to_numpy() & ~worse)

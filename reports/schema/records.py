"""One line of the tidy table of a report: what was measured, over how many trials, how well it is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

CONTROL = "prior"
"""Name of the control estimator, and of the stage before anything was estimated."""
FAILURES_AT_PRIOR = "failures-at-prior"
"""Stage in which a trial without an estimate counts with the error of its prior."""
DERIVED = "derived"
"""Stage of what follows from the scenario alone."""
DIAGNOSTICS = "diagnostics"
"""Stage of the numbers that an estimator reports beside its pose."""
SEQUENCE = "sequence"
"""Stage of what a trial of a sequence comes to."""
REDUCTION = "reduction"
"""Stage of what an error comes down by from one scenario or estimator, which the ``reference`` names, to another."""
RATIO = "ratio"
"""Stage of a mean over that of another estimator, which the ``reference`` names."""
UNITS = {
    "position_error_m": "m",
    "position_error_x_m": "m",
    "position_error_y_m": "m",
    "position_error_z_m": "m",
    "attitude_error_deg": "deg",
    "position_reduction_m": "m",
    "attitude_reduction_deg": "deg",
    "success_share": "%",
    "n_landmarks": "",
    "four_landmarks_share": "%",
    "landmark_observations": "",
    "landmark_error_m": "m",
    "chi_square": "",
    "database_landmarks": "",
    "database_facets": "",
    "database_bytes": "bytes",
    "seconds": "s",
    "error_after_1_m": "m",
    "error_after_2_m": "m",
    "error_after_1_reduction": "%",
    "error_after_2_reduction": "%",
    "cycle_seconds_ratio": "",
    "landmark_rmse_m": "m",
    "settled_landmark_rmse_m": "m",
    "final_landmark_rmse_m": "m",
    "mean_position_nees": "",
    "features_per_image": "",
    "repeatability_share": "%",
    "right_share": "%",
    "kept_right_share": "%",
    "track_survival_share": "%",
    "detection_share": "%",
    "clean_detection_share": "%",
    "false_alarm_share": "%",
    "listed_false_alarm_share": "%",
    "beyond_detectable_share": "%",
    "duplicate_share": "%",
    "detections_per_image": "",
    "best_false_alarm_share": "%",
    "best_within_1px_share": "%",
    "best_centre_error_px": "px",
    "centre_error_px": "px",
    "axes_error_px": "px",
    "missed_share": "%",
    "wrong_share": "%",
    "matching_recall_share": "%",
    "matching_wrong_share": "%",
    "epipolar_offset_px": "px",
    "mixed_share": "%",
    "craters_per_image": "",
    "median_craters_per_image": "",
    "processing_seconds": "s",
    "clean_centre_error_px": "px",
    "clean_axes_error_px": "px",
    "few_craters_share": "%",
    "similar_image_share": "%",
    "seen_once_share": "%",
    "epoch_error_m": "m",
    "arc_rms_m": "m",
    "arc_median_m": "m",
    "predicted_error_m": "m",
}
# Units of numbers that estimators report, by the end of their names.
_SUFFIXES = {"_px": "px", "_m": "m", "_deg": "deg", "_s": "s", "_bytes": "bytes"}


def unit_of(name: str) -> str:
    """Return the unit of a measure: a known one, or by the suffix of its name."""
    suffixes = (unit for end, unit in _SUFFIXES.items() if name.endswith(end))
    return UNITS[name] if name in UNITS else next(suffixes, "")


@dataclass(frozen=True, slots=True)
class Record:
    """One line of the tidy table.

    Parameters
    ----------
    scenario, estimator
        What the trials were.
    stage
        ``prior``, a stage of the estimator, ``failures-at-prior``, ``database`` or a timed stage.
    reference
        The pose that was scored against; '' for the scenario's own truth.
    measure, unit, statistic
        What the value is.
    value, low, high
        The statistic with its 95 % interval; None where unknown.
    n_ok, n
        Samples behind the value, and how many there would be had nothing failed.
    """

    scenario: str
    estimator: str
    stage: str
    reference: str
    measure: str
    unit: str
    statistic: str
    value: float | None
    low: float | None
    high: float | None
    n_ok: int
    n: int


def find(records: Sequence[Record], **wanted: str) -> Record | None:
    """Return the first record whose fields equal ``wanted`` (``reference`` is '' unless given)."""
    wanted = {"reference": "", **wanted}
    return next((r for r in records if all(getattr(r, name) == value for name, value in wanted.items())), None)

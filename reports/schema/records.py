"""A line of the tidy table of a report: what was measured, of how many trials, how certain; and words for stages."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from boresight.reports.schema.column import FRESH_IMAGE, STORED_IMAGE

CONTROL = "prior"
"""Name of the control estimator, and of the stage before anything was estimated."""
CONTROLS = (CONTROL, "dead-reckoning")
"""Estimators that use no measurement of what they estimate."""
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


class Key(NamedTuple):
    """Identity of a record, unique among the records of a run."""

    scenario: str
    estimator: str
    stage: str
    reference: str = ""
    measure: str = ""
    statistic: str = ""


@dataclass(frozen=True, slots=True)
class Record:
    """One line of the tidy table.

    ``stage`` is ``prior``, a stage of the estimator, ``failures-at-prior``, ``database`` or a timed stage.
    ``reference`` is the pose that was scored against; '' for the scenario's own truth. ``value`` has its 95 % interval
    ``low`` to ``high``; None where unknown. ``n_ok`` samples are behind it, of the ``n`` that there would be had
    nothing failed.
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

    @property
    def key(self) -> Key:
        """Its identity."""
        return Key(self.scenario, self.estimator, self.stage, self.reference, self.measure, self.statistic)


def by_key(records: Iterable[Record]) -> dict[Key, Record]:
    """Index records by their keys, in order; of several with the same key, the first."""
    index: dict[Key, Record] = {}
    for record in records:
        index.setdefault(record.key, record)
    return index


_STAGES = {
    CONTROL: "prior",
    "centroid": "after centroiding",
    "alignment": "after alignment",
    "recognition": "after recognition",
    "choice": "after the choice",
    "range": "after the range",
    "final": "final",
    FAILURES_AT_PRIOR: "failures at prior",
    "database": "data base",
    DIAGNOSTICS: "of each trial",
    DERIVED: "of the scenario",
}
_TIMED = {
    "mesh_rendering": "data base image rendering",
    "centroid": "brightness centroid",
    "feature_extraction": "feature extraction",
    "recognition": "recognition and pose estimation",
    "consistency": "consistency of the solution",
    "range": "fusion of the range",
    FRESH_IMAGE: "image (rendered or read)",
    STORED_IMAGE: "image (from the store)",
}


def count_of(number: int, noun: str) -> str:
    """Say how many: '1 trial', '5,000 trials'."""
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def shortened(text: str, most: int) -> str:
    """Return a text of so many characters at most; a longer one ends in three dots."""
    return text if len(text) <= most else f"{text[: most - 3]}..."


def stage_label(stage: str, timed: bool = False) -> str:
    """Name a stage in plain words: as a state of the pose, or as a piece of work that takes time."""
    return (_TIMED if timed else _STAGES).get(stage, stage.replace("_", " "))


def as_title(label: str) -> str:
    """Begin a label with a capital and keep all others, as those of NEES and RMS."""
    return label[:1].upper() + label[1:]

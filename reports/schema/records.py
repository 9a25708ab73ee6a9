"""One line of the tidy table of a report: what was measured, over how many trials, how well it is known."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

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

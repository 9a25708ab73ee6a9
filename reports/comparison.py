"""Our numbers beside published ones, with a verdict by a rule that was fixed beforehand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from reports.measures import CONTROL, Record, find
from reports.published import Comparison, PublishedValue

Verdict = Literal["reproduced", "better", "differs", "undecided", "context", "not measured"]

VERDICT_RULE = (
    "reproduced: our value lies within the tolerance; better or differs: the whole 95 % interval lies outside it, on "
    "the better or the worse side; undecided: the interval reaches into the tolerance from outside, or is wider than "
    "four tolerances, so that more trials are needed; context: no tolerance was set, because the conditions differ."
)


@dataclass(frozen=True, slots=True)
class ComparedValue:
    """A published value, ours (None if the run does not measure it) and the verdict."""

    scenario: str
    estimator: str
    published: PublishedValue
    ours: Record | None
    verdict: Verdict


def compare(records: Sequence[Record], comparison: Comparison) -> tuple[ComparedValue, ...]:
    """Set each published value beside ours, for every scenario and estimator but the control."""
    pairs = dict.fromkeys((r.scenario, r.estimator) for r in records if r.stage == CONTROL and r.estimator != CONTROL)
    compared = []
    for scenario, estimator in pairs:
        for published in comparison.values:
            ours = find(
                records,
                scenario=scenario,
                estimator=estimator,
                stage=published.stage,
                measure=published.measure,
                statistic=published.statistic,
            )
            due = judge(ours, published) if comparison.verdicts else "context"
            compared.append(ComparedValue(scenario, estimator, published, ours, due))
    return tuple(compared)


def judge(ours: Record | None, published: PublishedValue) -> Verdict:
    """Apply `VERDICT_RULE` to one value."""
    if ours is None or ours.value is None:
        return "not measured"
    if published.tolerance is None:
        return "context"
    if ours.low is None or ours.high is None or ours.high - ours.low > 4 * published.tolerance:
        return "undecided"
    lowest, highest = published.value - published.tolerance, published.value + published.tolerance
    if lowest <= ours.value <= highest:
        return "reproduced"
    if ours.low <= highest and ours.high >= lowest:
        return "undecided"
    side = "lower" if ours.value < lowest else "higher"
    return "better" if side == published.better else "differs"

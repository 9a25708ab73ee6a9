"""Our numbers beside published ones, with a verdict by a rule that was fixed beforehand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

from reports.published import Claim, Comparison, PublishedValue
from reports.records import CONTROL, DERIVED, Record, find
from reports.statistics import MEDIAN

Verdict = Literal["reproduced", "better", "differs", "undecided", "context", "not measured"]

VERDICT_RULE = (
    "better or differs: the whole 95 % interval lies outside the tolerance, on the better or the worse side; "
    "reproduced: our value lies within it, and the interval is no wider than four tolerances; undecided: the interval "
    "is wider or none, or reaches into the tolerance from outside, so that more trials, or sets of images, are needed; "
    "context: no tolerance was set, because conditions differ. Where the paper says 'more than', or names an order, "
    "the intervals must keep it."
)


@dataclass(frozen=True, slots=True)
class ComparedValue:
    """A published value, ours (None if the run does not measure it) and the verdict."""

    scenario: str
    estimator: str
    published: PublishedValue
    ours: Record | None
    verdict: Verdict


@dataclass(frozen=True, slots=True)
class ComparedClaim:
    """An order that is stated in words, our medians in the stated order, and the verdict."""

    scenario: str
    claim: Claim
    ours: tuple[Record | None, ...]
    verdict: Verdict


def compare(records: Sequence[Record], comparison: Comparison) -> tuple[ComparedValue, ...]:
    """Set each published value beside ours, for every scenario that it is for and every estimator but the control.

    What belongs to a scenario and to none of its estimators stands beside each of them.
    """
    pairs = dict.fromkeys((r.scenario, r.estimator) for r in records if r.estimator not in ("", CONTROL))
    compared = []
    for scenario, estimator in pairs:
        for published in comparison.values:
            if published.scenario not in ("", scenario) or published.estimator not in ("", estimator):
                continue
            ours = _ours(records, scenario, estimator, published) or _ours(records, scenario, "", published)
            if ours is None and published.stage == DERIVED:
                continue
            due = judge(ours, published) if comparison.verdicts else "context"
            compared.append(ComparedValue(scenario, estimator, published, ours, due))
    return tuple(compared)


def _ours(records: Sequence[Record], scenario: str, estimator: str, published: PublishedValue) -> Record | None:
    return find(
        records,
        scenario=scenario,
        estimator=estimator,
        stage=published.stage,
        measure=published.measure,
        statistic=published.statistic,
        reference=published.against,
    )


def compare_claims(records: Sequence[Record], comparison: Comparison) -> tuple[ComparedClaim, ...]:
    """Hold each claimed order against our final medians, scenario by scenario."""
    compared = []
    for scenario in dict.fromkeys(r.scenario for r in records):
        for claim in comparison.claims:
            medians = tuple(
                find(
                    records,
                    scenario=scenario,
                    estimator=label,
                    stage="final",
                    measure=claim.measure,
                    statistic=MEDIAN.name,
                )
                for label in claim.order
            )
            compared.append(ComparedClaim(scenario, claim, medians, judge_order(medians)))
    return tuple(compared)


def judge_order(ascending: Sequence[Record | None]) -> Verdict:
    """Tell whether values with intervals ascend: apart they must be, in the stated order or in another."""
    bounds: list[tuple[float, float]] = []
    for record in ascending:
        if record is None or record.low is None or record.high is None:
            return "not measured"
        bounds.append((record.low, record.high))
    if all(first[1] < second[0] for first, second in pairwise(bounds)):
        return "reproduced"
    return "differs" if any(first[0] > second[1] for first, second in pairwise(bounds)) else "undecided"


def judge(ours: Record | None, published: PublishedValue) -> Verdict:
    """Apply `VERDICT_RULE` to one value."""
    if ours is None or ours.value is None:
        return "not measured"
    if published.relation == "above":
        return _judge_above(ours, published.value)
    if published.tolerance is None:
        return "context"
    if ours.low is None or ours.high is None:
        return "undecided"
    lowest, highest = published.value - published.tolerance, published.value + published.tolerance
    if ours.high < lowest or ours.low > highest:
        side = "lower" if ours.high < lowest else "higher"
        return "better" if side == published.better else "differs"
    narrow = ours.high - ours.low <= 4 * published.tolerance
    return "reproduced" if narrow and lowest <= ours.value <= highest else "undecided"


def _judge_above(ours: Record, bound: float) -> Verdict:
    if ours.low is None or ours.high is None or ours.low <= bound <= ours.high:
        return "undecided"
    return "reproduced" if ours.low > bound else "differs"

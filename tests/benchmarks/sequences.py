"""Adjustments and smoothers of sequences beside other engines, and beside their own reference in numpy."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy_adjustment
from threadpoolctl import threadpool_limits

from benchmarks.ratio import Absent, Ratio
from benchmarks.settings import Settings
from benchmarks.timing import in_turn, timed
from benchmarks.windows import COST_TOLERANCE, cycle_ratios, make_window, window_ratios
from campaign.runs.benchmark import one_core
from estimators.slam.solver import AdjustmentSolution, StoppingRule, minimise
from scenarios.errors import BoresightError

_FEW, _MANY = 25, 100
_CYCLE_FRAMES = 45
_KERNEL_WINDOW = (25, 9)
KERNEL_WORK = "adjustment of 25 landmarks in 9 views"


def adjustment_ratios(settings: Settings) -> Iterator[Ratio | Absent]:
    """Time full adjustments of windows on one core beside gtsam and Ceres: the whole call, and their solvers alone."""
    absent: list[Absent] = []
    with one_core(), threadpool_limits(limits=1):
        for row in window_ratios(settings.rounds, lambda text: absent.append(Absent("adjustment of a window", text))):
            work = f"adjustment of {row.landmarks} landmarks in {row.views} views"
            if row.cost_gap > COST_TOLERANCE:
                yield Absent(work, f"{row.peer} ends at another cost, by {row.cost_gap:.1e}")
                continue
            note = f"equal costs to {row.cost_gap:.0e}"
            whole, alone = row.whole * row.ours_s, row.solve_alone * row.ours_s
            aim = 10.0 if row.landmarks <= _FEW else 20.0 if row.landmarks >= _MANY else None
            yield Ratio(work, row.peer, "cpu", row.ours_s, whole, aim, note)
            yield Ratio(work, f"{row.peer}'s solver alone", "cpu", row.ours_s, alone, 5.0, note)
    yield from absent


def smoother_ratios(settings: Settings) -> Iterator[Ratio | Absent]:
    """Time whole cycles of fixed-lag smoothers on one core beside gtsam's."""
    del settings
    absent: list[Absent] = []
    with one_core(), threadpool_limits(limits=1):
        for row in cycle_ratios(_CYCLE_FRAMES, lambda text: absent.append(Absent("cycle of fixed-lag", text))):
            aim = 2.0 if row.landmarks <= 20 else 1.0
            yield Ratio(
                f"cycle of fixed-lag, {row.landmarks} landmarks", "gtsam", "wall", row.ours_s, row.ratio * row.ours_s,
                aim, f"{row.apart_sigma:.3f} sigma apart",
            )  # fmt: skip
    yield from absent


def kernel_ratios(settings: Settings) -> Iterator[Ratio | Absent]:
    """Time an adjustment by compiled kernels beside their reference in numpy.

    Raises
    ------
    BoresightError
        If the two do not end at one cost.
    """
    problem, start = make_window(*_KERNEL_WINDOW, 0)

    def compiled() -> AdjustmentSolution:
        return minimise(problem, start, StoppingRule(1e-4))

    def reference() -> AdjustmentSolution:
        return numpy_adjustment.minimise(problem, start, StoppingRule(1e-4))

    costs = compiled().cost, reference().cost
    gap = abs(costs[0] - costs[1]) / costs[1]
    if gap > COST_TOLERANCE:
        raise BoresightError(f"compiled kernels and numpy end at costs that differ by {gap:.1e}")
    with threadpool_limits(limits=1):
        ours, theirs = in_turn(5 * settings.rounds, timed(_times(20, compiled)), timed(reference))
    yield Ratio(KERNEL_WORK, "our numpy", "cpu", ours.cpu / 20, theirs.cpu, agreement=f"equal costs to {gap:.0e}")


def _times(count: int, work: Callable[[], object]) -> Callable[[], None]:
    def repeated() -> None:
        for _ in range(count):
            work()

    return repeated

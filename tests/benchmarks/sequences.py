"""Adjustments and smoothers of sequences beside other engines, and beside their own reference in numpy."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
import numpy_adjustment
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from benchmarks.ratio import Absent, Ratio
from benchmarks.settings import Settings
from benchmarks.timing import in_turn, timed
from benchmarks.windows import (
    CERES,
    COST_TOLERANCE,
    GTSAM,
    UPDATES,
    WindowRatio,
    cycle_ratios,
    make_window,
    window_ratios,
)
from boresight.campaign.runs.benchmark import one_core
from boresight.estimators.slam.adjustment.solver import AdjustmentSolution, StoppingRule, minimise
from boresight.scenarios.errors import BoresightError

_AIMS = {(CERES, 25, 9): 5.0, (CERES, 500, 9): 10.0}
_GTSAM_AIM, _UPDATE_AIM = 5.0, 2.0
_ROUNDS = 5
_CYCLE_FRAMES = 45
_KERNEL_WINDOW = (25, 9)
KERNEL_WORK = "adjustment of 25 landmarks in 9 views"


def adjustment_ratios(settings: Settings) -> Iterator[Ratio | Absent]:
    """Time full adjustments of windows on one core beside the solvers of gtsam and of Ceres alone."""
    absent: list[Absent] = []
    with one_core(), threadpool_limits(limits=1):
        told = partial(_left_out, absent, "adjustment of a window")
        for row in window_ratios(settings.rounds, _ROUNDS, told):
            work = f"adjustment of {row.landmarks} landmarks in {row.views} views"
            if row.cost_gap > COST_TOLERANCE:
                yield Absent(work, f"{row.peer} or we end above the minimum, by {row.cost_gap:.1e} of the cost")
                continue
            aim = _GTSAM_AIM if row.peer == GTSAM else _AIMS.get((row.peer, row.landmarks, row.views))
            yield _beside(work, row.peer, row, row.solve, aim)
            if row.peer == CERES:
                yield _beside(work, f"{CERES}, its problem built as well", row, row.whole)
    yield from absent


def smoother_ratios(settings: Settings) -> Iterator[Ratio | Absent]:
    """Time whole frames of fixed-lag smoothers on one core beside gtsam's updates alone, and with what feeds them."""
    absent: list[Absent] = []
    with one_core(), threadpool_limits(limits=1):
        for row in cycle_ratios(_CYCLE_FRAMES, settings.rounds, partial(_left_out, absent, "frame of fixed-lag")):
            work, note = f"frame of fixed-lag, {row.landmarks} landmarks", f"{row.apart_sigma:.3f} sigma apart"
            peer, update_s = f"gtsam's update alone, {row.updates} a frame", row.update * row.ours_s
            aim = _UPDATE_AIM if row.updates == UPDATES[0] else None
            yield Ratio(work, peer, "cpu", row.ours_s, update_s, aim, note)
            if row.updates == UPDATES[0]:
                yield Ratio(
                    work, "gtsam, fed and read in Python", "cpu", row.ours_s, row.whole * row.ours_s, None, note
                )
    yield from absent


def _left_out(absent: list[Absent], work: str, why: str) -> None:
    absent.append(Absent(work, why))


def _beside(work: str, peer: str, row: WindowRatio, ratios: NDArray[np.float64], aim: float | None = None) -> Ratio:
    note = f"costs equal to {row.cost_gap:.0e}; {ratios.min():.3g} to {ratios.max():.3g} in {len(ratios)} windows"
    return Ratio(work, peer, "cpu", row.ours_s, float(np.median(ratios)) * row.ours_s, aim, note)


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

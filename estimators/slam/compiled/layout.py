"""Where each variable of an adjustment stands in the reduced system, as `Layout` in numpy."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.slam.compiled.envelope import Envelope, make_envelope
from estimators.slam.compiled.flat import FlatProblem
from estimators.slam.compiled.jit import kernel

IndexArray = NDArray[np.int64]


class FlatLayout(NamedTuple):
    """Slots of the variables as in `Layout`, the envelope of the reduced matrix, and the links by eliminated landmark.

    Parameters
    ----------
    link_begin
        (e + 1,): where the links of each eliminated landmark begin.
    link
        (m,): the measurements that join a free view with an eliminated landmark; sightings first, then distances.
    link_slot
        (m,): the kept slots of their views.
    """

    view_slot: IndexArray
    point_slot: IndexArray
    gone_slot: IndexArray
    shape: Envelope
    link_begin: IndexArray
    link: IndexArray
    link_slot: IndexArray


@kernel
def make_layout(problem: FlatProblem) -> FlatLayout:
    """Give the variables their slots and find which eliminated landmark joins which views."""
    views, points = len(problem.free_views), len(problem.free_points)
    view_slot, point_slot, gone_slot = np.empty(views, np.int64), np.empty(points, np.int64), np.empty(points, np.int64)
    joined = np.empty(points, np.bool_)
    for j in range(points):
        joined[j] = problem.kept_points[j]
    for j in problem.prior_points:
        joined[j] = True
    kept = gone = 0
    for i in range(views):
        view_slot[i] = kept if problem.free_views[i] else -1
        kept += int(problem.free_views[i])
    for j in range(points):
        free = problem.free_points[j]
        point_slot[j] = kept if free and joined[j] else -1
        gone_slot[j] = gone if free and not joined[j] else -1
        kept += int(free and joined[j])
        gone += int(free and not joined[j])
    begin, link, slot = _links(problem, view_slot, gone_slot, gone)
    shape = make_envelope(_reach(problem, view_slot, point_slot, kept, begin, slot))
    return FlatLayout(view_slot, point_slot, gone_slot, shape, begin, link, slot)


@kernel
def _links(
    problem: FlatProblem, view_slot: IndexArray, gone_slot: IndexArray, gone: int
) -> tuple[IndexArray, IndexArray, IndexArray]:
    """Sort the measurements of eliminated landmarks by landmark."""
    seen = len(problem.seen_view)
    count = seen + len(problem.ranged_view)
    begin, place = np.zeros(gone + 1, np.int64), np.zeros(gone + 1, np.int64)
    for k in range(count):
        i, j = ends(problem, k, seen)
        if view_slot[i] >= 0 and gone_slot[j] >= 0:
            begin[gone_slot[j] + 1] += 1
    for g in range(gone):
        begin[g + 1] += begin[g]
        place[g] = begin[g]
    link, slot = np.empty(begin[gone], np.int64), np.empty(begin[gone], np.int64)
    for k in range(count):
        i, j = ends(problem, k, seen)
        if view_slot[i] >= 0 and gone_slot[j] >= 0:
            at = place[gone_slot[j]]
            link[at], slot[at] = k, view_slot[i]
            place[gone_slot[j]] = at + 1
    return begin, link, slot


@kernel
def ends(problem: FlatProblem, k: int, seen: int) -> tuple[int, int]:
    """View and landmark of a measurement: sightings first, then distances."""
    if k < seen:
        return problem.seen_view[k], problem.seen_point[k]
    return problem.ranged_view[k - seen], problem.ranged_point[k - seen]


@kernel
def _reach(
    problem: FlatProblem, view_slot: IndexArray, point_slot: IndexArray, kept: int, begin: IndexArray, slot: IndexArray
) -> IndexArray:
    """Last kept variable that each is coupled with, by a measurement, an eliminated landmark or the prior."""
    reach = np.empty(kept, np.int64)
    for i in range(kept):
        reach[i] = i
    for g in range(len(begin) - 1):
        _couple(reach, slot, begin[g], begin[g + 1])
    pair = np.empty(2, np.int64)
    seen = len(problem.seen_view)
    for k in range(seen + len(problem.ranged_view)):
        i, j = ends(problem, k, seen)
        pair[0], pair[1] = view_slot[i], point_slot[j]
        if pair[0] >= 0 and pair[1] >= 0:
            _couple(reach, pair, 0, 2)
    for k in range(len(problem.motion_start)):
        pair[0], pair[1] = view_slot[problem.motion_start[k]], view_slot[problem.motion_end[k]]
        if pair[0] >= 0 and pair[1] >= 0:
            _couple(reach, pair, 0, 2)
    slots = prior_slots(problem, view_slot, point_slot)
    _couple(reach, slots, 0, len(slots))
    return reach


@kernel
def _couple(reach: IndexArray, slots: IndexArray, begin: int, end: int) -> None:
    """Note that a run of slots is coupled."""
    if begin == end:
        return
    first = last = slots[begin]
    for k in range(begin, end):
        first, last = min(first, slots[k]), max(last, slots[k])
    reach[first] = max(reach[first], last)


@kernel
def prior_slots(problem: FlatProblem, view_slot: IndexArray, point_slot: IndexArray) -> IndexArray:
    """Return the slots (a + b,) of the variables of the prior."""
    views = len(problem.prior_views)
    slots = np.empty(views + len(problem.prior_points), np.int64)
    for k in range(len(slots)):
        slots[k] = view_slot[problem.prior_views[k]] if k < views else point_slot[problem.prior_points[k - views]]
    return slots

"""Where each variable of an adjustment stands in the reduced system, as `Layout` in numpy."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.slam.compiled.envelope import Envelope, make_envelope
from estimators.slam.compiled.flat import FlatProblem
from estimators.slam.compiled.jit import kernel

IndexArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


class FlatLayout(NamedTuple):
    """Slots of the variables as in `Layout`, the envelope of the reduced matrix, and the links by eliminated landmark.

    Parameters
    ----------
    gone
        (e,): the eliminated landmarks.
    views
        How many views are free; the kept landmarks have the slots after theirs.
    link_begin
        (e + 1,): where the links of each eliminated landmark begin.
    link
        (m,): the measurements that join a free view with an eliminated landmark; sightings first, then distances.
    link_slot
        (m,): the kept slots of their views.
    """

    view_slot: IndexArray
    point_slot: IndexArray
    gone: IndexArray
    views: int
    shape: Envelope
    link_begin: IndexArray
    link: IndexArray
    link_slot: IndexArray


@kernel
def make_layout(problem: FlatProblem) -> FlatLayout:
    """Give the variables their slots and find which eliminated landmark joins which views."""
    view_slot, views = _numbered(problem.free_views, 0)
    free, joined = problem.free_points, problem.kept_points.copy()
    for j in problem.prior_points:
        joined[j] = True
    point_slot, kept = _numbered(free & joined, views)
    gone_slot, gone = _numbered(free & ~joined, 0)
    view, point = _ends(problem)
    begin, link, slot = _links(view_slot[view], gone_slot[point], gone)
    reach = np.arange(kept)
    for g in range(gone):
        _couple(reach, slot, begin[g], begin[g + 1])
    if kept > views:
        _couple_pairs(reach, view_slot[view], point_slot[point])
    _couple_pairs(reach, view_slot[problem.motion_start], view_slot[problem.motion_end])
    slots = prior_slots(problem, view_slot, point_slot)
    _couple(reach, slots, 0, len(slots))
    return FlatLayout(
        view_slot, point_slot, np.flatnonzero(gone_slot >= 0), views, make_envelope(reach), begin, link, slot
    )


@kernel
def _numbered(mask: BoolArray, first: int) -> tuple[IndexArray, int]:
    """Count the marked entries from ``first`` on: their numbers, -1 elsewhere, and the next number."""
    slots = np.empty(len(mask), np.int64)
    for i in range(len(mask)):
        slots[i] = first if mask[i] else -1
        first += int(mask[i])
    return slots, first


@kernel
def _ends(problem: FlatProblem) -> tuple[IndexArray, IndexArray]:
    """View and landmark of each measurement: sightings first, then distances."""
    return (
        np.concatenate((problem.seen_view, problem.ranged_view)),
        np.concatenate((problem.seen_point, problem.ranged_point)),
    )


@kernel
def _links(view_slot: IndexArray, gone_slot: IndexArray, gone: int) -> tuple[IndexArray, IndexArray, IndexArray]:
    """Sort the measurements of eliminated landmarks by landmark, given the slots (m,) of their ends."""
    begin = np.zeros(gone + 1, np.int64)
    for k in range(len(view_slot)):
        if view_slot[k] >= 0 and gone_slot[k] >= 0:
            begin[gone_slot[k] + 1] += 1
    for g in range(gone):
        begin[g + 1] += begin[g]
    place = begin.copy()
    link, slot = np.empty(begin[gone], np.int64), np.empty(begin[gone], np.int64)
    for k in range(len(view_slot)):
        if view_slot[k] >= 0 and gone_slot[k] >= 0:
            at = place[gone_slot[k]]
            link[at], slot[at] = k, view_slot[k]
            place[gone_slot[k]] = at + 1
    return begin, link, slot


@kernel
def _couple(reach: IndexArray, slots: IndexArray, begin: int, end: int) -> None:
    """Note that a run of slots is coupled: the first with the last."""
    if begin == end:
        return
    first = last = slots[begin]
    for k in range(begin, end):
        first, last = min(first, slots[k]), max(last, slots[k])
    reach[first] = max(reach[first], last)


@kernel
def _couple_pairs(reach: IndexArray, one: IndexArray, other: IndexArray) -> None:
    """Note that pairs of slots are coupled."""
    for k in range(len(one)):
        first, last = min(one[k], other[k]), max(one[k], other[k])
        if first >= 0:
            reach[first] = max(reach[first], last)


@kernel
def prior_slots(problem: FlatProblem, view_slot: IndexArray, point_slot: IndexArray) -> IndexArray:
    """Return the slots (a + b,) of the variables of the prior."""
    return np.concatenate((view_slot[problem.prior_views], point_slot[problem.prior_points]))

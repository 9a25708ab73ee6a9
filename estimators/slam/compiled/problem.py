"""Adjustment as flat arrays for the kernels, and the order of its variables in the reduced system."""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from boresight.estimators.slam.compiled import kernel
from boresight.estimators.slam.compiled.envelope import Envelope, make_envelope

IndexArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

FloatArray = NDArray[np.float64]

_Scalar = TypeVar("_Scalar", bound=np.generic)

FLOAT, INDEX, BOOL = np.dtype(np.float64), np.dtype(np.int64), np.dtype(np.bool_)


class FlatProblem(NamedTuple):
    """An adjustment as contiguous arrays; ``pinhole`` is fx, fy, cx, cy. Frozen values of length 0: none are frozen."""

    pinhole: FloatArray
    attitudes: FloatArray
    seen_view: IndexArray
    seen_point: IndexArray
    seen_px: FloatArray
    seen_sigma_px: FloatArray
    ranged_view: IndexArray
    ranged_point: IndexArray
    range_m: FloatArray
    range_sigma_m: FloatArray
    motion_start: IndexArray
    motion_end: IndexArray
    motion_m: FloatArray
    motion_information: FloatArray
    prior_views: IndexArray
    prior_points: IndexArray
    prior_origin_m: FloatArray
    prior_information: FloatArray
    prior_gradient: FloatArray
    frozen_positions_m: FloatArray
    frozen_points_m: FloatArray
    free_views: BoolArray
    free_points: BoolArray
    kept_points: BoolArray


def floats(values: FloatArray) -> FloatArray:
    """Return ``values`` as a writable contiguous float64 array, as the kernels are compiled for; copy if necessary."""
    return plain(values, FLOAT)


def plain(values: NDArray[_Scalar], dtype: np.dtype[_Scalar]) -> NDArray[_Scalar]:
    """Copy read-only and strided arrays: numba would compile a kernel again for each kind of array."""
    if values.dtype is dtype and values.flags.carray:
        return values
    return np.array(values, dtype=dtype, order="C")


class FlatOrdering(NamedTuple):
    """Slots of the variables as in `estimators.slam.normal.VariableOrdering`, and the envelope of the reduced matrix.

    Parameters
    ----------
    view_slot, point_slot
        (V,), (L,): slots of views and kept landmarks; -1 for fixed views, and for fixed and eliminated landmarks.
    eliminated
        (e,): the eliminated landmarks.
    views
        Number of free views; the slots of the kept landmarks follow theirs.
    shape
        Envelope of the reduced matrix.
    link_begin
        (e + 1,): first link of each eliminated landmark.
    link
        (m,): measurements between a free view and an eliminated landmark, sorted by landmark. Pixels have the first
        numbers, then distances.
    link_slot
        (m,): the kept slots of their views.
    """

    view_slot: IndexArray
    point_slot: IndexArray
    eliminated: IndexArray
    views: int
    shape: Envelope
    link_begin: IndexArray
    link: IndexArray
    link_slot: IndexArray


@kernel
def make_ordering(problem: FlatProblem) -> FlatOrdering:
    """Assign slots to the variables, list the links of eliminated landmarks, and find the envelope."""
    view_slot, views = _numbered(problem.free_views, 0)
    free, joined = problem.free_points, problem.kept_points.copy()
    # The prior couples its landmarks, so that they cannot be eliminated as 3 x 3 blocks.
    for j in problem.prior_points:
        joined[j] = True
    point_slot, kept = _numbered(free & joined, views)
    eliminated_slot, eliminated = _numbered(free & ~joined, 0)
    view, point = _ends(problem)
    begin, link, slot = _links(view_slot[view], eliminated_slot[point], eliminated)
    reach = np.arange(kept)
    # An eliminated landmark couples all views that see it; the Schur complement fills their blocks.
    for g in range(eliminated):
        _couple(reach, slot, begin[g], begin[g + 1])
    # Kept landmarks are coupled with their views directly.
    if kept > views:
        _couple_pairs(reach, view_slot[view], point_slot[point])
    _couple_pairs(reach, view_slot[problem.motion_start], view_slot[problem.motion_end])
    # The information matrix of the prior is dense.
    slots = prior_slots(problem, view_slot, point_slot)
    _couple(reach, slots, 0, len(slots))
    return FlatOrdering(
        view_slot, point_slot, np.flatnonzero(eliminated_slot >= 0), views, make_envelope(reach), begin, link, slot
    )


@kernel
def _numbered(mask: BoolArray, first: int) -> tuple[IndexArray, int]:
    """Assign numbers to the marked entries from ``first`` on, -1 elsewhere; also return the next number."""
    slots = np.empty(len(mask), np.int64)
    for i in range(len(mask)):
        slots[i] = first if mask[i] else -1
        first += int(mask[i])
    return slots, first


@kernel
def _ends(problem: FlatProblem) -> tuple[IndexArray, IndexArray]:
    """View and landmark of each measurement: pixels first, then distances."""
    return (
        np.concatenate((problem.seen_view, problem.ranged_view)),
        np.concatenate((problem.seen_point, problem.ranged_point)),
    )


@kernel
def _links(
    view_slot: IndexArray, eliminated_slot: IndexArray, eliminated: int
) -> tuple[IndexArray, IndexArray, IndexArray]:
    """Sort the measurements of eliminated landmarks by landmark, given the slots (m,) of their ends."""
    begin = np.zeros(eliminated + 1, np.int64)
    for k in range(len(view_slot)):
        if view_slot[k] >= 0 and eliminated_slot[k] >= 0:
            begin[eliminated_slot[k] + 1] += 1
    for g in range(eliminated):
        begin[g + 1] += begin[g]
    # Counting sort: stable, so that the links of a landmark are in the order of the measurements.
    place = begin.copy()
    link, slot = np.empty(begin[eliminated], np.int64), np.empty(begin[eliminated], np.int64)
    for k in range(len(view_slot)):
        if view_slot[k] >= 0 and eliminated_slot[k] >= 0:
            at = place[eliminated_slot[k]]
            link[at], slot[at] = k, view_slot[k]
            place[eliminated_slot[k]] = at + 1
    return begin, link, slot


@kernel
def _couple(reach: IndexArray, slots: IndexArray, begin: int, end: int) -> None:
    """Extend the envelope to hold the coupling of all slots of a run with each other."""
    if begin == end:
        return
    # The first slot reaching the last one is enough: `make_envelope` lets all rows between them reach as far.
    first = last = slots[begin]
    for k in range(begin, end):
        first, last = min(first, slots[k]), max(last, slots[k])
    reach[first] = max(reach[first], last)


@kernel
def _couple_pairs(reach: IndexArray, one: IndexArray, other: IndexArray) -> None:
    """Extend the envelope to hold the coupling of pairs of slots."""
    for k in range(len(one)):
        first, last = min(one[k], other[k]), max(one[k], other[k])
        # A slot of -1 at either end: a fixed variable, nothing to couple.
        if first >= 0:
            reach[first] = max(reach[first], last)


@kernel
def prior_slots(problem: FlatProblem, view_slot: IndexArray, point_slot: IndexArray) -> IndexArray:
    """Return the slots (a + b,) of the variables of the prior."""
    return np.concatenate((view_slot[problem.prior_views], point_slot[problem.prior_points]))

"""Adjustment as flat arrays for the kernels, and the order of its variables in the reduced system."""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from boresight.estimators.slam.adjustment.compiled import inner, kernel
from boresight.estimators.slam.adjustment.compiled.envelope import Envelope, make_envelope
from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray

_Scalar = TypeVar("_Scalar", bound=np.generic)

LANES = 8
"""Landmarks that are computed side by side. Sums over landmarks have this many parts, so that their order is fixed."""

FLOAT, INDEX, BOOL = np.dtype(np.float64), np.dtype(np.int64), np.dtype(np.bool_)


Places = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""Positions and landmarks, and those of the linearisation point, each (n, 3)."""


class FlatProblem(NamedTuple):
    """An adjustment as contiguous arrays; ``pinhole`` is fx, fy, cx, cy. Frozen values of length 0: none are frozen.

    The last three are those of `PixelMeasurements`; if they are not of length 0 their pixels are sorted by landmark
    and view.
    """

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
    seen_branch: IndexArray
    seen_walk_px2: FloatArray
    seen_moved: FloatArray


def floats(values: FloatArray) -> FloatArray:
    """Return ``values`` as a writable contiguous float64 array, as the kernels are compiled for; copy if necessary."""
    return plain(values, FLOAT)


def plain(values: NDArray[_Scalar], dtype: np.dtype[_Scalar]) -> NDArray[_Scalar]:
    """Copy read-only and strided arrays: numba would compile a kernel again for each kind of array."""
    if values.dtype is dtype and values.flags.carray:
        return values
    return np.array(values, dtype=dtype, order="C")


class FlatEquations(NamedTuple):
    """Kept matrix and gradient (n, 3), sums by landmark (G, 9 LANES), and terms of the cells (C, 9 LANES).

    Nine numbers of a lane are a symmetric (3, 3) block as xx, xy, xz, yy, yz, zz and a gradient (3,). If errors of
    pixels are correlated, those of a cell are a (3, 3) block by rows.
    """

    kept: FloatArray
    kept_gradient: FloatArray
    by_point: FloatArray
    terms: FloatArray


class FlatOrdering(NamedTuple):
    """Slots of the variables, the envelope of the reduced matrix, and the landmarks in groups with their pixels.

    The landmarks of a group are computed side by side, one in each lane. A group has a cell for each view from the
    first to the last one that sees one of them.

    Parameters
    ----------
    view_slot, point_slot
        (V,), (L,): slots of views and kept landmarks; -1 for fixed views, and for fixed and eliminated landmarks.
    views
        Number of free views; the slots of the kept landmarks follow theirs.
    shape
        Envelope of the reduced matrix.
    group, lane
        (L,), (L,): place of each landmark.
    landmark
        (G, LANES): the landmarks of each group; -1 for none.
    eliminated
        Number of groups of eliminated landmarks, which are the first ones.
    begin
        (G + 1,): first cell of each group.
    offset
        (G,): what is added to a cell of a group to get its view.
    pixels
        (C, 3 LANES): u and v, px, and 1 / sigma of each lane of a cell; 1 / sigma = 0: no pixel.
    correlated
        Whether errors of pixels add up along a track.
    """

    view_slot: IndexArray
    point_slot: IndexArray
    views: int
    shape: Envelope
    group: IndexArray
    lane: IndexArray
    landmark: IndexArray
    eliminated: int
    begin: IndexArray
    offset: IndexArray
    pixels: FloatArray
    correlated: bool


@kernel
def make_ordering(problem: FlatProblem) -> FlatOrdering:
    """Assign slots to the variables, sort landmarks and pixels into groups, and find the envelope."""
    view_slot, views = _numbered(problem.free_views, 0)
    free, joined = problem.free_points, problem.kept_points.copy()
    # The prior couples its landmarks, so that they cannot be eliminated as 3 x 3 blocks.
    for j in problem.prior_points:
        joined[j] = True
    apart = np.empty(len(free), np.bool_)
    for j in range(len(free)):
        apart[j], joined[j] = free[j] and not joined[j], free[j] and joined[j]
    point_slot, kept = _numbered(joined, views)
    group, lane, landmark, eliminated, begin, offset = _grouped(problem, apart)
    reach = np.arange(kept)
    for g in range(len(offset)):
        # The slots of the free views, in ascending order; none: from ``kept`` to -1.
        low, high = kept, -1
        for cell in range(begin[g], begin[g + 1]):
            slot = view_slot[cell + offset[g]]
            if slot >= 0:
                low, high = min(low, slot), slot
        # An eliminated landmark couples all views that see it; the Schur complement fills their blocks. Kept landmarks
        # are coupled with their views directly.
        if g >= eliminated:
            for k in range(LANES):
                j = landmark[g, k]
                high = max(high, point_slot[j]) if j >= 0 else high
        if low < kept:
            reach[low] = max(reach[low], high)
    for k in range(len(problem.motion_start)):
        a, b = view_slot[problem.motion_start[k]], view_slot[problem.motion_end[k]]
        if a >= 0 and b >= 0:
            reach[min(a, b)] = max(reach[min(a, b)], a, b)
    # The information matrix of the prior is dense: the first slot reaching the last one is enough, since
    # `make_envelope` lets all rows between them reach as far.
    low, high = kept, -1
    for slot in prior_slots(problem, view_slot, point_slot):
        low, high = min(low, slot), max(high, slot)
    if high >= 0:
        reach[low] = max(reach[low], high)
    pixels = np.zeros((begin[-1], 3 * LANES))
    for k in range(len(problem.seen_view)):
        j = problem.seen_point[k]
        cell, own = problem.seen_view[k] - offset[group[j]], lane[j]
        if pixels[cell, 2 * LANES + own] != 0.0:
            raise ValueError("a view has two pixels of one landmark")
        pixels[cell, own], pixels[cell, LANES + own] = problem.seen_px[k, 0], problem.seen_px[k, 1]
        pixels[cell, 2 * LANES + own] = 1.0 / problem.seen_sigma_px[k]
    shape = make_envelope(reach)
    correlated = len(problem.seen_walk_px2) > 0
    return FlatOrdering(
        view_slot, point_slot, views, shape, group, lane, landmark, eliminated, begin, offset, pixels, correlated
    )


@inner
def _numbered(mask: BoolArray, first: int) -> tuple[IndexArray, int]:
    """Assign numbers to the marked entries from ``first`` on, -1 elsewhere; also return the next number."""
    slots = np.empty(len(mask), np.int64)
    for i in range(len(mask)):
        slots[i] = first if mask[i] else -1
        first += int(mask[i])
    return slots, first


@inner
def _grouped(
    problem: FlatProblem, eliminated: BoolArray
) -> tuple[IndexArray, IndexArray, IndexArray, int, IndexArray, IndexArray]:
    """Sort landmarks into groups: first those marked in ``eliminated`` (L,), and those of the same views together.

    Returns ``group``, ``lane``, ``landmark``, ``eliminated``, ``begin`` and ``offset`` of `FlatOrdering`.
    """
    n, views = len(eliminated), len(problem.free_views)
    # Without measurements: from ``views`` to -1, no view at all.
    opens, closes = np.full(n, views), np.full(n, -1)
    for view, point in ((problem.seen_view, problem.seen_point), (problem.ranged_view, problem.ranged_point)):
        for k in range(len(view)):
            opens[point[k]] = min(opens[point[k]], view[k])
            closes[point[k]] = max(closes[point[k]], view[k])
            # Common errors move all pixels.
            if len(problem.seen_moved) > 0:
                closes[point[k]] = views - 1
    # A group has landmarks of one kind only.
    count, after, kind = 0, np.empty(n, np.int64), np.empty(n, np.int64)
    for j in range(n):
        count += int(eliminated[j])
        after[j], kind[j] = closes[j] + 1, opens[j] if eliminated[j] else opens[j] + views + 1
    order = _sorted_by(kind, _sorted_by(after, np.arange(n), views + 1), 2 * views + 2)
    full = (count + LANES - 1) // LANES
    groups = full + (n - count + LANES - 1) // LANES
    group, lane, landmark = np.empty(n, np.int64), np.empty(n, np.int64), np.full((groups, LANES), -1)
    begin, offset = np.zeros(groups + 1, np.int64), np.empty(groups, np.int64)
    for g in range(groups):
        rank, end = (g * LANES, count) if g < full else (count + (g - full) * LANES, n)
        first, last = views, -1
        for k in range(min(LANES, end - rank)):
            j = order[rank + k]
            group[j], lane[j], landmark[g, k] = g, k, j
            first, last = min(first, opens[j]), max(last, closes[j])
        begin[g + 1] = begin[g] + max(last + 1 - first, 0)
        offset[g] = first - begin[g]
    return group, lane, landmark, full, begin, offset


@inner
def _sorted_by(keys: IndexArray, order: IndexArray, count: int) -> IndexArray:
    """Sort an order (n,) by ``keys`` (n,) from 0 to ``count`` - 1; equal keys keep their order."""
    place = np.zeros(count + 1, np.int64)
    for key in keys:
        place[key + 1] += 1
    for key in range(count):
        place[key + 1] += place[key]
    result = np.empty_like(order)
    for j in order:
        result[place[keys[j]]] = j
        place[keys[j]] += 1
    return result


@inner
def prior_slots(problem: FlatProblem, view_slot: IndexArray, point_slot: IndexArray) -> IndexArray:
    """Return the slots (a + b,) of the variables of the prior."""
    views = len(problem.prior_views)
    slots = np.empty(views + len(problem.prior_points), np.int64)
    for k in range(len(slots)):
        slots[k] = view_slot[problem.prior_views[k]] if k < views else point_slot[problem.prior_points[k - views]]
    return slots

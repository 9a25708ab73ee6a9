"""An adjustment as the kernels take it: tuples of contiguous arrays."""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from estimators.slam.state import Adjustment, Prior, State

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

_Scalar = TypeVar("_Scalar", bound=np.generic)

_FLOAT, _INDEX, _BOOL = np.dtype(np.float64), np.dtype(np.int64), np.dtype(np.bool_)
_NO_STATE = State(np.zeros((0, 3)), np.zeros((0, 3)))
_NO_PRIOR = Prior(
    np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 0)), np.zeros(0)
)


class FlatProblem(NamedTuple):
    """`Adjustment` without its objects; ``pinhole`` is fx, fy, cx, cy. Frozen points of length 0: none are frozen."""

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


def flat(problem: Adjustment) -> FlatProblem:
    """Lay ``problem`` out for the kernels.

    Raises
    ------
    ValueError
        If its camera is no ideal pinhole: tracks come after the correction of a lens.
    """
    if problem.camera.distortion is not None:
        raise ValueError("adjustments know no distortion: correct the pixels for the lens first")
    camera, seen, ranged, moved = problem.camera, problem.sightings, problem.distances, problem.motions
    prior = _NO_PRIOR if problem.prior is None else problem.prior
    frozen = _NO_STATE if problem.frozen is None else problem.frozen
    kept = np.zeros(len(problem.free_points), dtype=np.bool_) if problem.kept_points is None else problem.kept_points
    return FlatProblem(
        pinhole=np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px]),
        attitudes=floats(problem.R_cam_body),
        seen_view=_plain(seen.view, _INDEX),
        seen_point=_plain(seen.point, _INDEX),
        seen_px=floats(seen.uv_px),
        seen_sigma_px=floats(seen.sigma_px),
        ranged_view=_plain(ranged.view, _INDEX),
        ranged_point=_plain(ranged.point, _INDEX),
        range_m=floats(ranged.range_m),
        range_sigma_m=floats(ranged.sigma_m),
        motion_start=_plain(moved.start, _INDEX),
        motion_end=_plain(moved.end, _INDEX),
        motion_m=floats(moved.displacement_m),
        motion_information=floats(moved.information),
        prior_views=_plain(prior.views, _INDEX),
        prior_points=_plain(prior.points, _INDEX),
        prior_origin_m=floats(prior.origin_m),
        prior_information=floats(prior.information),
        prior_gradient=floats(prior.gradient),
        frozen_positions_m=floats(frozen.positions_m),
        frozen_points_m=floats(frozen.points_m),
        free_views=_plain(problem.free_views, _BOOL),
        free_points=_plain(problem.free_points, _BOOL),
        kept_points=_plain(kept, _BOOL),
    )


def floats(values: FloatArray) -> FloatArray:
    """Return ``values`` as the one kind of array that the kernels are compiled for; a copy only if it is another."""
    return _plain(values, _FLOAT)


def _plain(values: NDArray[_Scalar], dtype: np.dtype[_Scalar]) -> NDArray[_Scalar]:
    """Copy what is read-only or strided: for another kind of array a kernel would be compiled once more."""
    if values.dtype is dtype and values.flags.carray:
        return values
    return np.array(values, dtype=dtype, order="C")

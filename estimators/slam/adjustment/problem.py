"""Bundle adjustment problem: state, measurements and prior, with views and landmarks numbered within the problem."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from boresight.estimators.slam.adjustment.compiled.problem import BOOL, INDEX, FlatProblem, floats, plain
from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.geometry import Camera


def _none() -> IndexArray:
    return np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Camera positions (V, 3) and landmarks (L, 3), m, body frame."""

    positions_m: FloatArray
    points_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class AddedErrors:
    """Errors of pixels that add up along a track: a random walk, and errors common to all tracks.

    Pixels of a landmark with the same ``branch`` (k,) share a walk, whose variance at each is ``walk_px2`` (k,); two of
    them have the smaller one as covariance. A pixel is that of the landmark plus ``moved`` (k, 2, 3), px/m, times three
    common numbers, which stand as position of the last view of the problem. ``moved`` (0, 2, 3): there are none.
    """

    branch: IndexArray
    walk_px2: FloatArray
    moved: FloatArray

    def subset(self, rows: BoolArray | IndexArray) -> AddedErrors:
        """Return those of the pixels in ``rows``, marked (k,) or in an order."""
        return AddedErrors(self.branch[rows], self.walk_px2[rows], self.moved[rows] if len(self.moved) else self.moved)


_NO_ERRORS = AddedErrors(_none(), np.zeros(0), np.zeros((0, 2, 3)))


@dataclass(frozen=True, slots=True, eq=False)
class PixelMeasurements:
    """Pixels of landmarks in views: (k,) view, (k,) point, (k, 2) pixel, (k,) sigma of a coordinate, px.

    ``added`` are the errors that add up along a track, and the pixels are then sorted by landmark and view; None: the
    errors of all pixels are independent.
    """

    view: IndexArray
    point: IndexArray
    uv_px: FloatArray
    sigma_px: FloatArray
    added: AddedErrors | None = None

    def subset(self, rows: BoolArray | IndexArray) -> PixelMeasurements:
        """Return those in ``rows``, marked (k,) or in an order."""
        added = None if self.added is None else self.added.subset(rows)
        return PixelMeasurements(self.view[rows], self.point[rows], self.uv_px[rows], self.sigma_px[rows], added)

    @property
    def whole_sigma_px(self) -> FloatArray:
        """(k,) standard deviation of a coordinate with what has added up, px."""
        return self.sigma_px if self.added is None else np.sqrt(self.sigma_px**2 + self.added.walk_px2)


@dataclass(frozen=True, slots=True, eq=False)
class Distances:
    """Distances from views to landmarks and their standard deviations, m; each (k,)."""

    view: IndexArray = field(default_factory=_none)
    point: IndexArray = field(default_factory=_none)
    range_m: FloatArray = field(default_factory=lambda: np.zeros(0))
    sigma_m: FloatArray = field(default_factory=lambda: np.zeros(0))

    def subset(self, rows: BoolArray) -> Distances:
        """Return those marked in ``rows`` (k,)."""
        return Distances(self.view[rows], self.point[rows], self.range_m[rows], self.sigma_m[rows])


@dataclass(frozen=True, slots=True, eq=False)
class Motions:
    """Predicted displacements (k, 3) from view to view, m, and the inverse covariances (k, 3, 3) of their errors."""

    start: IndexArray = field(default_factory=_none)
    end: IndexArray = field(default_factory=_none)
    displacement_m: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    information: FloatArray = field(default_factory=lambda: np.zeros((0, 3, 3)))


@dataclass(frozen=True, slots=True, eq=False)
class QuadraticPrior:
    """Prior as a quadratic cost of some views and landmarks: ``(x - x0)' H (x - x0) / 2 + g' (x - x0)``, views first.

    ``views`` (a,) and ``points`` (b,) are the variables by their numbers in the problem, ``origin_m`` (a + b, 3) is x0,
    the point of linearisation, ``information`` H (3 (a + b), 3 (a + b)), 1/m^2, and ``gradient`` g (3 (a + b),), 1/m.
    """

    views: IndexArray
    points: IndexArray
    origin_m: FloatArray
    information: FloatArray
    gradient: FloatArray

    @classmethod
    def of_first_position(cls, position_m: FloatArray, covariance_m2: FloatArray) -> QuadraticPrior:
        """Return the prior of view 0 by a position (3,) and the covariance (3, 3) of its error."""
        # The prior is a measurement of the position itself, so that x0 is its minimum and the gradient there is zero.
        information = np.asarray(np.linalg.inv(covariance_m2), dtype=np.float64)
        return cls(np.zeros(1, dtype=np.int64), _none(), position_m[None], information, np.zeros(3))

    def offset(self, state: State) -> FloatArray:
        """(3 (a + b),) x - x0 at ``state``, m."""
        here = np.concatenate([state.positions_m[self.views], state.points_m[self.points]])
        return np.asarray((here - self.origin_m).ravel(), dtype=np.float64)


_NO_STATE = State(np.zeros((0, 3)), np.zeros((0, 3)))
NO_PRIOR = QuadraticPrior(_none(), _none(), np.zeros((0, 3)), np.zeros((0, 0)), np.zeros(0))


@dataclass(frozen=True, eq=False)
class Adjustment:
    """Least-squares problem of views with known attitude and landmarks in Cartesian coordinates.

    ``R_cam_body`` (V, 3, 3) is the attitude of each view; the kernels refuse a camera with distortion. The depth gauge
    of equation (5) is one of the distances. ``free_views`` (V,) and ``free_points`` (L,) are what is solved for; the
    others are fixed. All points of a prior are free. ``kept_points`` (L,) are landmarks, besides those of the prior,
    that stay in the reduced system (Schur complement); None: none. ``frozen`` has the points of linearisation of the
    variables in the prior (first-estimates Jacobians), NaN for all others; None: all derivatives are taken at the
    present state.
    """

    camera: Camera
    R_cam_body: FloatArray
    pixels: PixelMeasurements
    free_views: BoolArray
    free_points: BoolArray
    distances: Distances = field(default_factory=Distances)
    motions: Motions = field(default_factory=Motions)
    prior: QuadraticPrior | None = None
    kept_points: BoolArray | None = None
    frozen: State | None = None

    @cached_property
    def flat(self) -> FlatProblem:
        """The problem as the arrays of the kernels; raises ValueError as `pinhole_of` does."""
        seen, ranged, moved = self.pixels, self.distances, self.motions
        prior = NO_PRIOR if self.prior is None else self.prior
        frozen = _NO_STATE if self.frozen is None else self.frozen
        kept = np.zeros(len(self.free_points), dtype=np.bool_) if self.kept_points is None else self.kept_points
        added = seen.added or _NO_ERRORS
        return FlatProblem(
            pinhole=pinhole_of(self.camera),
            attitudes=floats(self.R_cam_body),
            seen_view=plain(seen.view, INDEX),
            seen_point=plain(seen.point, INDEX),
            seen_px=floats(seen.uv_px),
            seen_sigma_px=floats(seen.sigma_px),
            ranged_view=plain(ranged.view, INDEX),
            ranged_point=plain(ranged.point, INDEX),
            range_m=floats(ranged.range_m),
            range_sigma_m=floats(ranged.sigma_m),
            motion_start=plain(moved.start, INDEX),
            motion_end=plain(moved.end, INDEX),
            motion_m=floats(moved.displacement_m),
            motion_information=floats(moved.information),
            prior_views=plain(prior.views, INDEX),
            prior_points=plain(prior.points, INDEX),
            prior_origin_m=floats(prior.origin_m),
            prior_information=floats(prior.information),
            prior_gradient=floats(prior.gradient),
            frozen_positions_m=floats(frozen.positions_m),
            frozen_points_m=floats(frozen.points_m),
            free_views=plain(self.free_views, BOOL),
            free_points=plain(self.free_points, BOOL),
            kept_points=plain(kept, BOOL),
            seen_branch=plain(added.branch, INDEX),
            seen_walk_px2=floats(added.walk_px2),
            seen_moved=floats(added.moved),
        )

    @property
    def prior_points(self) -> IndexArray:
        """(b,) landmarks of the prior; empty without one."""
        return _none() if self.prior is None else self.prior.points

    def linearisation_point(self, state: State) -> State:
        """Return ``state`` with the frozen variables at their first estimates."""
        if self.frozen is None:
            return state
        frozen = self.frozen
        # Variables of one prior must be linearised at one point (first-estimates Jacobians, Huang et al. 2010): with
        # two points the null space of scale and translation would shrink, and the estimate would gain information that
        # was not measured.
        return State(
            np.where(np.isnan(frozen.positions_m), state.positions_m, frozen.positions_m),
            np.where(np.isnan(frozen.points_m), state.points_m, frozen.points_m),
        )


def pinhole_of(camera: Camera) -> FloatArray:
    """(4,) fx, fy, cx, cy, px.

    Raise ValueError if the camera has distortion: pixels must be corrected for the lens before tracking.
    """
    if camera.distortion is not None:
        raise ValueError("the camera of an adjustment has distortion: correct the pixels for the lens first")
    return np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px])


@dataclass(frozen=True, slots=True, eq=False)
class AdjustedWindow:
    """Adjusted window: problem, state at the minimum, views by frame number, and ascending tracks (n,) of landmarks."""

    problem: Adjustment
    state: State
    views: tuple[int, ...]
    tracks: IndexArray

"""An adjustment with orbital dynamics: state, arcs of free motion between views, prior, and its solution.

Normal equations of eq. (3), Levenberg-Marquardt, covariance, marginalisation. The reduced system of the vision part is
a part of a larger dense system with velocities and force parameters.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from boresight.estimators.slam.adjustment.compiled.descent import reduced, step_landmarks
from boresight.estimators.slam.adjustment.compiled.envelope import dense, without
from boresight.estimators.slam.adjustment.compiled.equations import linearise
from boresight.estimators.slam.adjustment.compiled.problem import (
    FlatEquations,
    FlatOrdering,
    FlatProblem,
    floats,
    make_ordering,
)
from boresight.estimators.slam.adjustment.problem import Adjustment, State
from boresight.estimators.slam.adjustment.solver import Retained, StoppingRule, removed
from boresight.estimators.slam.force_model import ForceModel, propagate, propagate_with_derivatives
from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray

_WHITE_SHARE = 0.05
"""White noise of position and velocity, as part of their sigmas by the unknown acceleration."""

_WHITE_FLOOR = 1e-8
"""Least white noise, L."""


@dataclass(frozen=True, slots=True, eq=False)
class DynamicState:
    """Positions and landmarks in the body frame, velocities (V, 3) in inertial axes, parameters (2,); all in m.

    Velocities and parameters are in the units of a `ForceModel`.
    """

    vision: State
    velocities_m: FloatArray
    parameters_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Arcs:
    """Free motion (k,) from view to view, its durations (k,) in T, and the inverse covariances (k, 6, 6)."""

    start: IndexArray
    end: IndexArray
    duration: FloatArray
    information: FloatArray

    def of_view(self, view: int) -> Arcs:
        """Return the arcs that begin or end at a view."""
        rows = (self.start == view) | (self.end == view)
        return Arcs(self.start[rows], self.end[rows], self.duration[rows], self.information[rows])


@dataclass(frozen=True, slots=True, eq=False)
class DynamicPrior:
    """A quadratic ``(x - x0)' H (x - x0) / 2 + g' (x - x0)`` of some views, the parameters, and some landmarks.

    ``views`` (a,) and ``points`` (b,) are their numbers in the problem. ``origin_m`` (n,), ``information`` (n, n) and
    ``gradient`` (n,), with n = 6 a + 2 + 3 b, are of all positions, all velocities, the parameters, the landmarks.
    """

    views: IndexArray
    points: IndexArray
    origin_m: FloatArray
    information: FloatArray
    gradient: FloatArray

    def offset(self, state: DynamicState) -> FloatArray:
        """(n,) x - x0 at ``state``."""
        return gather(state, self.views, self.points) - self.origin_m


@dataclass(frozen=True, slots=True, eq=False)
class DynamicAdjustment:
    """Least-squares problem of views that are coupled by their orbital motion.

    ``vision`` has pixels and distances, without motions or a prior; its ``kept_points`` are those of `prior`, and its
    ``frozen`` are the first estimates of positions and landmarks. ``R_body_inertial`` (V, 3, 3) is that of each view.
    ``free_velocities`` (V,) and ``free_parameters`` (2,) are what is solved for. ``frozen_velocities_m`` (V, 3) and
    ``frozen_parameters_m`` (2,) are first estimates of the variables in the prior, where derivatives are taken; NaN
    elsewhere.
    """

    vision: Adjustment
    R_body_inertial: FloatArray
    field: ForceModel
    arcs: Arcs
    free_velocities: BoolArray
    free_parameters: BoolArray
    frozen_velocities_m: FloatArray
    frozen_parameters_m: FloatArray
    prior: DynamicPrior | None = None

    def linearisation_point(self, state: DynamicState) -> DynamicState:
        """Return ``state`` with the frozen variables at their first estimates."""
        v, p = self.frozen_velocities_m, self.frozen_parameters_m
        return DynamicState(
            self.vision.linearisation_point(state.vision),
            np.where(np.isnan(v), state.velocities_m, v),
            np.where(np.isnan(p), state.parameters_m, p),
        )

    def inertial(self, state: DynamicState) -> FloatArray:
        """(V, 6) positions and velocities in inertial axes."""
        # Landmarks are fixed in the body, orbits are smooth in inertial axes: positions are unknowns in body axes (for
        # the pixels) and rotated for the arcs.
        positions = np.einsum("vji,vj->vi", self.R_body_inertial, state.vision.positions_m)
        return np.concatenate([positions, state.velocities_m], axis=1)

    def arc_residuals(self, state: DynamicState) -> FloatArray:
        """(k, 6) state at the end of each arc minus the propagated one, inertial axes, not whitened."""
        at, arcs = self.inertial(state), self.arcs
        return np.asarray(
            at[arcs.end] - propagate(self.field, at[arcs.start], state.parameters_m, arcs.duration), dtype=np.float64
        )

    def arc_jacobians(self, state: DynamicState) -> FloatArray:
        """(k, 6, 14) of `arc_residuals` by positions of start and end (body), their velocities, and the parameters."""
        # First-estimates Jacobians, as for pixels: derivatives at the frozen point, residuals at the present state.
        where, arcs = self.linearisation_point(state), self.arcs
        start = self.inertial(where)[arcs.start]
        _, moved = propagate_with_derivatives(self.field, start, where.parameters_m, arcs.duration)
        turned = np.swapaxes(self.R_body_inertial, 1, 2)
        rows = np.zeros((len(arcs.start), 6, 14))
        # End minus propagated start: minus the state transition matrix for the start, the identity for the end;
        # positions through R_inertial_body of their view.
        rows[:, :, 0:3] = -moved[:, :, 0:3] @ turned[arcs.start]
        rows[:, :3, 3:6] = turned[arcs.end]
        rows[:, :, 6:9] = -moved[:, :, 3:6]
        rows[:, 3:, 9:12] = np.eye(3)
        rows[:, :, 12:14] = -moved[:, :, 6:8]
        return rows


def gather(state: DynamicState, views: IndexArray, points: IndexArray) -> FloatArray:
    """(6 a + 2 + 3 b,) the values of some views, the parameters, and some landmarks, in the order of a prior."""
    vision = state.vision
    return np.concatenate(
        [
            vision.positions_m[views].ravel(),
            state.velocities_m[views].ravel(),
            state.parameters_m,
            vision.points_m[points].ravel(),
        ]
    )


def arc_information(durations: FloatArray, acceleration_m: float, length_m: float) -> FloatArray:
    """(k, 6, 6) inverse covariances of the state at the end of an arc, due to a constant unknown acceleration.

    This is the discrete covariance of piecewise constant acceleration (Bar-Shalom et al. 2001, section 6.3.2); the
    gravity gradient changes it by less than 0.1 % over 2 deg of an orbit. It has rank 3 of 6, since the errors of
    position and velocity are fully correlated. White noise of 5 % of each sigma, at least 1e-8 of the distance, makes
    it invertible.

    ``durations`` (k,) are in T, ``acceleration_m`` is the standard deviation of a coordinate, m per T^2, and
    ``length_m`` is L.
    """
    # An acceleration a over dt displaces by a dt^2 / 2 and changes the velocity by a dt: the covariance is gain gain'.
    gain = acceleration_m * np.stack([0.5 * durations**2, durations], axis=1)
    covariance = gain[:, :, None] * gain[:, None, :]
    white = np.maximum(_WHITE_SHARE * gain, _WHITE_FLOOR * length_m)
    covariance[:, [0, 1], [0, 1]] += white**2
    # The axes are independent and alike: a 2 x 2 inverse for [position, velocity] serves all three.
    return np.asarray(np.kron(np.linalg.inv(covariance), np.eye(3)), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class DynamicOrdering:
    """Rows of the unknowns in the dense system, -1 for fixed ones.

    The order is that of the vision part's reduced system, then velocities, then parameters. ``flat`` is the vision
    part, ``ordering`` the order of its variables. ``position`` and ``velocity`` are (V, 3), ``parameters`` (2,), and
    ``point`` (L, 3), -1 for landmarks that are eliminated, too; ``count`` is the number of rows.
    """

    flat: FlatProblem
    ordering: FlatOrdering
    position: IndexArray
    velocity: IndexArray
    parameters: IndexArray
    point: IndexArray
    count: int

    @classmethod
    def of(cls, problem: DynamicAdjustment, part: FlatProblem | None = None) -> DynamicOrdering:
        """Assign rows to the unknowns of ``problem``, or of only a ``part`` of its pixels and distances."""
        flat = problem.vision.flat if part is None else part
        ordering = make_ordering(flat)
        # Kept views and landmarks first, in the order of the vision part, so that its reduced matrix can be added as
        # one block.
        after = 3 * len(ordering.shape.reach)
        velocity = _numbered(np.repeat(problem.free_velocities, 3), after).reshape(-1, 3)
        after += 3 * int(np.count_nonzero(problem.free_velocities))
        parameters = _numbered(problem.free_parameters, after)
        count = after + int(np.count_nonzero(problem.free_parameters))
        position, point = _threes(ordering.view_slot), _threes(ordering.point_slot)
        return cls(flat, ordering, position, velocity, parameters, point, count)

    def of_prior(self, views: IndexArray, points: IndexArray) -> IndexArray:
        """(6 a + 2 + 3 b,) rows in the order of a prior."""
        parts = [
            self.position[views].ravel(),
            self.velocity[views].ravel(),
            self.parameters,
            self.point[points].ravel(),
        ]
        return np.concatenate(parts)

    def of_arcs(self, start: IndexArray, end: IndexArray) -> IndexArray:
        """(k, 14) rows in the order of `DynamicAdjustment.arc_jacobians`."""
        parameters = np.broadcast_to(self.parameters, (len(start), 2))
        parts = [self.position[start], self.position[end], self.velocity[start], self.velocity[end], parameters]
        return np.concatenate(parts, axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class DynamicEquations:
    """Normal equations at a state: those of the vision part, and matrix (n, n) and gradient (n,) of arcs and prior.

    ``cost`` is half the sum of squares plus the prior; inf with a landmark behind its camera.
    """

    rows: DynamicOrdering
    vision: FlatEquations
    added: FloatArray
    gradient: FloatArray
    cost: float

    def reduced(self, damping: float = 0.0) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the dense matrix, the right-hand side, and the inverse blocks of the eliminated landmarks.

        Raise LinAlgError if a landmark is undetermined.
        """
        determined, values, part_right, inverse = reduced(self.vision, self.rows.ordering, damping)
        if not determined:
            raise LinAlgError("a landmark is not determined")
        joined = len(part_right)
        matrix, right = self.added.copy(), -self.gradient
        matrix[:joined, :joined] += dense(values, self.rows.ordering.shape)
        right[:joined] += part_right
        # The vision part has its damping already: it had to be added before the landmarks were eliminated.
        below = np.arange(joined, self.rows.count)
        matrix[below, below] += damping
        return matrix, right, inverse

    def stepped(self, state: DynamicState, step: FloatArray, inverse: FloatArray) -> tuple[DynamicState, float]:
        """Return ``state`` after the step (n,) and that of the eliminated landmarks, and the largest coordinate, m."""
        points = state.vision.points_m.copy()
        longest = step_landmarks(self.vision, self.rows.ordering, step, inverse, points)
        padded = np.append(step, 0.0)  # row -1: no step
        after = DynamicState(
            State(state.vision.positions_m + padded[self.rows.position], points + padded[self.rows.point]),
            state.velocities_m + padded[self.rows.velocity],
            state.parameters_m + padded[self.rows.parameters],
        )
        return after, float(max(np.abs(step).max(initial=0.0), longest))


def dynamic_equations(problem: DynamicAdjustment, state: DynamicState, rows: DynamicOrdering) -> DynamicEquations:
    """Linearise ``problem`` at ``state``."""
    bin_row = rows.count  # index -1 of the fixed unknowns: this row is dropped
    matrix, gradient = np.zeros((bin_row + 1, bin_row + 1)), np.zeros(bin_row + 1)
    at = rows.of_arcs(problem.arcs.start, problem.arcs.end)
    jacobians, residuals = problem.arc_jacobians(state), problem.arc_residuals(state)
    weighted = np.swapaxes(jacobians, 1, 2) @ problem.arcs.information
    # add.at, because an arc's end is the next one's start, and all share the parameters.
    np.add.at(matrix, (at[:, :, None], at[:, None, :]), weighted @ jacobians)
    np.add.at(gradient, at, np.einsum("kij,kj->ki", weighted, residuals))
    place = floats(state.vision.positions_m), floats(state.vision.points_m)
    half, vision = linearise(rows.flat, rows.ordering, *place)
    half += 0.5 * float(np.einsum("ki,kij,kj->", residuals, problem.arcs.information, residuals))
    prior = problem.prior
    if prior is not None:
        at, offset = rows.of_prior(prior.views, prior.points), prior.offset(state)
        pull = prior.information @ offset
        matrix[np.ix_(at, at)] += prior.information
        gradient[at] += pull + prior.gradient
        half += float((0.5 * pull + prior.gradient) @ offset)
    return DynamicEquations(rows, vision, matrix[:-1, :-1], gradient[:-1], half if np.isfinite(half) else float("inf"))


def _threes(slots: IndexArray) -> IndexArray:
    """(k, 3) rows of the 3-vectors in slots (k,); -1 for none."""
    return np.where(slots[:, None] >= 0, 3 * slots[:, None] + np.arange(3), -1)


def _numbered(mask: BoolArray, first: int) -> IndexArray:
    """Assign numbers to the marked entries from ``first``; -1 elsewhere."""
    return np.where(mask, first + np.cumsum(mask) - 1, -1).astype(np.int64)


@dataclass(frozen=True, slots=True)
class DynamicSolution:
    """State at the minimum, its cost, and the steps taken."""

    state: DynamicState
    cost: float
    iterations: int


def minimise_dynamic(problem: DynamicAdjustment, state: DynamicState, rule: StoppingRule) -> DynamicSolution:
    """Minimise the cost from ``state``; all unknowns are metres, and damping acts on all alike, eq. (4)."""
    system = dynamic_equations(problem, state, DynamicOrdering.of(problem))
    damping = 1e-6
    # Near the minimum rounding may increase the cost by some parts in 1e10, since the arcs have small covariances.
    # First-estimates Jacobians are not the derivatives of the cost, which may increase a little towards the state where
    # their gradient is zero; damping would only delay that.
    slack = 1e-10 if np.isnan(problem.frozen_parameters_m).all() else 1e-6
    for iteration in range(1, rule.iterations + 1):
        if not np.isfinite(system.cost):
            return DynamicSolution(state, system.cost, iteration)
        # Increase the damping until the cost does not increase.
        for _ in range(25):
            try:
                # Cholesky as the test for a positive definite matrix: if it fails, the damping is increased.
                matrix, right, inverse = system.reduced(damping)
                solved = cho_solve(cho_factor(matrix), right)
            except LinAlgError:
                damping *= 10.0
                continue
            trial, step = system.stepped(state, solved, inverse)
            # In one pass with the next equations, since most steps are accepted.
            ahead = dynamic_equations(problem, trial, system.rows)
            if ahead.cost <= system.cost + slack * abs(system.cost) + 1e-12:
                break
            damping *= 10.0
        else:
            # Without a step that decreases the cost the present state is the minimum within rounding.
            return DynamicSolution(state, system.cost, iteration)
        state, system, damping = trial, ahead, 0.1 * damping
        if step <= rule.step_m:
            return DynamicSolution(state, system.cost, iteration)
    return DynamicSolution(state, system.cost, rule.iterations)


def covariance_of(
    problem: DynamicAdjustment, state: DynamicState, wanted: IndexArray, rows: DynamicOrdering
) -> FloatArray:
    """(k, k) covariance of the unknowns in the rows ``wanted``, marginal over all others; zero for rows of -1.

    Raise LinAlgError if the matrix is not positive definite.
    """
    matrix, _, _ = dynamic_equations(problem, state, rows).reduced()
    columns = np.zeros((rows.count + 1, len(wanted)))
    columns[wanted, np.arange(len(wanted))] = 1.0
    # Solving for unit vectors gives columns of the inverse; the row of -1 stays zero.
    solved = np.zeros_like(columns)
    solved[:-1] = cho_solve(cho_factor(matrix), columns[:-1])
    covariance = solved[wanted]
    return np.asarray(0.5 * (covariance + covariance.T), dtype=np.float64)


def marginalise_dynamic(problem: DynamicAdjustment, state: DynamicState, view: int, lost: BoolArray) -> DynamicPrior:
    """Marginalise a view with its velocity, and the landmarks marked in ``lost`` (L,), linearised at ``state``.

    The prior covers all other views, the parameters, and the landmarks that a removed measurement constrains. Raise
    LinAlgError if the removed variables are not determined.
    """
    part = replace(problem, arcs=problem.arcs.of_view(view))
    stays = Retained.without_view(problem.vision, view, lost)
    rows = DynamicOrdering.of(part, removed(problem.vision.flat, stays))
    matrix, right, _ = dynamic_equations(part, state, rows).reduced()
    views = np.flatnonzero(np.arange(len(problem.R_body_inertial)) != view)
    points = np.flatnonzero(rows.flat.free_points & ~lost)
    kept = rows.of_prior(views, points)
    remaining = np.zeros(rows.count, dtype=np.bool_)
    remaining[kept[kept >= 0]] = True
    # All arcs of the view go with it, so that the prior couples position and velocity of the next view and the
    # parameters.
    known, information, gradient = without(matrix, -right, ~remaining)
    if not known:
        raise LinAlgError("the eliminated variables are not determined")
    place = np.append(np.cumsum(remaining) - 1, -1)[kept]  # fixed variables have rows of zeros
    padded = np.zeros((len(information) + 1, len(information) + 1))
    padded[:-1, :-1] = information
    return DynamicPrior(
        views, points, gather(state, views, points), padded[np.ix_(place, place)], np.append(gradient, 0.0)[place]
    )

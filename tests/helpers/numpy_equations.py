"""Residuals, cost and normal equations of an adjustment in numpy, reduced to the views by the Schur complement.

Variables are 3-vectors. *Kept* are the free views and the landmarks of the prior, which couples them; *eliminated* are
all other free landmarks: no measurement joins two of them, so that their part of the matrix is block-diagonal (3 x 3).

Pixels and distances depend only on landmark minus camera position, since the attitude is known: the derivative by the
position is the negative of that by the landmark. A residual is predicted minus measured.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.estimators.slam.adjustment.problem import Adjustment, State
from boresight.scenarios.arrays import FloatArray, IndexArray


def bearing_residuals(problem: Adjustment, state: State) -> FloatArray:
    """(k, 2) in standard deviations; NaN where a landmark is behind its camera."""
    seen = problem.pixels
    pixels = problem.camera.project(_in_camera(problem, state))
    return np.asarray((pixels - seen.uv_px) / seen.sigma_px[:, None], dtype=np.float64)


def bearing_jacobians(problem: Adjustment, state: State) -> FloatArray:
    """(k, 2, 3) of `bearing_residuals` by the landmark, 1/m."""
    seen = problem.pixels
    by_camera = problem.camera.jacobian(_in_camera(problem, state))
    return np.asarray(by_camera @ problem.R_cam_body[seen.view] / seen.sigma_px[:, None, None], dtype=np.float64)


def distance_residuals(problem: Adjustment, state: State) -> FloatArray:
    """(k,) in standard deviations: the last row of equation (5)."""
    measured = problem.distances
    lines = state.points_m[measured.point] - state.positions_m[measured.view]
    return np.asarray((np.linalg.norm(lines, axis=1) - measured.range_m) / measured.sigma_m, dtype=np.float64)


def distance_jacobians(problem: Adjustment, state: State) -> FloatArray:
    """(k, 1, 3) of `distance_residuals` by the landmark, 1/m."""
    measured = problem.distances
    lines = state.points_m[measured.point] - state.positions_m[measured.view]
    rows = lines / (np.linalg.norm(lines, axis=1) * measured.sigma_m)[:, None]
    return np.asarray(rows[:, None, :], dtype=np.float64)


def motion_residuals(problem: Adjustment, state: State) -> FloatArray:
    """(k, 3), m, not whitened: they are weighted by the information matrices."""
    moved = problem.motions
    steps = state.positions_m[moved.end] - state.positions_m[moved.start]
    return np.asarray(steps - moved.displacement_m, dtype=np.float64)


def cost(problem: Adjustment, state: State) -> float:
    """Return half the sum of squares, equation (2), plus the prior; inf with a landmark behind its camera."""
    bearings = bearing_residuals(problem, state)
    distances = distance_residuals(problem, state)
    motions = motion_residuals(problem, state)
    # Half of equation (2), so that the gradient is J' W r without a factor of 2. W is diagonal: 1 / sigma^2.
    total = np.sum(bearings**2) + np.sum(distances**2)
    total += np.einsum("ki,kij,kj->", motions, problem.motions.information, motions)
    half = 0.5 * float(total)
    if problem.prior is not None:
        offset = problem.prior.offset(state)
        half += float(0.5 * offset @ problem.prior.information @ offset + problem.prior.gradient @ offset)
    return half if np.isfinite(half) else float("inf")


def _in_camera(problem: Adjustment, state: State) -> FloatArray:
    """(k, 3) landmark minus camera position of all pixel measurements, camera axes."""
    seen = problem.pixels
    lines = state.points_m[seen.point] - state.positions_m[seen.view]
    return np.asarray(np.einsum("kij,kj->ki", problem.R_cam_body[seen.view], lines), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class VariableOrdering:
    """Order of the variables: their slots, -1 for none, and which measurements share an eliminated landmark.

    Parameters
    ----------
    view, kept_point
        (V,), (L,): slots among the kept variables.
    eliminated_point
        (L,): slots among the eliminated landmarks.
    kept, eliminated
        Number of kept variables and of eliminated landmarks.
    link_kept, link_eliminated
        (m,), (m,): the kept and the eliminated slot of each 3 x 3 block of the coupling matrix.
    left, right
        (q,), (q,): pairs of coupling blocks with the same eliminated landmark; each adds a block to the reduced matrix.
    """

    view: IndexArray
    kept_point: IndexArray
    eliminated_point: IndexArray
    kept: int
    eliminated: int
    link_kept: IndexArray
    link_eliminated: IndexArray
    left: IndexArray
    right: IndexArray

    @classmethod
    def of(cls, problem: Adjustment) -> VariableOrdering:
        """Return the ordering of the variables of ``problem``."""
        joined = np.zeros(len(problem.free_points), dtype=np.bool_)
        if problem.kept_points is not None:
            joined |= problem.kept_points
        if problem.prior is not None:
            joined[problem.prior.points] = True
        view = _slots(problem.free_views)
        views = int(np.count_nonzero(problem.free_views))
        kept_point = _slots(problem.free_points & joined)
        kept = views + int(kept_point.max(initial=-1)) + 1
        kept_point = np.where(kept_point >= 0, kept_point + views, -1)
        eliminated_point = _slots(problem.free_points & ~joined)
        pair_view, pair_point = _pairs(problem)
        linked = (view[pair_view] >= 0) & (eliminated_point[pair_point] >= 0)
        left, right = _meetings(eliminated_point[pair_point[linked]])
        return cls(
            view=view,
            kept_point=kept_point,
            eliminated_point=eliminated_point,
            kept=kept,
            eliminated=int(eliminated_point.max(initial=-1)) + 1,
            link_kept=view[pair_view[linked]],
            link_eliminated=eliminated_point[pair_point[linked]],
            left=left,
            right=right,
        )


@dataclass(frozen=True, slots=True, eq=False)
class NormalEquations:
    """Normal matrix and gradient by blocks: kept (3n, 3n), eliminated (e, 3, 3), coupling blocks (m, 3, 3)."""

    ordering: VariableOrdering
    kept: FloatArray
    eliminated: FloatArray
    coupling: FloatArray
    kept_gradient: FloatArray
    eliminated_gradient: FloatArray

    def reduced(self, damping: float = 0.0) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the reduced matrix and right-hand side (Schur complement), and the inverse eliminated blocks.

        ``damping`` is the lambda of equation (4), added to the whole diagonal before the reduction.

        Raises
        ------
        numpy.linalg.LinAlgError
            If the distance of a landmark is undetermined and ``damping`` is 0.
        """
        ordering = self.ordering
        inverse = np.asarray(np.linalg.inv(self.eliminated + damping * np.eye(3)), dtype=np.float64)
        # Schur complement: (B - W V^-1 W') dx = W V^-1 g_e - g_k, with B kept, V eliminated (3 x 3 blocks), W coupling.
        weighted = self.coupling @ inverse[ordering.link_eliminated]
        product = weighted[ordering.left] @ np.swapaxes(self.coupling[ordering.right], 1, 2)
        slots = ordering.link_kept[ordering.left] * ordering.kept + ordering.link_kept[ordering.right]
        matrix = self.kept + damping * np.eye(3 * ordering.kept) - _dense(_scatter(slots, product, ordering.kept**2))
        taken = np.einsum("kij,kj->ki", weighted, self.eliminated_gradient[ordering.link_eliminated])
        right = _scatter(ordering.link_kept, taken, ordering.kept).ravel() - self.kept_gradient
        # Blocks above and below the diagonal are computed separately, and differ by rounding.
        return 0.5 * (matrix + matrix.T), right, inverse

    def back_substituted(self, kept_step: FloatArray, inverse: FloatArray) -> FloatArray:
        """(e, 3) steps of the eliminated landmarks, given (n, 3) those of the kept variables."""
        ordering = self.ordering
        # Lower row of the normal equations: V de = -g_e - W' dx.
        moved = np.einsum("kji,kj->ki", self.coupling, kept_step[ordering.link_kept])
        right = -self.eliminated_gradient - _scatter(ordering.link_eliminated, moved, ordering.eliminated)
        return np.asarray(np.einsum("kij,kj->ki", inverse, right), dtype=np.float64)

    def stepped(self, state: State, kept_step: FloatArray, eliminated_step: FloatArray) -> State:
        """Return ``state`` after the steps (n, 3) and (e, 3)."""
        ordering = self.ordering
        steps = np.concatenate([kept_step, np.zeros((1, 3))])  # slot -1: no step
        points = state.points_m + steps[ordering.kept_point]
        points += np.concatenate([eliminated_step, np.zeros((1, 3))])[ordering.eliminated_point]
        return State(state.positions_m + steps[ordering.view], points)


def normal_equations(problem: Adjustment, state: State, ordering: VariableOrdering) -> NormalEquations:
    """Linearise ``problem`` at ``state``: J' W J and J' W f of equation (3), by blocks."""
    view, point = _pairs(problem)
    blocks, gradients = _pair_terms(problem, state)
    n = ordering.kept
    cells, values = _kept_cells(problem, ordering, blocks)
    kept = _dense(_scatter(cells, values, n * n))
    kept_gradient = _add_motion(problem, state, ordering, kept)
    kept_gradient += _kept_gradient(ordering, view, point, gradients)
    _add_prior(problem, state, ordering, kept, kept_gradient)
    slot = ordering.eliminated_point[point]
    eliminated = slot >= 0
    linked = eliminated & (ordering.view[view] >= 0)
    return NormalEquations(
        ordering=ordering,
        kept=kept,
        eliminated=_scatter(slot[eliminated], blocks[eliminated], ordering.eliminated),
        # The derivative by the view is -A: the block is -A'A.
        coupling=-blocks[linked],
        kept_gradient=kept_gradient.ravel(),
        eliminated_gradient=_scatter(slot[eliminated], gradients[eliminated], ordering.eliminated),
    )


def _pairs(problem: Adjustment) -> tuple[IndexArray, IndexArray]:
    """(m,) view and (m,) landmark of every pixel, then of every distance."""
    view = np.concatenate([problem.pixels.view, problem.distances.view])
    return view, np.concatenate([problem.pixels.point, problem.distances.point])


def _pair_terms(problem: Adjustment, state: State) -> tuple[FloatArray, FloatArray]:
    """(m, 3, 3) A'A and (m, 3) A'r of every measurement of `_pairs`, A by the landmark."""
    # First-estimates Jacobians: A at the frozen point, the residual always at the present state.
    where = problem.linearisation_point(state)
    terms = [
        (bearing_jacobians(problem, where), bearing_residuals(problem, state)),
        (distance_jacobians(problem, where), distance_residuals(problem, state)[:, None]),
    ]
    blocks = [np.einsum("kri,krj->kij", rows, rows) for rows, _ in terms]
    gradients = [np.einsum("kri,kr->ki", rows, residuals) for rows, residuals in terms]
    return np.concatenate(blocks), np.concatenate(gradients)


def _kept_cells(problem: Adjustment, ordering: VariableOrdering, blocks: FloatArray) -> tuple[IndexArray, FloatArray]:
    """Block indices (row * n + column) of the kept matrix that measurements add to, and their 3 x 3 blocks."""
    view, point = _pairs(problem)
    i, j = ordering.view[view], ordering.kept_point[point]
    both = (i >= 0) & (j >= 0)
    n = ordering.kept
    cells = [i[i >= 0] * (n + 1), j[j >= 0] * (n + 1), i[both] * n + j[both], j[both] * n + i[both]]
    values = [blocks[i >= 0], blocks[j >= 0], -blocks[both], -blocks[both]]
    return np.concatenate(cells), np.concatenate(values)


def _kept_gradient(
    ordering: VariableOrdering, view: IndexArray, point: IndexArray, gradients: FloatArray
) -> FloatArray:
    """(n, 3) gradient of the cost of pixels and distances by the kept variables."""
    i, j = ordering.view[view], ordering.kept_point[point]
    slots = np.concatenate([i[i >= 0], j[j >= 0]])
    return _scatter(slots, np.concatenate([-gradients[i >= 0], gradients[j >= 0]]), ordering.kept)


def _add_motion(problem: Adjustment, state: State, ordering: VariableOrdering, kept: FloatArray) -> FloatArray:
    """Add the predicted motions to the kept matrix in place; return their gradient, (n, 3)."""
    gradient = np.zeros((ordering.kept, 3))
    motions = problem.motions
    pulls = np.einsum("kij,kj->ki", motions.information, motion_residuals(problem, state))
    for start, end, information, pull in zip(motions.start, motions.end, motions.information, pulls, strict=True):
        slots = {1.0: ordering.view[end], -1.0: ordering.view[start]}
        for sign, a in slots.items():
            if a < 0:
                continue
            gradient[a] += sign * pull
            for other, b in slots.items():
                if b >= 0:
                    kept[3 * a : 3 * a + 3, 3 * b : 3 * b + 3] += sign * other * information
    return gradient


def _add_prior(
    problem: Adjustment, state: State, ordering: VariableOrdering, kept: FloatArray, gradient: FloatArray
) -> None:
    """Add the prior to the kept matrix and gradient in place."""
    prior = problem.prior
    if prior is None:
        return
    slots = np.concatenate([ordering.view[prior.views], ordering.kept_point[prior.points]])
    rows = (3 * slots[:, None] + np.arange(3)).ravel()
    kept[np.ix_(rows, rows)] += prior.information
    pull = prior.information @ prior.offset(state) + prior.gradient
    gradient[slots] += pull.reshape(-1, 3)


def _slots(mask: NDArray[np.bool_]) -> IndexArray:
    """Assign numbers to the marked entries from 0; -1 elsewhere."""
    return np.where(mask, np.cumsum(mask) - 1, -1).astype(np.int64)


def _meetings(groups: IndexArray) -> tuple[IndexArray, IndexArray]:
    """All ordered pairs (a, b) of entries of the same group, a = b included."""
    order = np.argsort(groups, kind="stable")
    counts = np.bincount(groups)
    counts = counts[counts > 0]
    first = np.repeat(np.cumsum(counts) - counts, counts)
    size = np.repeat(counts, counts)
    left = np.repeat(np.arange(len(groups)), size)
    within = np.arange(len(left)) - np.repeat(np.cumsum(size) - size, size)
    return order[left], order[np.repeat(first, size) + within]


def _scatter(slots: IndexArray, values: FloatArray, count: int) -> FloatArray:
    """Sum ``values`` (m, ...) by slot into (count, ...); the order of addition, and so the rounding, is fixed."""
    shape = values.shape[1:]
    width = int(np.prod(shape, dtype=np.int64))
    cells = (slots[:, None] * width + np.arange(width)).ravel()
    summed = np.bincount(cells, weights=values.ravel(), minlength=count * width)
    return np.asarray(summed.reshape(count, *shape), dtype=np.float64)  # bincount of nothing returns integers


def _dense(blocks: FloatArray) -> FloatArray:
    """Arrange (n * n, 3, 3) blocks as one (3n, 3n) matrix."""
    n = int(np.sqrt(len(blocks)))
    return np.ascontiguousarray(blocks.reshape(n, n, 3, 3).transpose(0, 2, 1, 3).reshape(3 * n, 3 * n))

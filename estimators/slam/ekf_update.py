"""Updates of EKF-SLAM: the extended Kalman filter's, and the iterated one's, which is Gauss-Newton."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from estimators.slam.ekf_measure import Innovation, Sight
from estimators.slam.ekf_state import FilterState

FloatArray = NDArray[np.float64]

AnyState = TypeVar("AnyState", bound=FilterState)

_SHORTEST = 1e-3


@dataclass(frozen=True, slots=True)
class Iteration:
    """At most so many steps; it ends where the cost falls by less than ``tolerance`` (chi-square has 1 a degree)."""

    steps: int
    tolerance: float = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class _Place:
    """A state on the way, how far it is from the prediction by the inverse of its covariance, and what it costs."""

    state: FilterState
    pull: FloatArray
    cost: float


def updated(state: AnyState, innovation: Innovation) -> tuple[AnyState, float]:
    """Update by all measurements at once; return the state and the squared normalised innovation.

    With S = L L', the covariance loses W' W, W = L^-1 H P: symmetric by construction, and 6 times cheaper than Joseph's
    form at 20 landmarks.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the covariance of the innovation is not positive definite.
    """
    factor, crossed = _factored(state.covariance, innovation)
    white = solve_triangular(factor, innovation.residual, lower=True, check_finite=False)
    weighted = solve_triangular(factor, crossed.T, lower=True, check_finite=False)
    moved = replace(state, x=state.x + weighted.T @ white, covariance=state.covariance - weighted.T @ weighted)
    return moved.folded(), float(white @ white)


def iterated(state: FilterState, sight: Sight, rule: Iteration) -> tuple[FilterState, float]:
    """Update at the minimum of prediction and measurements together; return the state and the least cost.

    Gauss-Newton from the prediction x0: ``x = x0 + K (z - h(x_i) - H_i (x0 - x_i))`` (Bell and Cathey 1993), halved
    until the cost does not grow. The cost of leaving x0 is had without inverting its covariance P, which is singular
    while landmarks share an anchor: every x is x0 + P a, and costs a' (x - x0).

    Raises
    ------
    numpy.linalg.LinAlgError
        If the covariance of an innovation is not positive definite.
    """
    start, covariance = state.x, state.covariance
    place = _place(state, start, np.zeros(len(start)), sight)
    for _ in range(rule.steps):
        innovation = sight.innovation(place.state)
        factor, crossed = _factored(covariance, innovation)
        target = innovation.residual + innovation.jacobian @ (place.state.x - start)
        multipliers = cho_solve((factor, True), target, check_finite=False)
        end = (start + crossed @ multipliers, innovation.jacobian.T @ multipliers)
        better = _shortened(place, end, start, sight)
        if better is None:
            break
        fallen, place = place.cost - better.cost, better
        if fallen < rule.tolerance:
            break
    factor, crossed = _factored(covariance, sight.innovation(place.state))
    weighted = solve_triangular(factor, crossed.T, lower=True, check_finite=False)
    return replace(place.state, covariance=covariance - weighted.T @ weighted).folded(), place.cost


def innovation_covariance(state: FilterState, innovation: Innovation) -> FloatArray:
    """(m, m) S = H P H' + R."""
    H = innovation.jacobian
    S = H @ state.covariance @ H.T + np.diag(innovation.variance)
    return np.asarray(0.5 * (S + S.T), dtype=np.float64)


def _factored(covariance: FloatArray, innovation: Innovation) -> tuple[FloatArray, FloatArray]:
    """Return the lower Cholesky factor of S, and P H' (n, m)."""
    crossed = covariance @ innovation.jacobian.T
    S = innovation.jacobian @ crossed
    S[np.diag_indices_from(S)] += innovation.variance
    if not np.isfinite(S).all():
        raise np.linalg.LinAlgError("the innovation is not finite")
    factor, _ = cho_factor(0.5 * (S + S.T), lower=True, check_finite=False)
    return np.tril(factor), crossed


def _place(
    template: FilterState, start: FloatArray, pull: FloatArray, sight: Sight, x: FloatArray | None = None
) -> _Place:
    state = template if x is None else replace(template, x=x)
    residual = sight.residual(state)
    cost = float(np.sum(residual**2 / sight.variance) + pull @ (state.x - start))
    sound = np.isfinite(cost) and bool(np.all(state.landmarks[:, 2] > 0.0))
    return _Place(state, pull, cost if sound else float("inf"))


def _shortened(place: _Place, end: tuple[FloatArray, FloatArray], start: FloatArray, sight: Sight) -> _Place | None:
    """Go towards ``end``, half as far each time until the cost does not grow; None if it does however near."""
    x, pull = end
    share = 1.0
    while share > _SHORTEST:
        found = _place(
            place.state,
            start,
            place.pull + share * (pull - place.pull),
            sight,
            place.state.x + share * (x - place.state.x),
        )
        if found.cost <= place.cost * (1.0 + 1e-9):
            return found
        share *= 0.5
    return None

"""Gauss-Newton steps of the batch filter: landmarks eliminated, then a Cholesky factor of what is left."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from estimators.orbit.elimination import shared_links, subtract_landmarks, whitened
from estimators.orbit.model import Model, Passes, Sightings, Unknowns
from scenarios.dynamics.propagation import OrbitLostError
from scenarios.dynamics.variational import OrbitPartials

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_POINT_DAMPING = 1.0 / 20_000.0**2
_DAMPING_FIRST = 1e-3
_MOST_DAMPING = 1e8


@dataclass(frozen=True, slots=True, eq=False)
class Robust:
    """Huber's loss of a sighting's length in sigmas; ``limit`` infinite for least squares.

    Parameters
    ----------
    limit
        Beyond it, in units of ``scale``, the loss grows linearly.
    scale
        Of what is expected, in sigmas: far from the solution all are far off.
    """

    limit: float
    scale: float

    def weights(self, lengths: FloatArray) -> FloatArray:
        """(k,) of iteratively reweighted least squares."""
        if not np.isfinite(self.limit):
            return np.full(len(lengths), self.scale**-2)
        edge = self.limit * self.scale
        return np.asarray(edge / np.maximum(lengths, edge) / self.scale**2)

    def cost(self, lengths: FloatArray) -> float:
        """Half the sum of squares, or what stands for it."""
        if not np.isfinite(self.limit):
            return 0.5 * float(lengths @ lengths) / self.scale**2
        edge = self.limit * self.scale
        inner = np.minimum(lengths, edge)
        return float(np.sum(0.5 * inner**2 + edge * (lengths - inner))) / self.scale**2


@dataclass(frozen=True, slots=True, eq=False)
class Linear:
    """A model about some unknowns: its residuals with derivatives, and what they cost."""

    unknowns: Unknowns
    flown: OrbitPartials
    sightings: Sightings
    passes: Passes
    lengths: FloatArray
    cost: float


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """Of landmarks: (L, 3) places and (L,) 1 / sigma^2, 0 where they are free."""

    points: FloatArray
    information: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """A Gauss-Newton step, the decrease of the cost that it promises, and the factor of the reduced matrix."""

    x: FloatArray
    tilts: FloatArray
    points: FloatArray
    promised: float
    factor: FloatArray


@dataclass(frozen=True, slots=True)
class Limits:
    """When to end: after so many steps, or when the cost would fall by less than a tolerance and a share of itself."""

    steps: int
    tolerance: float
    share: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Adjusted:
    """Where the steps ended."""

    linear: Linear
    step: Step
    converged: bool
    steps: int

    def covariance(self, size: int) -> FloatArray:
        """(n, n) of the shared unknowns, by the last rows of the factor: their square-root information."""
        root = np.triu(self.step.factor[-size:, -size:])
        inverse = solve_triangular(root, np.eye(size))
        return np.asarray(inverse @ inverse.T)


def linearise(model: Model, prior: Prior, unknowns: Unknowns, robust: Robust) -> Linear:
    """Work out residuals and derivatives.

    Raises
    ------
    OrbitLostError
        If the orbit leads into the body.
    """
    flown = model.fly(unknowns.x)
    sightings, passes = model.sightings(unknowns, flown), model.passes(unknowns.x, flown)
    lengths = np.linalg.norm(sightings.residuals, axis=1) / model.measured.sigma_px
    known = model.layout.knowledge
    cost = robust.cost(lengths[sightings.in_front]) + robust.cost(np.full(int((~sightings.in_front).sum()), 1e4))
    cost += 0.5 * float(passes.residuals @ passes.residuals)
    cost += 0.5 * float(unknowns.x @ model.layout.information @ unknowns.x)
    cost += 0.5 * float(np.sum((unknowns.tilts / known.attitude_sigma_rad) ** 2))
    cost += 0.5 * float(np.sum(prior.information[:, None] * (unknowns.points - prior.points) ** 2))
    return Linear(unknowns, flown, sightings, passes, lengths, cost)


def step_from(model: Model, prior: Prior, here: Linear, robust: Robust, damping: float) -> Step:
    """Solve the normal equations, whose diagonal is raised by ``damping`` times itself.

    Pan and tilt of each image and the landmarks' places are eliminated in turn: the landmarks by blocks, and of the
    Cholesky factor of the rest the images' rows come first, so that its last rows are the square-root information of
    the shared unknowns alone.
    """
    measured, known = model.measured, model.layout.knowledge
    unknowns, n = here.unknowns, model.layout.size
    images = len(measured.times_s)
    weights = np.where(here.sightings.in_front, robust.weights(here.lengths), 0.0)
    scale = (np.sqrt(weights) / measured.sigma_px)[:, None]
    residuals = here.sightings.residuals * scale
    by_image, by_point = here.sightings.by_image * scale[..., None], here.sightings.by_point * scale[..., None]

    held = prior.information + _POINT_DAMPING * (1.0 + damping * 1e4)
    factors, pulls, links = whitened(measured.begin, by_point, by_image, residuals, held)
    if np.any(prior.information):
        toward = (prior.information[:, None] * (prior.points - unknowns.points))[..., None]
        pulls = pulls + _solved(factors, toward)[..., 0]

    shared = model.shared(unknowns, here.flown)
    common = shared_links(measured.begin, measured.image, links, shared)
    normal = np.zeros((images, 7, 7))
    np.add.at(normal, measured.image, np.swapaxes(by_image, 1, 2) @ by_image)
    pull = np.zeros((images, 7))
    np.add.at(pull, measured.image, np.einsum("krc,kr->kc", by_image, residuals))

    size = 2 * images + n
    matrix = np.zeros((size, size))
    carried = normal @ shared
    rows = np.arange(images)
    for r in range(2):
        for s in range(2):
            matrix[2 * rows + r, 2 * rows + s] = normal[:, 3 + r, 3 + s]
    diagonal = np.arange(2 * images)
    matrix[diagonal, diagonal] += 1.0 / known.attitude_sigma_rad**2
    matrix[2 * images :, : 2 * images] = carried[:, 3:5].reshape(2 * images, n).T
    flat = common.reshape(-1, n)
    by_pass = here.passes.by_shared
    matrix[2 * images :, 2 * images :] = (
        shared.reshape(-1, n).T @ carried.reshape(-1, n)
        - flat.T @ flat
        + by_pass.T @ by_pass
        + model.layout.information
    )
    subtract_landmarks(matrix, measured.begin, measured.image, links, common)

    reduced = pull.copy()
    np.subtract.at(reduced, measured.image, np.einsum("kcd,kd->kc", links, pulls[measured.point]))
    right = np.concatenate(
        [
            (reduced[:, 3:5] - unknowns.tilts / known.attitude_sigma_rad**2).ravel(),
            shared.reshape(-1, n).T @ pull.ravel()
            - flat.T @ pulls.ravel()
            + by_pass.T @ here.passes.residuals
            - model.layout.information @ unknowns.x,
        ]
    )
    every = np.arange(size)
    matrix[every, every] *= 1.0 + damping
    # The transpose lies in memory as LAPACK wants it: nothing is copied.
    factor, _ = cho_factor(matrix.T, lower=False, overwrite_a=True, check_finite=False)
    moved = cho_solve((factor, False), right, check_finite=False)
    x, tilts = moved[2 * images :], moved[: 2 * images].reshape(-1, 2)

    by_common = np.einsum("ldp,p->ld", common, x)
    np.add.at(by_common, measured.point, np.einsum("krd,kr->kd", links[:, 3:5], tilts[measured.image]))
    whitened_points = pulls - by_common
    points = _solved(np.swapaxes(factors, 1, 2), whitened_points[..., None])[..., 0]
    promised = 0.5 * float(right @ moved + np.sum(pulls**2))
    return Step(x, tilts, points, promised, factor)


def _solved(matrices: FloatArray, right: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.solve(matrices, right))


def adjust(model: Model, prior: Prior, start: Unknowns, robust: Robust, limits: Limits) -> Adjusted:
    """Take Gauss-Newton steps, damped where they fail, until one promises too little to be worth another.

    Raises
    ------
    OrbitLostError
        If the orbit that it begins with leads into the body.
    """
    here, damping = linearise(model, prior, start, robust), 0.0
    step = step_from(model, prior, here, robust, damping)
    for count in range(1, limits.steps + 1):
        little = step.promised < limits.tolerance + limits.share * here.cost
        moved = Unknowns(start.x + step.x, start.tilts + step.tilts, start.points + step.points)
        there = _tried(model, prior, moved, robust)
        if there is None or there.cost > here.cost * (1.0 + 1e-9):
            if little:
                return Adjusted(here, step, True, count)
            damping = max(_DAMPING_FIRST, 10.0 * damping)
            if damping > _MOST_DAMPING:
                return Adjusted(here, step, False, count)
        else:
            done = little and damping <= _DAMPING_FIRST
            start, here = moved, there
            damping = 0.0 if damping <= _DAMPING_FIRST else 0.1 * damping
            if done:
                return Adjusted(here, step, True, count)
        step = step_from(model, prior, here, robust, damping)
    return Adjusted(here, step, False, limits.steps)


def _tried(model: Model, prior: Prior, unknowns: Unknowns, robust: Robust) -> Linear | None:
    try:
        return linearise(model, prior, unknowns, robust)
    except OrbitLostError:
        return None

"""Gauss-Newton adjustment of the batch filter: the landmarks are eliminated, the rest is solved by Cholesky."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from boresight.estimators.orbit.kernels import shared_links, subtract_landmarks, whiten_landmarks
from boresight.estimators.orbit.model import MeasurementModel, SightingResiduals, TrackingResiduals, Unknowns
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.dynamics.propagation import OrbitLostError, OrbitPartials

# Information of a landmark before its sightings, 1 / (20 km)^2: with parallel rays alone the matrix stays regular.
_POINT_DAMPING = 1.0 / 20_000.0**2
_DAMPING_FIRST = 1e-3
_MAX_DAMPING = 1e8


@dataclass(frozen=True, slots=True, eq=False)
class HuberLoss:
    """Huber's loss of a sighting's residual length in sigmas; least squares if ``limit`` is infinite.

    Beyond ``limit``, in units of ``scale``, the loss grows linearly. ``scale`` is a factor on the expected sigmas: far
    from the solution all residuals are large.
    """

    limit: float
    scale: float

    def weights(self, lengths: FloatArray) -> FloatArray:
        """Return the weights (k,) of iteratively reweighted least squares."""
        if not np.isfinite(self.limit):
            return np.full(len(lengths), self.scale**-2)
        edge = self.limit * self.scale
        # Derivative of the loss over the length: the same step as of the loss itself, by weighted least squares.
        return np.asarray(edge / np.maximum(lengths, edge) / self.scale**2)

    def cost(self, lengths: FloatArray) -> float:
        """Return half the sum of squares, with Huber's loss beyond the limit."""
        if not np.isfinite(self.limit):
            return 0.5 * float(lengths @ lengths) / self.scale**2
        edge = self.limit * self.scale
        inner = np.minimum(lengths, edge)
        return float(np.sum(0.5 * inner**2 + edge * (lengths - inner))) / self.scale**2


@dataclass(frozen=True, slots=True, eq=False)
class Linearisation:
    """Residuals with derivatives and the cost, at given values of the unknowns."""

    unknowns: Unknowns
    flown: OrbitPartials
    sightings: SightingResiduals
    passes: TrackingResiduals
    lengths: FloatArray
    cost: float


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkPrior:
    """Prior of the landmarks: positions (L, 3) and information (L,) 1 / sigma^2, 0 where they are free."""

    points: FloatArray
    information: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class GaussNewtonStep:
    """A Gauss-Newton step, the decrease of the cost that it predicts, and the Cholesky factor of the reduced matrix."""

    x: FloatArray
    tilts: FloatArray
    points: FloatArray
    promised: float
    factor: FloatArray


@dataclass(frozen=True, slots=True)
class StoppingCriteria:
    """Stop after ``steps``, or if the predicted decrease is less than ``tolerance + share * cost``."""

    steps: int
    tolerance: float
    share: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class GaussNewtonResult:
    """The last linearisation and step of an adjustment."""

    linear: Linearisation
    step: GaussNewtonStep
    converged: bool
    steps: int

    def covariance(self, size: int) -> FloatArray:
        """Return the (n, n) covariance of the shared unknowns.

        They are last in the order of elimination, so the last rows of the factor are their square-root information.
        """
        root = np.triu(self.step.factor[-size:, -size:])
        # With the information R^T R the covariance is R^-1 R^-T.
        inverse = solve_triangular(root, np.eye(size))
        return np.asarray(inverse @ inverse.T)


def linearise(model: MeasurementModel, prior: LandmarkPrior, unknowns: Unknowns, robust: HuberLoss) -> Linearisation:
    """Compute residuals, derivatives and cost; raise OrbitLostError if the orbit hits the body."""
    flown = model.propagate(unknowns.x)
    sightings, passes = model.sightings(unknowns, flown), model.tracking(unknowns.x, flown)
    lengths = np.linalg.norm(sightings.residuals, axis=1) / model.measured.sigma_px
    known = model.layout.knowledge
    # A landmark behind the camera costs as much as a residual of 10 000 sigma: steps that put one there are refused as
    # a rule.
    cost = robust.cost(lengths[sightings.in_front]) + robust.cost(np.full(int((~sightings.in_front).sum()), 1e4))
    cost += 0.5 * float(passes.residuals @ passes.residuals)
    cost += 0.5 * float(unknowns.x @ model.layout.information @ unknowns.x)
    cost += 0.5 * float(np.sum((unknowns.tilts / known.attitude_sigma_rad) ** 2))
    cost += 0.5 * float(np.sum(prior.information[:, None] * (unknowns.points - prior.points) ** 2))
    return Linearisation(unknowns, flown, sightings, passes, lengths, cost)


def gauss_newton_step(
    model: MeasurementModel, prior: LandmarkPrior, here: Linearisation, robust: HuberLoss, damping: float
) -> GaussNewtonStep:
    """Solve the normal equations with the diagonal multiplied by ``1 + damping`` (Levenberg and Marquardt).

    The landmarks are eliminated first, block by block (Schur complement). In the Cholesky factorisation of the rest
    the pan and tilt of the images come first, so that the last rows of the factor are the square-root information of
    the shared unknowns alone.
    """
    measured, known = model.measured, model.layout.knowledge
    unknowns, n = here.unknowns, model.layout.size
    images = len(measured.times_s)
    weights = np.where(here.sightings.in_front, robust.weights(here.lengths), 0.0)
    # Whitened rows, so that products of them are normal equations without further weights.
    scale = (np.sqrt(weights) / measured.sigma_px)[:, None]
    residuals = here.sightings.residuals * scale
    by_image, by_point = here.sightings.by_image * scale[..., None], here.sightings.by_point * scale[..., None]

    # Landmarks hardly known by their rays are damped more than by their own diagonal, which is then near 0.
    held = prior.information + _POINT_DAMPING * (1.0 + damping * 1e4)
    factors, pulls, links = whiten_landmarks(measured.begin, by_point, by_image, residuals, held)
    if np.any(prior.information):
        toward = (prior.information[:, None] * (prior.points - unknowns.points))[..., None]
        pulls = pulls + np.linalg.solve(factors, toward)[..., 0]

    # The chain rule: derivatives by the camera (7) times derivatives of the camera by the shared unknowns.
    shared = model.shared(unknowns, here.flown)
    common = shared_links(measured.begin, measured.image, links, shared)
    normal = np.zeros((images, 7, 7))
    # Normal matrices by the seven parameters of each camera; the shared unknowns follow by the chain rule.
    np.add.at(normal, measured.image, np.swapaxes(by_image, 1, 2) @ by_image)
    pull = np.zeros((images, 7))
    np.add.at(pull, measured.image, np.einsum("krc,kr->kc", by_image, residuals))

    size = 2 * images + n
    matrix = np.zeros((size, size))
    # Blocks of the matrix: pan and tilt are components 3 and 4 of the camera, independent between images.
    carried = normal @ shared
    rows = np.arange(images)
    for r in range(2):
        for s in range(2):
            matrix[2 * rows + r, 2 * rows + s] = normal[:, 3 + r, 3 + s]
    diagonal = np.arange(2 * images)
    # Prior of pan and tilt: the attitude error of each image.
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
    # Reduced normal matrix: N - H' C^-1 H, which is H' L^-T times its transpose for each landmark.
    subtract_landmarks(matrix, measured.begin, measured.image, links, common)

    # Right-hand side b - H' C^-1 c after the elimination; priors pull back to their means, which are 0 for x and tilts.
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
    # Marquardt's scaling by the diagonal of the reduced matrix: pan and tilt and shared unknowns differ in their
    # sigmas.
    matrix[every, every] *= 1.0 + damping
    # The transpose has the column-major order of LAPACK, so that nothing is copied.
    factor, _ = cho_factor(matrix.T, lower=False, overwrite_a=True, check_finite=False)
    moved = cho_solve((factor, False), right, check_finite=False)
    x, tilts = moved[2 * images :], moved[: 2 * images].reshape(-1, 2)

    # Back substitution of the landmarks: L^T dp = L^-1 b - (L^-1 H') dx.
    by_common = np.einsum("ldp,p->ld", common, x)
    np.add.at(by_common, measured.point, np.einsum("krd,kr->kd", links[:, 3:5], tilts[measured.image]))
    whitened_points = pulls - by_common
    points = np.linalg.solve(np.swapaxes(factors, 1, 2), whitened_points[..., None])[..., 0]
    # Half of b^T N^-1 b: the decrease of the quadratic model, from the reduced system and from the eliminated
    # landmarks.
    promised = 0.5 * float(right @ moved + np.sum(pulls**2))
    return GaussNewtonStep(x, tilts, points, promised, factor)


def adjust(
    model: MeasurementModel, prior: LandmarkPrior, start: Unknowns, robust: HuberLoss, limits: StoppingCriteria
) -> GaussNewtonResult:
    """Take Gauss-Newton steps, damped where the cost rises, until the stopping criteria are met.

    Raise OrbitLostError if the orbit of the starting values hits the body.
    """
    here, damping = linearise(model, prior, start, robust), 0.0
    step = gauss_newton_step(model, prior, here, robust, damping)
    for count in range(1, limits.steps + 1):
        little = step.promised < limits.tolerance + limits.share * here.cost
        moved = Unknowns(start.x + step.x, start.tilts + step.tilts, start.points + step.points)
        try:
            there: Linearisation | None = linearise(model, prior, moved, robust)
        except OrbitLostError:
            there = None
        # The tolerance lets rounding of a large cost pass.
        if there is None or there.cost > here.cost * (1.0 + 1e-9):
            if little:
                return GaussNewtonResult(here, step, True, count)
            damping = max(_DAMPING_FIRST, 10.0 * damping)
            if damping > _MAX_DAMPING:
                return GaussNewtonResult(here, step, False, count)
        else:
            # A small decrease predicted with strong damping is no convergence: the damping made it small.
            done = little and damping <= _DAMPING_FIRST
            start, here = moved, there
            # Back to plain Gauss-Newton as soon as possible, which converges quadratically near the solution.
            damping = 0.0 if damping <= _DAMPING_FIRST else 0.1 * damping
            if done:
                return GaussNewtonResult(here, step, True, count)
        step = gauss_newton_step(model, prior, here, robust, damping)
    return GaussNewtonResult(here, step, False, limits.steps)

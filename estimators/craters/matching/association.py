"""Which detections are which expected craters, where one unknown error moves all of them together.

The error e of what is known before (poses, of one image or of two) is Gaussian. Crater i is expected at p_i and seen at

    q = p_i + H_i e + noise,  noise ~ N(0, R_i),

so that the offsets of all craters are one Gaussian field. Each compatible couple of an expected crater and a detection
votes for the offset that it stands for: the field given that couple. The field with the most likely set of couples is
refined by all of them, and a couple is kept when the others, without it, foretell it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.optimize import linear_sum_assignment

from scenarios.geometry import Ellipses
from scenarios.spec.base import SpecModel

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

_REFITS = 10
_HUBER_PASSES = 10
_VOTES_AT_ONCE = 64
_MAX_WORK = 2_000_000
_SHAPE_SPREAD = 0.3
_IMPOSSIBLE = -60.0

# A Gaussian pair of offsets exceeds it in 14 % of cases.
_LIMIT_SIGMA = 2.0


def huber_weights(sigmas: FloatArray) -> FloatArray:
    """Weights of Huber's loss for offsets in units of their standard deviation, any shape.

    Huber (1964, Ann. Math. Stat. 35, 73): 1 up to a limit, beyond it the limit over the offset.
    """
    return np.asarray(_LIMIT_SIGMA / np.maximum(sigmas, _LIMIT_SIGMA), dtype=np.float64)


class CraterAssociationOptions(SpecModel):
    """How far a detection may be from what is expected of it, and how sure a couple must be."""

    centre_sigma_px: float = Field(0.7, gt=0.0, description="Of the centre of a rim, both detections together")
    centre_sigma_radii: float = Field(0.06, ge=0.0, description="The same, in radii: rims are not ellipses")
    size_sigma: float = Field(0.10, gt=0.0, description="Of the logarithm of the ratio of radii")
    axes_sigma: float = Field(0.15, gt=0.0, description="Of the logarithm of the ratio of the ratios of axes")
    redetected: float = Field(0.5, gt=0.0, lt=1.0, description="Probability that an expected crater is detected")
    probability: float = Field(0.95, gt=0.5, lt=1.0, description="Of a couple against all others, at the least")
    gate_sigma: float = Field(4.5, gt=0.0, description="Of an offset by what is known before, at the most")


@dataclass(frozen=True, slots=True, eq=False)
class ExpectedCraters:
    """What should be seen.

    Parameters
    ----------
    ellipses
        n rims as they are expected.
    by_error
        (n, 2, s) px by the common error.
    covariance
        (s, s) of the common error.
    noise_px2
        (n, 2, 2) covariance of what each place is off by itself.
    mean
        (s,) of the common error: zero but where the rims were predicted with a better guess of it.
    """

    ellipses: Ellipses
    by_error: FloatArray
    covariance: FloatArray
    noise_px2: FloatArray
    mean: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Association:
    """Couples that were found.

    Parameters
    ----------
    pairs
        (k, 2) expected crater and detection; none twice.
    probability
        (k,) of each couple.
    error, covariance
        (s,) and (s, s): the common error given all couples.
    reason
        Why there are none; empty where there are.
    """

    pairs: IndexArray
    probability: FloatArray
    error: FloatArray
    covariance: FloatArray
    reason: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class _Likelihoods:
    """Shapes of all couples, as log-likelihood ratios against clutter, and the density of clutter in the image."""

    shape: FloatArray  # (n, m)
    density_px2: float


def centre_noise(ellipses: Ellipses, options: CraterAssociationOptions) -> FloatArray:
    """(n, 2, 2) covariance of the places of rims, by the detector alone."""
    sigma = np.hypot(options.centre_sigma_px, options.centre_sigma_radii * ellipses.radius_px)
    return np.asarray(sigma[:, None, None] ** 2 * np.eye(2), dtype=np.float64)


def associate(
    expected: ExpectedCraters, seen: Ellipses, area_px2: float, options: CraterAssociationOptions
) -> Association:
    """Find the couples of expected craters and detections in an image of ``area_px2``."""
    size = len(expected.covariance)
    none = Association(np.zeros((0, 2), dtype=np.int64), np.zeros(0), np.zeros(size), expected.covariance)
    if len(expected.ellipses) == 0 or len(seen) == 0:
        what = "no crater is expected in the image" if len(expected.ellipses) == 0 else "the image has no crater"
        return _no_association(none, what)
    likelihoods = _Likelihoods(_shape_ratios(expected.ellipses, seen, options), len(seen) / area_px2)
    foretold = expected.ellipses.centre_px + expected.by_error @ expected.mean
    offsets = seen.centre_px[None] - foretold[:, None]
    elected = _best_supported_pair(expected, offsets, likelihoods, options)
    if len(elected) == 0:
        return _no_association(none, "no detection fits an expected crater in place, size and shape")
    return _refine(expected, offsets, elected, likelihoods, options)


def _no_association(none: Association, reason: str) -> Association:
    return Association(none.pairs, none.probability, none.error, none.covariance, reason)


def _shape_ratios(expected: Ellipses, seen: Ellipses, options: CraterAssociationOptions) -> FloatArray:
    """(n, m) log-likelihood ratios of size and ratio of axes: of the couple against the other shapes of the image."""
    sigma = np.array([options.size_sigma, options.axes_sigma])
    here, there = _log_shape(expected), _log_shape(seen)
    own = _log_normal((here[:, None] - there[None]) / sigma) - np.log(sigma).sum()
    spread = np.full(2, _SHAPE_SPREAD)
    others = _log_normal((there[:, None] - there[None]) / spread) - np.log(spread).sum()
    clutter = np.log(np.exp(others).mean(axis=1))
    return np.asarray(own - clutter[None], dtype=np.float64)


def _log_shape(ellipses: Ellipses) -> FloatArray:
    """(n, 2) logarithms of the radius and of the ratio of axes."""
    a, b = np.log(ellipses.semi_axes_px).T
    return np.column_stack([0.5 * (a + b), b - a])


def _log_normal(standard: FloatArray) -> FloatArray:
    """Sum the log-densities of standard normal numbers over the last axis."""
    return np.asarray(-0.5 * (standard**2).sum(axis=-1) - 0.5 * standard.shape[-1] * np.log(2.0 * np.pi))


def _log_ratios(
    residuals: FloatArray, spread: FloatArray, likelihoods: _Likelihoods, options: CraterAssociationOptions
) -> FloatArray:
    """(..., n, m) log-odds of each couple against its detection being clutter.

    Parameters
    ----------
    residuals
        (..., n, m, 2) px.
    spread
        (..., n, 2, 2) their covariances.
    """
    a, b, c = spread[..., 0, 0, None], spread[..., 0, 1, None], spread[..., 1, 1, None]
    det = a * c - b * b
    u, v = residuals[..., 0], residuals[..., 1]
    square = (c * u * u - 2.0 * b * u * v + a * v * v) / det
    place = -0.5 * square - 0.5 * np.log(det) - np.log(2.0 * np.pi * likelihoods.density_px2)
    odds = np.log(options.redetected / (1.0 - options.redetected))
    return np.asarray(np.maximum(place + likelihoods.shape + odds, _IMPOSSIBLE), dtype=np.float64)


def _best_supported_pair(
    expected: ExpectedCraters, offsets: FloatArray, likelihoods: _Likelihoods, options: CraterAssociationOptions
) -> IndexArray:
    """Return the couple, (1, 2), whose offset has most support; (0, 2) where no couple is possible.

    Where there are very many couples only the most likely of them vote; all of them are counted.
    """
    H, P, R = expected.by_error, expected.covariance, expected.noise_px2
    prior = H @ P @ np.swapaxes(H, 1, 2) + R
    far = np.einsum("nmi,nij,nmj->nm", offsets, np.linalg.inv(prior), offsets)
    couples = np.argwhere((far < options.gate_sigma**2) & (likelihoods.shape > -0.5 * options.gate_sigma**2))
    voters = max(1, _MAX_WORK // offsets[..., 0].size)
    if len(couples) > voters:
        odds = _log_ratios(offsets, prior, likelihoods, options)[couples[:, 0], couples[:, 1]]
        couples = couples[np.sort(np.argsort(-odds, kind="stable")[:voters])]
    if len(couples) == 0:
        return couples
    scores = [
        _support(expected, offsets, couples[start : start + _VOTES_AT_ONCE], prior, likelihoods, options)
        for start in range(0, len(couples), _VOTES_AT_ONCE)
    ]
    return couples[[int(np.argmax(np.concatenate(scores)))]]


def _support(
    expected: ExpectedCraters,
    offsets: FloatArray,
    couples: IndexArray,
    prior: FloatArray,
    likelihoods: _Likelihoods,
    options: CraterAssociationOptions,
) -> FloatArray:
    """(v,) log-likelihood ratio of all couples, each detection once, when the field is that of one couple."""
    H, P, R = expected.by_error, expected.covariance, expected.noise_px2
    i = couples[:, 0]
    offset = offsets[i, couples[:, 1]]
    gain = P @ np.swapaxes(H[i], 1, 2) @ np.linalg.inv(prior[i])
    error = np.einsum("vsi,vi->vs", gain, offset)
    left = P - gain @ H[i] @ P
    spread = np.einsum("nis,vst,njt->vnij", H, left, H, optimize=True) + R
    residuals = offsets[None] - np.einsum("nis,vs->vni", H, error)[:, :, None]
    ratios = np.maximum(_log_ratios(residuals, spread, likelihoods, options), 0.0)
    once = np.minimum(ratios.max(axis=2).sum(axis=1), ratios.max(axis=1).sum(axis=1))
    far = np.einsum("vi,vij,vj->v", offset, np.linalg.inv(prior[i]), offset)
    return np.asarray(once - 0.5 * far)


def _refine(
    expected: ExpectedCraters,
    offsets: FloatArray,
    pairs: IndexArray,
    likelihoods: _Likelihoods,
    options: CraterAssociationOptions,
) -> Association:
    """Start from the couple with most support, and go on with all couples of the field until they stay the same."""
    for _ in range(_REFITS):
        error, covariance = condition_on_pairs(expected, offsets, pairs)
        H = expected.by_error
        spread = H @ covariance @ np.swapaxes(H, 1, 2) + expected.noise_px2
        ratios = _log_ratios(offsets - (H @ error)[:, None], spread, likelihoods, options)
        found = _one_to_one(ratios)
        if np.array_equal(found, pairs) or len(found) == 0:
            break
        pairs = found
    probability = _leave_one_out_probability(expected, offsets, pairs, likelihoods, options)
    sure = probability >= options.probability
    error, covariance = condition_on_pairs(expected, offsets, pairs[sure])
    reason = "" if sure.any() else f"of {len(pairs)} possible matches none is sure"
    return Association(pairs[sure], probability[sure], expected.mean + error, covariance, reason)


def _one_to_one(ratios: FloatArray) -> IndexArray:
    """Return the couples (k, 2) with positive log-odds of the best one-to-one assignment."""
    rows, columns = linear_sum_assignment(-np.maximum(ratios, 0.0))
    taken = ratios[rows, columns] > 0.0
    return np.column_stack([rows[taken], columns[taken]]).astype(np.int64)


def _joint(expected: ExpectedCraters, pairs: IndexArray) -> tuple[FloatArray, FloatArray]:
    """Stack the derivatives (2k, s) of couples, and the covariance (2k, 2k) of their offsets."""
    H = expected.by_error[pairs[:, 0]].reshape(-1, len(expected.covariance))
    joint = H @ expected.covariance @ H.T
    for row, i in enumerate(pairs[:, 0]):
        joint[2 * row : 2 * row + 2, 2 * row : 2 * row + 2] += expected.noise_px2[i]
    return H, joint


def condition_on_pairs(
    expected: ExpectedCraters, offsets: FloatArray, pairs: IndexArray
) -> tuple[FloatArray, FloatArray]:
    """Return the common error less its mean, (s,) and (s, s), given couples (k, 2) and all offsets (n, m, 2)."""
    P = expected.covariance
    H, joint = _joint(expected, pairs)
    gain = np.linalg.solve(joint, H @ P).T
    covariance = P - gain @ H @ P
    error = gain @ offsets[pairs[:, 0], pairs[:, 1]].ravel()
    return np.asarray(error, dtype=np.float64), 0.5 * (covariance + covariance.T)


def _leave_one_out_probability(
    expected: ExpectedCraters,
    offsets: FloatArray,
    pairs: IndexArray,
    likelihoods: _Likelihoods,
    options: CraterAssociationOptions,
) -> FloatArray:
    """(k,) probability of each couple by what all the others foretell, against other couples of both and clutter.

    Leaving couple i out of a Gaussian field with covariance S leaves the residual (W_ii)^-1 (W y)_i with covariance
    (W_ii)^-1, W = S^-1.
    """
    _, joint = _joint(expected, pairs)
    weights = np.linalg.inv(joint)
    weighted = (weights @ offsets[pairs[:, 0], pairs[:, 1]].ravel()).reshape(-1, 2)
    probability = np.empty(len(pairs))
    for row, (i, k) in enumerate(pairs):
        block = slice(2 * row, 2 * row + 2)
        spread = np.linalg.inv(weights[block, block])
        place = offsets[i, k] - spread @ weighted[row]
        own = _log_ratios((offsets[i] - place)[None], spread[None], _row_of(likelihoods, i), options)[0]
        probability[row] = np.exp(own[k]) / (1.0 + np.exp(own).sum())
    rivals = _rival_probability(expected, offsets, pairs, likelihoods, options)
    return np.minimum(probability, rivals)


def _row_of(likelihoods: _Likelihoods, row: int) -> _Likelihoods:
    return _Likelihoods(likelihoods.shape[row : row + 1], likelihoods.density_px2)


def _rival_probability(
    expected: ExpectedCraters,
    offsets: FloatArray,
    pairs: IndexArray,
    likelihoods: _Likelihoods,
    options: CraterAssociationOptions,
) -> FloatArray:
    """(k,) probability of each couple against the other expected craters of its detection."""
    error, covariance = condition_on_pairs(expected, offsets, pairs)
    H = expected.by_error
    spread = H @ covariance @ np.swapaxes(H, 1, 2) + expected.noise_px2
    ratios = np.exp(_log_ratios(offsets - (H @ error)[:, None], spread, likelihoods, options))
    return np.asarray(ratios[pairs[:, 0], pairs[:, 1]] / (1.0 + ratios[:, pairs[:, 1]].sum(axis=0)))


def adjust_robustly(expected: ExpectedCraters, seen: Ellipses, found: Association) -> Association:
    """Adjust the common error anew by Huber's loss: centres of rims have heavier tails than a Gaussian.

    The noise of each couple is divided by its weight until the weights stand still; the prior keeps its weight.
    """
    foretold = expected.ellipses.centre_px + expected.by_error @ expected.mean
    offsets = seen.centre_px[None] - foretold[:, None]
    i, k = found.pairs.T
    error, noise = found.error - expected.mean, expected.noise_px2[i]
    for _ in range(_HUBER_PASSES):
        left = offsets[i, k] - expected.by_error[i] @ error
        sigmas = np.sqrt(np.einsum("ni,nij,nj->n", left, np.linalg.inv(noise), left))
        weighed = expected.noise_px2.copy()
        weighed[i] = noise / huber_weights(sigmas)[:, None, None]
        error, covariance = condition_on_pairs(replace(expected, noise_px2=weighed), offsets, found.pairs)
    return replace(found, error=expected.mean + error, covariance=covariance)

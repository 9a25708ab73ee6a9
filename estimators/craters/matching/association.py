"""Association of detections with expected craters whose offsets share one unknown error.

The error e of the prior (of the poses of one or two images) is Gaussian. Crater i is expected at p_i and seen at

    q = p_i + H_i e + noise,  noise ~ N(0, R_i),

so that the offsets of all craters are one Gaussian field. Each compatible pair of an expected crater and a detection
is a hypothesis on the offsets: the field conditioned on that pair. The hypothesis with the most likely set of pairs is
refined with all of them, and a pair is kept if it is probable given the others without it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field
from scipy.optimize import linear_sum_assignment

from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.geometry import Ellipses
from boresight.scenarios.spec.base import SpecModel

_REFITS = 10
_HUBER_PASSES = 10
_VOTES_AT_ONCE = 64  # hypotheses evaluated in one array operation, to bound the memory
_MAX_WORK = 2_000_000  # hypotheses times pairs
_SHAPE_SPREAD = 0.3  # of the logarithms of size and axes ratio of clutter
_IMPOSSIBLE = -60.0  # log-odds are held above it, so that exponentials stay finite

# The length of two standard normal offsets exceeds it in exp(-2) = 14 % of cases.
_LIMIT_SIGMA = 2.0


def huber_weights(sigmas: FloatArray) -> FloatArray:
    """Return the weights of Huber's loss for offsets in units of their standard deviation, any shape.

    Huber (1964, Ann. Math. Stat. 35, 73): 1 up to a limit, beyond it the limit over the offset. Detections have heavier
    tails than a Gaussian.
    """
    return np.asarray(_LIMIT_SIGMA / np.maximum(sigmas, _LIMIT_SIGMA), dtype=np.float64)


class CraterAssociationOptions(SpecModel):
    """The uncertainty of detections, and the required probability of a pair."""

    centre_sigma_px: float = Field(
        0.7, gt=0.0, description="Standard deviation of a rim's centre, both detections together"
    )
    centre_sigma_radii: float = Field(
        0.06, ge=0.0, description="Part of that error that grows with the radius, in radii, as rims are not ellipses"
    )
    size_sigma: float = Field(0.10, gt=0.0, description="Standard deviation of the log ratio of radii")
    axes_sigma: float = Field(0.15, gt=0.0, description="Standard deviation of the log ratio of axes ratios")
    redetected: float = Field(0.5, gt=0.0, lt=1.0, description="Probability that an expected crater is detected")
    probability: float = Field(0.95, gt=0.5, lt=1.0, description="Least probability of a pair against all others")
    gate_sigma: float = Field(4.5, gt=0.0, description="Largest offset, in a priori standard deviations")


@dataclass(frozen=True, slots=True, eq=False)
class ExpectedCraters:
    """n predicted rims with their errors.

    ``by_error`` (n, 2, s) is H, the derivatives of the centres, px, by the common error; ``covariance`` (s, s) is P,
    that of the common error, in the units of its components; ``noise_px2`` (n, 2, 2) is R, the covariance of the
    independent error of each centre. ``mean`` (s,) of the common error is zero unless the rims were predicted with a
    better estimate of it.
    """

    ellipses: Ellipses
    by_error: FloatArray
    covariance: FloatArray
    noise_px2: FloatArray
    mean: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Association:
    """Pairs (k, 2) of expected crater and detection, none twice, and the probability (k,) of each.

    ``error`` (s,) and ``covariance`` (s, s) are those of the common error given all pairs. ``reason`` is why there are
    none; empty if there are.
    """

    pairs: IndexArray
    probability: FloatArray
    error: FloatArray
    covariance: FloatArray
    reason: str = ""


@dataclass(frozen=True, slots=True)
class CentreErrors:
    """Variance and correlation of the errors of centres in one image, in units of their stated standard deviations.

    The same light and slopes displace neighbouring rims alike: two craters at a distance d correlate by
    ``correlation / (1 + d / length_m)``. ``variance`` is that of an average image. The variances of images are
    scaled inverse chi-squares of ``freedom`` degrees of freedom, above 2, with that mean; if infinite, all images have
    it.
    """

    variance: float = 1.0
    correlation: float = 0.0
    length_m: float = 1.0
    freedom: float = np.inf

    def correlations(self, points_m: FloatArray) -> FloatArray:
        """Return the (n, n) correlations of the errors of craters at (n, 3), m."""
        apart = np.linalg.norm(points_m[:, None] - points_m, axis=2)
        found = self.correlation / (1.0 + apart / self.length_m)
        np.fill_diagonal(found, 1.0)
        return np.asarray(found, dtype=np.float64)

    def image_variance(self, square: float, freedom: float) -> float:
        """Return the expected variance of an image whose errors have the chi-square ``square`` of so much freedom.

        The mean of the posterior, a scaled inverse chi-square too: the mean of such a law is v s^2 / (v - 2).
        """
        if not np.isfinite(self.freedom):
            return self.variance
        return (square + (self.freedom - 2.0) * self.variance) / (freedom + self.freedom - 2.0)


def centre_noise(ellipses: Ellipses, options: CraterAssociationOptions) -> FloatArray:
    """Return the (n, 2, 2) covariance of the centres of rims due to the detector."""
    sigma = np.hypot(options.centre_sigma_px, options.centre_sigma_radii * ellipses.radius_px)
    return np.asarray(sigma[:, None, None] ** 2 * np.eye(2), dtype=np.float64)


def associate(
    expected: ExpectedCraters, seen: Ellipses, area_px2: float, options: CraterAssociationOptions
) -> Association:
    """Find the pairs of expected craters and detections in an image of ``area_px2``, and the common error.

    Clutter is uniform in the image, with the density of the detections.
    """
    size = len(expected.covariance)
    none = Association(np.zeros((0, 2), dtype=np.int64), np.zeros(0), np.zeros(size), expected.covariance)
    if len(expected.ellipses) == 0 or len(seen) == 0:
        what = "no crater is expected in the image" if len(expected.ellipses) == 0 else "the image has no crater"
        return replace(none, reason=what)
    foretold = expected.ellipses.centre_px + expected.by_error @ expected.mean
    shape = _shape_ratios(expected.ellipses, seen, options)
    pairs = PairHypotheses(expected, seen.centre_px - foretold[:, None], shape, len(seen) / area_px2, options)
    # The prior moves all craters together by many pixels: pairs found one by one would be wrong. One pair fixes most of
    # the common error, and the others then vote within their own noise.
    elected = pairs.best_supported()
    if len(elected) == 0:
        return replace(none, reason="no detection fits an expected crater in place, size and shape")
    return pairs.refined(elected)


def _shape_ratios(expected: Ellipses, seen: Ellipses, options: CraterAssociationOptions) -> FloatArray:
    """Return (n, m) log-likelihood ratios of size and axes ratio: the pair against the other shapes in the image."""
    sigma = np.array([options.size_sigma, options.axes_sigma])
    here, there = _log_shape(expected), _log_shape(seen)
    own = _log_normal((here[:, None] - there[None]) / sigma) - np.log(sigma).sum()
    spread = np.full(2, _SHAPE_SPREAD)
    others = _log_normal((there[:, None] - there[None]) / spread) - np.log(spread).sum()
    # The density of clutter is a kernel estimate from the shapes of all detections.
    clutter = np.log(np.exp(others).mean(axis=1))
    return np.asarray(own - clutter[None], dtype=np.float64)


def _log_shape(ellipses: Ellipses) -> FloatArray:
    """Return (n, 2) logarithms of the radius and of the ratio of axes."""
    a, b = np.log(ellipses.semi_axes_px).T
    # Logarithms, so that errors of size are relative; the angle is left out, as nearly circular rims have none.
    return np.column_stack([0.5 * (a + b), b - a])


def _log_normal(standard: FloatArray) -> FloatArray:
    """Sum the log-densities of standard normal numbers over the last axis."""
    return np.asarray(-0.5 * (standard**2).sum(axis=-1) - 0.5 * standard.shape[-1] * np.log(2.0 * np.pi))


@dataclass(frozen=True, slots=True, eq=False)
class PairHypotheses:
    """All pairs of n expected craters and m detections: offsets (n, m, 2), px, from the expected places.

    ``shape`` (n, m) are log-likelihood ratios of their shapes against clutter, of which there is ``density_px2``.
    """

    expected: ExpectedCraters
    offsets: FloatArray
    shape: FloatArray
    density_px2: float
    options: CraterAssociationOptions

    def log_ratios(self, residuals: FloatArray, spread: FloatArray) -> FloatArray:
        """Return (..., n, m) log-odds of each pair against its detection being clutter.

        ``residuals`` are (..., n, m, 2) px, and ``spread`` (..., n, 2, 2) their covariances.
        """
        a, b, c = spread[..., 0, 0, None], spread[..., 0, 1, None], spread[..., 1, 1, None]
        det = a * c - b * b
        u, v = residuals[..., 0], residuals[..., 1]
        # The 2 x 2 inverse is written out: the arrays are (hypotheses, craters, detections).
        square = (c * u * u - 2.0 * b * u * v + a * v * v) / det
        # Density of the offset if it is the same crater, over that of clutter, uniform in the image.
        place = -0.5 * square - 0.5 * np.log(det) - np.log(2.0 * np.pi * self.density_px2)
        odds = np.log(self.options.redetected / (1.0 - self.options.redetected))
        return np.asarray(np.maximum(place + self.shape + odds, _IMPOSSIBLE), dtype=np.float64)

    def best_supported(self) -> IndexArray:
        """Return the pair, (1, 2), whose offset has the most support; (0, 2) if no pair is possible.

        If there are very many pairs, only the most likely of them are hypotheses; all of them count as support.
        """
        H, P, R = self.expected.by_error, self.expected.covariance, self.expected.noise_px2
        # S_i = H_i P H_i^T + R_i, the covariance of an offset before any pair is known.
        prior = H @ P @ np.swapaxes(H, 1, 2) + R
        far = np.einsum("nmi,nij,nmj->nm", self.offsets, np.linalg.inv(prior), self.offsets)
        couples = np.argwhere((far < self.options.gate_sigma**2) & (self.shape > -0.5 * self.options.gate_sigma**2))
        voters = max(1, _MAX_WORK // self.offsets[..., 0].size)
        if len(couples) > voters:
            # Sorted back into the order of rows, so that among equally supported pairs the first wins as without the
            # limit.
            odds = self.log_ratios(self.offsets, prior)[couples[:, 0], couples[:, 1]]
            couples = couples[np.sort(np.argsort(-odds, kind="stable")[:voters])]
        if len(couples) == 0:
            return couples
        scores = [
            self._support(couples[start : start + _VOTES_AT_ONCE], prior)
            for start in range(0, len(couples), _VOTES_AT_ONCE)
        ]
        return couples[[int(np.argmax(np.concatenate(scores)))]]

    def _support(self, couples: IndexArray, prior: FloatArray) -> FloatArray:
        """Return (v,) the support of each of v hypotheses, the pairs (v, 2) of ``couples``.

        It is the sum of the log-odds of all pairs, each crater and each detection once, given the field conditioned on
        the hypothesis, minus half of the squared distance of its offset in standard deviations of the prior.
        """
        H, P, R = self.expected.by_error, self.expected.covariance, self.expected.noise_px2
        i = couples[:, 0]
        offset = self.offsets[i, couples[:, 1]]
        # Kalman update of the common error by the offset of one pair.
        gain = P @ np.swapaxes(H[i], 1, 2) @ np.linalg.inv(prior[i])
        error = np.einsum("vsi,vi->vs", gain, offset)
        left = P - gain @ H[i] @ P
        spread = np.einsum("nis,vst,njt->vnij", H, left, H, optimize=True) + R
        residuals = self.offsets[None] - np.einsum("nis,vs->vni", H, error)[:, :, None]
        # A pair less likely than clutter is no evidence: it is left out instead of counting against the hypothesis.
        ratios = np.maximum(self.log_ratios(residuals, spread), 0.0)
        # Each detection and each crater counts once; the smaller sum bounds the one-to-one assignment.
        once = np.minimum(ratios.max(axis=2).sum(axis=1), ratios.max(axis=1).sum(axis=1))
        # The hypothesis itself costs what its offset is improbable under the prior.
        far = np.einsum("vi,vij,vj->v", offset, np.linalg.inv(prior[i]), offset)
        return np.asarray(once - 0.5 * far)

    def refined(self, pairs: IndexArray) -> Association:
        """Start from the best supported pair, and condition the field on all its pairs until they no longer change."""
        for _ in range(_REFITS):
            ratios = self._given(pairs)
            # Odds below 0 cost the same as no pair, so that no crater is forced into a bad one.
            rows, columns = linear_sum_assignment(-np.maximum(ratios, 0.0))
            taken = ratios[rows, columns] > 0.0
            found = np.column_stack([rows[taken], columns[taken]]).astype(np.int64)
            if np.array_equal(found, pairs) or len(found) == 0:
                break
            pairs = found
        probability = self._probability(pairs)
        sure = probability >= self.options.probability
        error, covariance = condition_on_pairs(self.expected, self.offsets, pairs[sure])
        reason = "" if sure.any() else f"of {len(pairs)} possible matches none is sure"
        return Association(pairs[sure], probability[sure], self.expected.mean + error, covariance, reason)

    def _probability(self, pairs: IndexArray) -> FloatArray:
        """Return (k,) the probability of each pair, against other pairs of its crater, of its detection, and clutter.

        Against other pairs of the crater it is that given all other pairs: leaving pair i out of a Gaussian field with
        covariance S gives the residual (W_ii)^-1 (W y)_i with covariance (W_ii)^-1, W = S^-1.
        """
        _, joint = _joint(self.expected, pairs)
        weights = np.linalg.inv(joint)
        weighted = (weights @ self.offsets[pairs[:, 0], pairs[:, 1]].ravel()).reshape(-1, 2)
        probability = np.empty(len(pairs))
        for row, (i, k) in enumerate(pairs):
            block = slice(2 * row, 2 * row + 2)
            # Without its own pair: an offset that has helped to fit the common error would agree with it too well.
            spread = np.linalg.inv(weights[block, block])
            place = self.offsets[i, k] - spread @ weighted[row]
            alone = replace(self, shape=self.shape[i : i + 1])
            own = alone.log_ratios((self.offsets[i] - place)[None], spread[None])[0]
            # The 1 is the event that none of the detections is this crater.
            probability[row] = np.exp(own[k]) / (1.0 + np.exp(own).sum())
        # Against the other expected craters of its detection, given all pairs.
        ratios = np.exp(self._given(pairs))
        rivals = ratios[pairs[:, 0], pairs[:, 1]] / (1.0 + ratios[:, pairs[:, 1]].sum(axis=0))
        return np.asarray(np.minimum(probability, rivals), dtype=np.float64)

    def _given(self, pairs: IndexArray) -> FloatArray:
        """Return (n, m) log-odds of all pairs, given the field conditioned on ``pairs``."""
        error, covariance = condition_on_pairs(self.expected, self.offsets, pairs)
        H = self.expected.by_error
        spread = H @ covariance @ np.swapaxes(H, 1, 2) + self.expected.noise_px2
        return self.log_ratios(self.offsets - (H @ error)[:, None], spread)


def _joint(
    expected: ExpectedCraters, pairs: IndexArray, correlations: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Stack the derivatives (2k, s) of pairs, and the covariance (2k, 2k) of their offsets.

    ``correlations`` (k, k) are those of the noise of the pairs; independent if None.
    """
    H = expected.by_error[pairs[:, 0]].reshape(-1, len(expected.covariance))
    joint = H @ expected.covariance @ H.T
    if correlations is not None:
        roots = np.linalg.cholesky(expected.noise_px2[pairs[:, 0]])
        shared = np.einsum("ab,aij,bkj->aibk", correlations, roots, roots)
        return H, joint + shared.reshape(joint.shape)
    for row, i in enumerate(pairs[:, 0]):
        # The errors of the poses correlate all offsets; the noise of the detector only the two components of one.
        joint[2 * row : 2 * row + 2, 2 * row : 2 * row + 2] += expected.noise_px2[i]
    return H, joint


def condition_on_pairs(
    expected: ExpectedCraters, offsets: FloatArray, pairs: IndexArray, correlations: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return the common error minus its mean, (s,) and (s, s), given pairs (k, 2) and all offsets (n, m, 2).

    ``correlations`` (k, k) are those of the noise of the pairs; independent if None.
    """
    P = expected.covariance
    H, joint = _joint(expected, pairs, correlations)
    # e | y ~ N(K y, P - K H P) with K = P H^T S^-1 and S = H P H^T + R.
    gain = np.linalg.solve(joint, H @ P).T
    covariance = P - gain @ H @ P
    error = gain @ offsets[pairs[:, 0], pairs[:, 1]].ravel()
    # Symmetric within rounding: made so exactly.
    return np.asarray(error, dtype=np.float64), 0.5 * (covariance + covariance.T)


def adjust_robustly(
    expected: ExpectedCraters,
    seen: Ellipses,
    found: Association,
    points_m: FloatArray | None = None,
    errors: CentreErrors = CentreErrors(),
) -> Association:
    """Estimate the common error again with Huber's loss: centres of rims have heavier tails than a Gaussian.

    The noise of each pair is divided by its weight, iteratively; the prior keeps its weight. ``points_m`` (n, 3) are
    the places of the expected craters, between which errors correlate; independent if None. The variance of the image
    is estimated with its ``errors``, by the chi-square of its residuals.
    """
    foretold = expected.ellipses.centre_px + expected.by_error @ expected.mean
    offsets = seen.centre_px[None] - foretold[:, None]
    i, k = found.pairs.T
    error, noise = found.error - expected.mean, expected.noise_px2[i]
    correlations = np.eye(len(i)) if points_m is None else errors.correlations(points_m[i])
    for _ in range(_HUBER_PASSES):
        left = offsets[i, k] - expected.by_error[i] @ error
        standard = np.linalg.solve(np.linalg.cholesky(noise), left[..., None])[..., 0]
        square = float(np.sum(standard * np.linalg.solve(correlations, standard)))
        H, joint = _joint(expected, found.pairs, correlations)
        # The residuals lack the degrees of freedom that the common error has taken from them.
        taken = float(np.trace(np.linalg.solve(joint, H @ expected.covariance @ H.T)))
        variance = errors.image_variance(square, 2.0 * len(i) - taken)
        # Dividing the noise of the detector by the weight gives the weighted normal equations.
        weighed = expected.noise_px2.copy()
        weighed[i] = (
            variance * noise / huber_weights(np.linalg.norm(standard, axis=1) / np.sqrt(variance))[:, None, None]
        )
        error, covariance = condition_on_pairs(replace(expected, noise_px2=weighed), offsets, found.pairs, correlations)
    return replace(found, error=expected.mean + error, covariance=covariance)

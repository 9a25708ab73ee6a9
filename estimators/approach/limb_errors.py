"""Errors of the points on a limb: their correlation, their bias, and the closed form for a sphere."""

from __future__ import annotations

from typing import Final

import numpy as np

from boresight.estimators.approach.fusion import grouped_covariance
from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.errors import BoresightError

_GROUPS: Final = 32  # of neighbouring points, about, whose means tell how errors are correlated along the limb
_LENGTHS: Final = np.deg2rad([3.0, 6.0, 12.0, 25.0, 50.0, 100.0])
_SHARES: Final = np.array([0.0, 0.25, 0.5, 0.75, 0.9, 0.97])
_LEAST_PX: Final = 1e-3  # RMS of the residuals, at least, so that a perfect fit has a covariance


def bias_covariance(bias_px: float, scores: FloatArray, arc: IndexArray) -> tuple[FloatArray, FloatArray]:
    """Return the covariance (3, 3) of the sum of scores (n, 3) by a bias, half of it by arcs, and what is common (3,).

    What is common to all images is one standard deviation of the other half.
    """
    common = grouped_covariance(scores, np.zeros_like(arc), 0)
    by_bias = 0.5 * bias_px**2 * (common + grouped_covariance(scores, arc, 0))
    return by_bias, np.sqrt(0.5) * bias_px * scores.sum(axis=0)


def scatter_covariance(
    residual_px: FloatArray, by_position: FloatArray, directions: FloatArray, ray: IndexArray, weight: FloatArray
) -> tuple[FloatArray, float]:
    """Return the covariance (3, 3) of the sum of weight times derivative times error over points, and the RMS error.

    The errors are known by the residuals (n,) of a fit with the weights (n,). ``by_position`` (n, 3) are the
    derivatives of the points along their normals, ``directions`` (n, 2) unit vectors to them from the middle of the
    outline, and ``ray`` (n,) the numbers of these around it. Errors of heights are correlated along the limb, and a fit
    to a part of it absorbs most of those that reach far. The correlation is that of the means of neighbouring points,
    see `correlated_covariance`.
    """
    group = ray // -(-len(ray) // _GROUPS)
    member = np.unique(group)[:, None] == group
    relative = weight / weight.max()
    size = member @ relative
    mean = member * relative / size[:, None]
    middle = mean @ directions
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    covariance = correlated_covariance(mean @ residual_px, mean @ by_position, middle, size)
    scores = member @ (weight[:, None] * by_position)
    return np.asarray(scores.T @ covariance @ scores), float(np.sqrt(np.diagonal(covariance).mean()))


def correlated_covariance(
    residual_px: FloatArray, by_unknowns: FloatArray, directions: FloatArray, size: FloatArray
) -> FloatArray:
    """Return the covariance (n, n), px^2, of errors along an outline, by the residuals (n,) of a fit of k unknowns.

    ``by_unknowns`` (n, k) are the derivatives by what is fitted, ``directions`` (n, 2) unit vectors from the middle of
    the outline, and ``size`` (n,) the number of points that each residual is the mean of. The covariance is

        s^2 (c / (1 + (d_ij / l)^2) + (1 - c) delta_ij mean(size) / size_i),

    d the chord between directions: a share c is correlated, by a mixture of Gaussian correlations of many lengths
    (Rasmussen and Williams 2006, equation 4.19). Restricted maximum likelihood (Patterson and Thompson 1971, Biometrika
    58, 545) takes the probability of what the fit leaves, whatever the unknowns are; residuals that are small as the
    fit has absorbed the errors are so not taken for small errors. The result is the mean over a grid of c and l, with
    their probabilities, and over s^2, whose density is taken as 1 / s^2. So it holds that few residuals do not tell
    them. At least k + 3 residuals are needed.
    """
    count, unknowns = by_unknowns.shape
    chords = np.linalg.norm(directions[:, None] - directions, axis=2)
    alike = 1.0 / (1.0 + (chords / _LENGTHS[:, None, None]) ** 2)
    share = _SHARES[:, None, None, None]
    # All pairs of c and l as one stack (m, n, n), for s = 1.
    unit = (share * alike + (1.0 - share) * np.diag(size.mean() / size)).reshape(-1, count, count)
    fitted = np.column_stack([by_unknowns / np.linalg.norm(by_unknowns, axis=0), residual_px])
    root = np.linalg.cholesky(unit)
    white = np.linalg.solve(root, np.broadcast_to(fitted, (len(unit), *fitted.shape)))
    # The last element of the diagonal of R is the length of what the unknowns do not explain of the residuals.
    lengths = np.abs(np.diagonal(np.linalg.qr(white, mode="r"), axis1=1, axis2=2))
    freedom = count - unknowns
    square = np.maximum(lengths[:, -1] ** 2, freedom * _LEAST_PX**2)
    half_log = np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1) + np.log(lengths[:, :-1]).sum(axis=1)
    log_likelihood = -half_log - 0.5 * freedom * np.log(square)
    probability = np.exp(log_likelihood - log_likelihood.max())
    scale = probability / probability.sum() * square / (freedom - 2)
    return np.asarray(np.einsum("m,mij->ij", scale, unit))


def limb_covariance(
    count: int, sigma_px: float, half_angle_rad: float, radius_m: float, range_m: float, focal_px: float
) -> FloatArray:
    """Return the covariance (3, 3), m^2, of a sphere by an arc of its limb: along the arc's middle, across, in range.

    ``count`` points on an arc of the half-angle phi have the independent errors ``sigma_px`` along their normals. The
    sphere of radius R at the range z is a circle of radius f R / z, far from the camera and near the boresight. A point
    at the angle theta from the arc's middle moves along its normal by (f / z) (a cos theta + b sin theta - c R / z) if
    the sphere moves by (a, b, c). The information is n (f / z)^2 / sigma^2 times the mean of the squares over the arc,

        [[(1 + q) / 2, 0, -p R / z], [0, (1 - q) / 2, 0], [-p R / z, 0, (R / z)^2]],

    with p = sin phi / phi and q = sin 2 phi / (2 phi). So with s = sigma z / (f sqrt(n)) the variances are s^2 / D,
    2 s^2 / (1 - q) and (s z / R)^2 (1 + q) / (2 D) with D = (1 + q) / 2 - p^2: a short arc does not tell a shift along
    its middle from a change of range. Raise BoresightError if the arc has no length or is longer than a turn.
    """
    if not 0.0 < half_angle_rad <= np.pi:
        raise BoresightError(f"the half-angle of an arc is in (0, pi], not {half_angle_rad}")
    p, q = np.sin(half_angle_rad) / half_angle_rad, np.sin(2.0 * half_angle_rad) / (2.0 * half_angle_rad)
    s2, d = (sigma_px * range_m / focal_px) ** 2 / count, 0.5 * (1.0 + q) - p**2
    per_radius = range_m / radius_m
    found = np.diag([1.0 / d, 2.0 / (1.0 - q), per_radius**2 * 0.5 * (1.0 + q) / d])
    found[0, 2] = found[2, 0] = per_radius * p / d
    return s2 * found

"""Ellipse fit to pairs of arcs, equation (1) of Cheng et al. (2003), and selection by rim edges and brightness."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from boresight.estimators.craters.detection.grouping import RimArc
from boresight.estimators.craters.detection.preparation import EdgePixels, PreparedImage
from boresight.scenarios.arrays import MAD_TO_SIGMA, FloatArray, IndexArray
from boresight.scenarios.geometry import Ellipses, pixel_to_opencv
from boresight.scenarios.geometry.ellipse import fit_conics, sampson_distances

_SAMPLES = 16  # samples of an arc in the first fit
_BAND = 0.12  # of the radius: edges so near to a first fit enter the second
_MIN_PROFILE = 0.3  # correlation with a rise from the shaded to the lit side
_COUNT = 400  # pairs, the best by their first fit, that are fitted again

RIDGE = 1e-9
"""Regularisation of the fits: arcs determine the centre of an ellipse poorly."""
_CUTOFF = 2.5  # residuals of so many standard deviations have a quarter of the weight


def fit_reweighted(points: FloatArray, weights: FloatArray, rounds: int = 6) -> FloatArray:
    """Fit ellipses with iteratively renewed weights: (m, 3, 3) conics, NaN where there is none.

    A point's weight is its own over the square of the conic's gradient there, so that the algebraic distances that the
    direct fit minimises become geometric ones, times the weight of Geman and McClure, which limits outliers.
    """
    conics = fit_conics(points, weights, RIDGE)
    for _ in range(rounds):
        far = sampson_distances(points, conics)
        far = np.where(np.isfinite(far), far, 0.0)
        # The floor of 0.1 px keeps a fit through nearly perfect points from rejecting all but those exactly on it.
        spread = np.maximum(MAD_TO_SIGMA * _median(np.abs(far), weights), 0.1)
        robust = (1.0 + (far / (_CUTOFF * spread[:, None])) ** 2) ** -2.0
        homogeneous = np.concatenate([points, np.ones((*points.shape[:2], 1))], axis=2)
        # The algebraic distance is to first order the geometric one times the gradient of the conic, 2 |(C x)_1:2|:
        # divided by its square, the squares that the direct fit sums become geometric ones (Sampson 1982).
        slope = np.linalg.norm(np.einsum("mij,mkj->mki", conics[:, :2], homogeneous), axis=-1)
        mean = np.sqrt(np.sum(weights * slope**2, axis=1) / np.maximum(weights.sum(axis=1), 1e-12))
        # Relative to the mean gradient, so that the floor does not depend on the scale of the conic. Near its centre
        # the gradient vanishes: the floor limits the weight to 25.
        flat = np.maximum(slope / np.maximum(mean, 1e-30)[:, None], 0.2)
        renewed = weights * robust / flat**2
        good = np.isfinite(renewed).all(axis=1)
        conics = np.where(
            good[:, None, None], fit_conics(points, np.where(good[:, None], renewed, weights), RIDGE), np.nan
        )
    return conics


def _median(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the medians (m,) of the rows' values with a positive weight; 0 for rows without any."""
    kept = np.where(weights > 0.0, values, np.nan)
    kept[np.isnan(kept).all(axis=1)] = 0.0
    return np.asarray(np.nanmedian(kept, axis=1), dtype=np.float64)


def fit_candidates(
    pairs: IndexArray,
    shaded: list[RimArc],
    lit: list[RimArc],
    edges: EdgePixels,
    picture: PreparedImage,
    radius_px: tuple[float, float],
    axis_ratio_min: float,
) -> Ellipses:
    """Fit an ellipse to each pair of arcs, then to all edges near it; drop those that are no rim of a crater.

    ``pairs`` (k, 2) are rows of ``shaded`` and ``lit``, ``radius_px`` are the least and the largest mean radius, and
    ``axis_ratio_min`` is the least ratio of the shorter to the longer axis.
    """
    if len(pairs) == 0:
        return Ellipses.none()
    points, normals = _sample_pairs(pairs, shaded, lit)
    ellipses, good = Ellipses.among(fit_conics(points, np.ones(points.shape[:2]), RIDGE))
    # Two arcs of different craters can be fitted by an ellipse, but its normals then differ from their gradients.
    agree = normal_agreement(ellipses, points[good], normals[good])
    sane = plausible(ellipses, radius_px, axis_ratio_min, picture) & (agree > 0.85)
    # Pairs are many and mostly false: only the best by the cheap first fit are fitted again.
    order = np.argsort(-agree[sane], kind="stable")[:_COUNT]
    first = ellipses[np.flatnonzero(sane)[order]]
    if len(first) == 0:
        return Ellipses.none()
    points, weights = edges_near(first, edges, picture)
    refitted, good = Ellipses.among(fit_reweighted(points, weights))
    sane = plausible(refitted, radius_px, axis_ratio_min, picture)
    support = rim_support(refitted, points[good], weights[good])
    both = support.min(axis=1) > 0.25  # on both halves: edges on one alone are a ridge or a terminator
    rising = profile_correlation(refitted, picture) > _MIN_PROFILE
    return refitted[sane & both & rising]


def _sample_pairs(pairs: IndexArray, shaded: list[RimArc], lit: list[RimArc]) -> tuple[FloatArray, FloatArray]:
    """Return points and outward normals (k, 2 * _SAMPLES, 2) of pairs."""

    def sampled(arcs: list[RimArc]) -> tuple[FloatArray, FloatArray]:
        # As many points of each arc, so that a long arc does not outweigh a short one on the other side.
        rows = [np.linspace(0, len(arc.uv_px) - 1, _SAMPLES).round().astype(np.int64) for arc in arcs]
        points = np.stack([arc.uv_px[row] for arc, row in zip(arcs, rows, strict=True)])
        return points, np.stack([arc.outward[row] for arc, row in zip(arcs, rows, strict=True)])

    one, other = sampled(shaded), sampled(lit)
    return (
        np.concatenate([one[0][pairs[:, 0]], other[0][pairs[:, 1]]], axis=1),
        np.concatenate([one[1][pairs[:, 0]], other[1][pairs[:, 1]]], axis=1),
    )


def normal_agreement(ellipses: Ellipses, points: FloatArray, normals: FloatArray) -> FloatArray:
    """Return the mean cosine (n,) between edge and ellipse normals, minus the mean distance over the radius."""
    homogeneous = np.concatenate([points, np.ones((*points.shape[:2], 1))], axis=2)
    conics = ellipses.conics()
    slope = np.einsum("nij,nkj->nki", conics, homogeneous)[..., :2]
    slope /= np.maximum(np.linalg.norm(slope, axis=-1, keepdims=True), 1e-12)
    cosine = np.einsum("nki,nki->nk", slope, normals).mean(axis=1)
    far = np.abs(sampson_distances(points, conics)).mean(axis=1) / ellipses.radius_px
    return np.asarray(cosine - far, dtype=np.float64)


def plausible(
    ellipses: Ellipses, radius_px: tuple[float, float], axis_ratio_min: float, picture: PreparedImage
) -> NDArray[np.bool_]:
    """Return (n,) which ellipses have a crater's size and shape, and their centre on the ground."""
    height, width = picture.ground.shape
    radius = ellipses.radius_px
    ratio = ellipses.semi_axes_px[:, 1] / ellipses.semi_axes_px[:, 0]
    place = np.clip(np.floor(ellipses.centre_px), 0, [width - 1, height - 1]).astype(np.int64)
    inside = np.all((ellipses.centre_px >= 0) & (ellipses.centre_px < [width, height]), axis=1)
    on_ground = inside & picture.ground[place[:, 1], place[:, 0]]
    return np.asarray(
        (radius >= radius_px[0]) & (radius <= radius_px[1]) & (ratio >= axis_ratio_min) & on_ground, dtype=np.bool_
    )


def edges_near(ellipses: Ellipses, edges: EdgePixels, picture: PreparedImage) -> tuple[FloatArray, FloatArray]:
    """Gather the edges near each rim whose gradient agrees with their side of it.

    Return points (n, k, 2), px, and weights (n, k): 1, and 0 for the padding of rims with fewer than k edges.
    """
    tree = cKDTree(edges.uv_px)
    unit = edges.gradient / np.linalg.norm(edges.gradient, axis=1, keepdims=True)
    conics = ellipses.conics()
    chosen = []
    band = np.maximum(_BAND * ellipses.radius_px, 1.2)
    near = tree.query_ball_point(ellipses.centre_px, ellipses.semi_axes_px[:, 0] + band)
    for i, listed in enumerate(near):
        rows = np.array(listed, dtype=np.int64)
        far = sampson_distances(edges.uv_px[rows][None], conics[i : i + 1])[0]
        # The ball about the centre is a coarse preselection; the band is along the rim itself.
        rows = rows[np.abs(far) < band[i]]
        slope = np.concatenate([edges.uv_px[rows], np.ones((len(rows), 1))], axis=1) @ conics[i]
        normal = slope[:, :2] / np.maximum(np.linalg.norm(slope[:, :2], axis=1, keepdims=True), 1e-12)
        # On a rim the brightness rises towards the Sun on both sides: outwards on the near side, inwards on the far
        # one.
        signed = normal * np.sign(normal @ picture.sun_px)[:, None]
        chosen.append(np.sort(rows[np.einsum("ki,ki->k", signed, unit[rows]) > 0.8]))
    # Padded with zero weights to one array, so that all rims are fitted at once.
    width = max(6, *(len(rows) for rows in chosen))
    points, weights = np.zeros((len(chosen), width, 2)), np.zeros((len(chosen), width))
    for i, rows in enumerate(chosen):
        points[i, : len(rows)], weights[i, : len(rows)] = edges.uv_px[rows], 1.0
    return points, weights


def rim_support(ellipses: Ellipses, points: FloatArray, weights: FloatArray, sectors: int = 36) -> FloatArray:
    """Return the share (n, 2) of the sectors of each half of the rim with an edge within a tenth of the radius.

    The halves are those on either side of the longer axis, whatever the direction of the Sun: parameters t of the
    paper's equation (2) below and above pi.
    """
    # In the axes of the ellipse, divided by its semi-axes, the rim is the unit circle and t the polar angle.
    c, s = np.cos(ellipses.angle_rad), np.sin(ellipses.angle_rad)
    moved = points - ellipses.centre_px[:, None]
    x = (moved[..., 0] * c[:, None] + moved[..., 1] * s[:, None]) / ellipses.semi_axes_px[:, :1]
    y = (moved[..., 1] * c[:, None] - moved[..., 0] * s[:, None]) / ellipses.semi_axes_px[:, 1:]
    on_rim = (np.abs(np.hypot(x, y) - 1.0) < 0.1) & (weights > 0.0)
    sector = np.floor((np.arctan2(y, x) / (2 * np.pi) % 1.0) * sectors).astype(np.int64) % sectors
    hit = np.zeros((len(ellipses), sectors), dtype=bool)
    rows = np.broadcast_to(np.arange(len(ellipses))[:, None], sector.shape)
    hit[rows[on_rim], sector[on_rim]] = True
    return np.stack([hit[:, : sectors // 2].mean(axis=1), hit[:, sectors // 2 :].mean(axis=1)], axis=1)


def profile_correlation(ellipses: Ellipses, picture: PreparedImage, steps: int = 11) -> FloatArray:
    """Correlate the brightness along the Sun's direction with a rise from the shaded to the lit side: (n,)."""
    # From the shaded wall, towards the Sun, to the lit one; the rim itself is left out.
    along = np.linspace(0.8, -0.8, steps)
    aside = np.array([-0.3, 0.0, 0.3])
    sun = picture.sun_px
    inverse = np.linalg.inv(ellipses.conics()[:, :2, :2]) if len(ellipses) else np.zeros((0, 2, 2))
    # The semi-diameter whose end has its normal towards the Sun: C^-1 s / sqrt(s^T C^-1 s).
    toward = np.einsum("nij,j->ni", inverse, sun)
    toward /= np.sqrt(np.maximum(np.einsum("ni,i->n", toward, sun), 1e-12))[:, None]
    side = np.array([-sun[1], sun[0]])
    grid = ellipses.centre_px[:, None, None] + along[:, None, None] * toward[:, None, None, :]
    reach = np.sqrt(ellipses.semi_axes_px.prod(axis=1))
    grid = grid + aside[None, None, :, None] * (reach[:, None] * side)[:, None, None, :]
    place = pixel_to_opencv(grid).astype(np.float32).reshape(len(ellipses), -1, 2)
    if len(ellipses) == 0:
        return np.empty(0)
    value = cv2.remap(picture.even, place[..., 0], place[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    means = value.reshape(len(ellipses), steps, len(aside)).mean(axis=2)
    means = means - means.mean(axis=1, keepdims=True)
    # A bowl is a ramp to first order: its slope towards the Sun changes linearly across the diameter.
    ramp = -along / np.linalg.norm(along)
    return np.asarray(means @ ramp / np.maximum(np.linalg.norm(means, axis=1), 1e-12), dtype=np.float64)

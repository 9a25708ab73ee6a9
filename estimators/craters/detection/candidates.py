"""Ellipses of pairs of arcs: fitted, judged by their edges and by the profile of brightness across them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from estimators.craters.detection.edges import Edges
from estimators.craters.detection.fitting import RIDGE, fit_reweighted
from estimators.craters.detection.grouping import Arc
from estimators.craters.detection.picture import Picture
from scenarios.geometry import Ellipses, pixel_to_opencv
from scenarios.geometry.ellipse import fit_conics, sampson_distances

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]
_SAMPLES = 16  # points that stand for an arc in the first fit
_BAND = 0.12  # of the radius: edges so near to a first fit are fitted anew
_LEAST_PROFILE = 0.3  # correlation with a rise from the shaded to the lit side
_COUNT = 400  # pairs, the best by their first fit, that are fitted anew


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Ellipses of groups of rim edges.

    Parameters
    ----------
    support
        (n,) share of the rim, transition arcs and all, along which edges agree with it.
    """

    ellipses: Ellipses
    support: FloatArray

    @classmethod
    def joined(cls, parts: Sequence[Candidates]) -> Candidates:
        """Join several."""
        return cls(
            Ellipses.joined([part.ellipses for part in parts]),
            np.concatenate([part.support for part in parts]),
        )


def candidates_of(
    pairs: IndexArray,
    shaded: list[Arc],
    lit: list[Arc],
    edges: Edges,
    picture: Picture,
    radius_px: tuple[float, float],
    axis_ratio_min: float,
) -> Candidates:
    """Fit an ellipse to each pair, then to all edges that lie on it."""
    nothing = Candidates(Ellipses.none(), np.empty(0))
    if len(pairs) == 0:
        return nothing
    points, normals = _stacked(pairs, shaded, lit)
    ellipses, good = Ellipses.among(fit_conics(points, np.ones(points.shape[:2]), RIDGE))
    agree = normal_agreement(ellipses, points[good], normals[good])
    sane = plausible(ellipses, radius_px, axis_ratio_min, picture) & (agree > 0.85)
    order = np.argsort(-agree[sane], kind="stable")[:_COUNT]
    first = ellipses[np.flatnonzero(sane)[order]]
    if len(first) == 0:
        return nothing
    points, weights, signed = edges_near(first, edges, picture)
    refitted, good = Ellipses.among(fit_reweighted(points, weights))
    sane = plausible(refitted, radius_px, axis_ratio_min, picture)
    support = rim_support(refitted, points[good], weights[good])
    both = support.min(axis=1) > 0.25
    rising = profile(refitted, picture) > _LEAST_PROFILE
    keep = sane & both & rising
    del signed
    return Candidates(refitted[keep], support[keep].mean(axis=1))


def _stacked(pairs: IndexArray, shaded: list[Arc], lit: list[Arc]) -> tuple[FloatArray, FloatArray]:
    """Points and outward normals (k, 2 * _SAMPLES, 2) of pairs."""

    def sampled(arcs: list[Arc]) -> tuple[FloatArray, FloatArray]:
        rows = [np.linspace(0, len(arc.uv_px) - 1, _SAMPLES).round().astype(np.int64) for arc in arcs]
        points = np.stack([arc.uv_px[row] for arc, row in zip(arcs, rows, strict=True)])
        return points, np.stack([arc.outward[row] for arc, row in zip(arcs, rows, strict=True)])

    one, other = sampled(shaded), sampled(lit)
    return (
        np.concatenate([one[0][pairs[:, 0]], other[0][pairs[:, 1]]], axis=1),
        np.concatenate([one[1][pairs[:, 0]], other[1][pairs[:, 1]]], axis=1),
    )


def normal_agreement(ellipses: Ellipses, points: FloatArray, normals: FloatArray) -> FloatArray:
    """Mean cosine (n,) between outward normals of edges and of the ellipse, less their mean distance over radius."""
    homogeneous = np.concatenate([points, np.ones((*points.shape[:2], 1))], axis=2)
    conics = ellipses.conics()
    slope = np.einsum("nij,nkj->nki", conics, homogeneous)[..., :2]
    slope /= np.maximum(np.linalg.norm(slope, axis=-1, keepdims=True), 1e-12)
    cosine = np.einsum("nki,nki->nk", slope, normals).mean(axis=1)
    far = np.abs(sampson_distances(points, conics)).mean(axis=1) / ellipses.radius_px
    return np.asarray(cosine - far, dtype=np.float64)


def plausible(
    ellipses: Ellipses, radius_px: tuple[float, float], axis_ratio_min: float, picture: Picture
) -> NDArray[np.bool_]:
    """Tell which have a crater's size and shape, and their centre on the ground."""
    height, width = picture.ground.shape
    radius = ellipses.radius_px
    ratio = ellipses.semi_axes_px[:, 1] / ellipses.semi_axes_px[:, 0]
    place = np.clip(np.floor(ellipses.centre_px), 0, [width - 1, height - 1]).astype(np.int64)
    inside = np.all((ellipses.centre_px >= 0) & (ellipses.centre_px < [width, height]), axis=1)
    on_ground = inside & picture.ground[place[:, 1], place[:, 0]]
    return np.asarray(
        (radius >= radius_px[0]) & (radius <= radius_px[1]) & (ratio >= axis_ratio_min) & on_ground, dtype=np.bool_
    )


def edges_near(ellipses: Ellipses, edges: Edges, picture: Picture) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Gather the edges that lie on each rim and point as its side must: points, weights, signed normals, padded."""
    tree = cKDTree(edges.uv_px)
    unit = edges.gradient / np.linalg.norm(edges.gradient, axis=1, keepdims=True)
    conics = ellipses.conics()
    chosen = []
    band = np.maximum(_BAND * ellipses.radius_px, 1.2)
    near = tree.query_ball_point(ellipses.centre_px, ellipses.semi_axes_px[:, 0] + band)
    for i, listed in enumerate(near):
        rows = np.array(listed, dtype=np.int64)
        far = sampson_distances(edges.uv_px[rows][None], conics[i : i + 1])[0]
        rows = rows[np.abs(far) < band[i]]
        slope = np.concatenate([edges.uv_px[rows], np.ones((len(rows), 1))], axis=1) @ conics[i]
        normal = slope[:, :2] / np.maximum(np.linalg.norm(slope[:, :2], axis=1, keepdims=True), 1e-12)
        signed = normal * np.sign(normal @ picture.sun_px)[:, None]
        chosen.append(np.sort(rows[np.einsum("ki,ki->k", signed, unit[rows]) > 0.8]))
    width = max(6, *(len(rows) for rows in chosen))
    points, weights, normals = (
        np.zeros((len(chosen), width, 2)),
        np.zeros((len(chosen), width)),
        np.zeros((len(chosen), width, 2)),
    )
    for i, rows in enumerate(chosen):
        points[i, : len(rows)], weights[i, : len(rows)], normals[i, : len(rows)] = edges.uv_px[rows], 1.0, unit[rows]
    return points, weights, normals


def rim_support(ellipses: Ellipses, points: FloatArray, weights: FloatArray, sectors: int = 36) -> FloatArray:
    """Share (n, 2) of the sectors of either half of the rim in which an edge lies within a tenth of the radius.

    The halves are those on which points lie with v cos(angle) - u sin(angle) above and below 0 ... by the parameter t.
    """
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


def profile(ellipses: Ellipses, picture: Picture, steps: int = 11) -> FloatArray:
    """Correlate the brightness inside, along the Sun's direction, with a rise from the shaded to the lit side: (n,)."""
    along = np.linspace(0.8, -0.8, steps)
    aside = np.array([-0.3, 0.0, 0.3])
    sun = picture.sun_px
    inverse = np.linalg.inv(ellipses.conics()[:, :2, :2]) if len(ellipses) else np.zeros((0, 2, 2))
    # In units of the ellipse the Sun's direction is that of its conjugate diameters; both span the inside.
    toward = np.einsum("nij,j->ni", inverse, sun)
    toward /= np.sqrt(np.maximum(np.einsum("ni,i->n", toward, sun), 1e-12))[:, None]
    side = np.array([-sun[1], sun[0]])
    across = (
        side
        * np.sqrt(
            np.maximum(1.0 / np.maximum(np.einsum("i,nij,j->n", side, np.linalg.inv(inverse), side), 1e-12), 0.0)
        )[:, None]
    )
    del across
    grid = ellipses.centre_px[:, None, None] + along[:, None, None] * toward[:, None, None, :]
    reach = np.sqrt(ellipses.semi_axes_px.prod(axis=1))
    grid = grid + aside[None, None, :, None] * (reach[:, None] * side)[:, None, None, :]
    place = pixel_to_opencv(grid).astype(np.float32).reshape(len(ellipses), -1, 2)
    if len(ellipses) == 0:
        return np.empty(0)
    value = cv2.remap(picture.even, place[..., 0], place[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    means = value.reshape(len(ellipses), steps, len(aside)).mean(axis=2)
    means = means - means.mean(axis=1, keepdims=True)
    ramp = -along / np.linalg.norm(along)
    return np.asarray(means @ ramp / np.maximum(np.linalg.norm(means, axis=1), 1e-12), dtype=np.float64)

"""Matching by context, after Cheng et al. (2003): constellations of craters, linear transforms, and epipolar lines."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import ClassVar

import numpy as np
from pydantic import Field

from boresight.estimators.craters.contract import CraterImage, CraterMatches, GroundModel, too_few_craters
from boresight.estimators.craters.matching.transfer import map_ellipses
from boresight.estimators.options import Configured
from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.geometry import Ellipses, cross_matrix
from boresight.scenarios.spec.base import SpecModel

_NEIGHBOURS = 8
_MAX_COMBINATIONS = 400  # choices of three candidates that are tried for a triangle
_REFITS = 5

_NO_BASELINE = 1e-6  # in distances from the body: below it the epipolar line is undefined numerically


class ContextOptions(SpecModel):
    """Options of matching by context; the paper prints 20 px, 3 px and 4 craters."""

    epipolar_px: float = Field(20.0, gt=0.0, description="Distance of a candidate from the epipolar line")
    size_ratio: float = Field(1.4, gt=1.0, description="Largest ratio of sizes, or its inverse")
    place_px: float = Field(3.0, gt=0.0, description="Largest offset of a transformed crater")
    axes_ratio: float = Field(1.3, gt=1.0, description="Largest ratio of axes, or its inverse")
    agreeing: int = Field(4, ge=3, description="More craters than this have to agree")
    least_height: float = Field(0.2, gt=0.0, lt=0.87, description="Least height of a triangle over its longest side")
    loops: int = Field(100, ge=1, description="Triangles that are tried")


class ContextMatcher(Configured[ContextOptions]):
    """Tries triangles of craters for a linear transform that maps more craters onto others than chance would.

    The paper draws three craters from anywhere and stops at the first transform that fits. On a body with relief no
    plane fits everywhere: triangles are drawn among neighbours, and the search goes on with the craters that the
    accepted transforms have not matched, until the loops are used up.

    Use it when
    -----------
    Both images have many craters in common, the relative pose is known to some pixels, and the Suns differ.

    It fails when
    -------------
    An image has no more than ``agreeing`` craters, or no transform takes more than that along: few craters, strong
    relief or a large angle between the views.

    Cost
    ----
    0.015 s a pair of ``eros-crater-pairs``, about 20 detections an image.

    Source
    ------
    Cheng et al. (2003), context matching, steps 1 to 5.
    """

    name: ClassVar[str] = "context"
    version: ClassVar[int] = 2
    options_model = ContextOptions

    def match(self, first: CraterImage, second: CraterImage, ground: GroundModel) -> CraterMatches:
        """Match by the relative positions and the shapes of craters; ``ground`` is not used."""
        del ground
        options = self.options
        if reason := too_few_craters(first, second, needed=options.agreeing + 1):
            return CraterMatches.none(reason)
        # Step 2: candidates by their distance from the epipolar line and the ratio of sizes.
        near = epipolar_offsets(first, second) < options.epipolar_px
        candidates = near & (np.abs(np.log(size_ratios(first, second))) < np.log(options.size_ratio))
        here, there = first.detections.ellipses, second.detections.ellipses
        pairs, votes = match_constellations(here, there, candidates, options, (first.number, second.number))
        if len(pairs) == 0:
            tried = f"no linear transform takes more than {options.agreeing} craters along"
            return CraterMatches.none(f"{tried} in {options.loops} loops")
        return CraterMatches(pairs, votes.astype(np.float64))


def match_constellations(
    first: Ellipses, second: Ellipses, candidates: BoolArray, options: ContextOptions, seed: tuple[int, int]
) -> tuple[IndexArray, IndexArray]:
    """Match craters by linear transforms: pairs (k, 2), and how many agreed with the transform of each, (k,).

    ``seed`` of the random triangles: the same for the same two images.
    """
    left = candidates.copy()
    found: list[IndexArray] = []
    usable = np.asarray(candidates.any(axis=1))
    # Matched craters are taken out, so that no crater is matched twice by two transforms.
    for triangle in _triangles(first.centre_px, usable, options, np.random.default_rng(seed)):
        if not left[triangle].any(axis=1).all():
            continue
        pairs = _best_combination(first, second, left, triangle, options)
        if len(pairs) > options.agreeing:
            found.append(pairs)
            left[pairs[:, 0]] = False
            left[:, pairs[:, 1]] = False
    if not found:
        return np.zeros((0, 2), dtype=np.int64), np.zeros(0, dtype=np.int64)
    return np.concatenate(found), np.concatenate([np.full(len(pairs), len(pairs)) for pairs in found])


def linear_transforms(here: FloatArray, there: FloatArray) -> FloatArray:
    """Return (c, 3, 3) T = (X'_1 X'_2 X'_3) (X_1 X_2 X_3)^-1 for three points, (3, 2), and c triples, (c, 3, 2)."""
    points = np.concatenate([here, np.ones((3, 1))], axis=1).T
    # The equation of step 3, with the points as columns: exact for three of them.
    others = np.swapaxes(np.concatenate([there, np.ones((len(there), 3, 1))], axis=2), 1, 2)
    return np.asarray(others @ np.linalg.inv(points), dtype=np.float64)


def fitted_transform(here: FloatArray, there: FloatArray) -> FloatArray:
    """Return the (3, 3) linear transform of least squares between (k, 2) and (k, 2) points, k >= 3."""
    points = np.concatenate([here, np.ones((len(here), 1))], axis=1)
    # Step 5. With homogeneous coordinates of last component 1, the linear transform of step 3 is affine as well.
    solution = np.linalg.lstsq(points, there, rcond=None)[0]
    return np.vstack([solution.T, [0.0, 0.0, 1.0]])


def agreeing_craters(
    transforms: FloatArray, first: Ellipses, second: Ellipses, candidates: BoolArray, options: ContextOptions
) -> BoolArray:
    """Return (c, n, m) which craters agree in place and in both axes after each of c transforms."""
    places = np.einsum("cij,nj->cni", transforms[:, :2, :2], first.centre_px) + transforms[:, None, :2, 2]
    offsets = np.linalg.norm(places[:, :, None] - second.centre_px, axis=3)
    agree = (offsets < options.place_px) & candidates
    # Only the couples that agree in place are mapped as ellipses, which costs most.
    which, rows, columns = np.nonzero(agree)
    ellipses, real = map_ellipses(first[rows], transforms[which])
    ratios = np.full((len(rows), 2), np.inf)
    ratios[real] = np.abs(np.log(ellipses.semi_axes_px / second.semi_axes_px[columns[real]]))
    agree[which, rows, columns] = (ratios < np.log(options.axes_ratio)).all(axis=1)
    return np.asarray(agree)


def _triangles(
    centres: FloatArray, usable: BoolArray, options: ContextOptions, rng: np.random.Generator
) -> Iterator[IndexArray]:
    """Draw rows (3,) of neighbouring craters that are not nearly collinear; ``options.loops`` draws in all (step 1)."""
    rows = np.flatnonzero(usable)
    if len(rows) < 3:
        return
    for _ in range(options.loops):
        start = rng.choice(rows)
        order = rows[np.argsort(np.linalg.norm(centres[rows] - centres[start], axis=1), kind="stable")]
        # Neighbours, because a plane fits the ground only locally.
        near = order[1 : _NEIGHBOURS + 1]
        triangle = np.concatenate([[start], rng.choice(near, 2, replace=False)])
        sides = centres[triangle] - np.roll(centres[triangle], 1, axis=0)
        # The cross product is twice the area, which is the longest side times the smallest height.
        longest2 = float((sides**2).sum(axis=1).max())
        height = abs(float(sides[0, 0] * sides[1, 1] - sides[0, 1] * sides[1, 0])) / max(longest2, 1e-12)
        if height > options.least_height:
            yield triangle


def _best_combination(
    first: Ellipses, second: Ellipses, candidates: BoolArray, triangle: IndexArray, options: ContextOptions
) -> IndexArray:
    """Try combinations of candidates for a triangle; return the pairs of the transform with most agreement.

    It is fitted to all pairs that agree, and they are searched again, until they no longer change.
    """
    # In lexicographic order; only the first if there are very many.
    choices = product(*(np.flatnonzero(row) for row in candidates[triangle]))
    different = [choice for choice in choices if len(set(choice)) == 3][:_MAX_COMBINATIONS]
    pairs = np.zeros((0, 2), dtype=np.int64)
    if not different:
        return pairs
    transforms = linear_transforms(first.centre_px[triangle], second.centre_px[np.array(different, dtype=np.int64)])
    upright = np.linalg.det(transforms) > 0.0  # the far side of a surface is never seen
    if not upright.any():
        return pairs
    agree = agreeing_craters(transforms[upright], first, second, candidates, options)
    # A crater may agree with several: the smaller count of both sides bounds the one-to-one pairs.
    counts = np.minimum(agree.any(axis=2).sum(axis=1), agree.any(axis=1).sum(axis=1))
    best = int(np.argmax(counts))
    if counts[best] <= options.agreeing:
        return pairs
    transform = transforms[upright][best]
    for _ in range(_REFITS):
        found = nearest_couples(transform, first, second, candidates, options)
        if len(found) < 3 or np.array_equal(found, pairs):
            break
        pairs = found
        transform = fitted_transform(first.centre_px[pairs[:, 0]], second.centre_px[pairs[:, 1]])
    return pairs


def nearest_couples(
    transform: FloatArray, first: Ellipses, second: Ellipses, candidates: BoolArray, options: ContextOptions
) -> IndexArray:
    """List pairs (k, 2) that agree and are each other's nearest."""
    agree = agreeing_craters(transform[None], first, second, candidates, options)[0]
    places = first.centre_px @ transform[:2, :2].T + transform[:2, 2]
    distance = np.linalg.norm(places[:, None] - second.centre_px, axis=2)
    return mutual_best(np.where(agree, distance, np.inf))


def mutual_best(cost: FloatArray) -> IndexArray:
    """List pairs (k, 2) of a cost matrix (n, m) that are the minimum of their row and of their column, and finite."""
    if cost.size == 0:
        return np.zeros((0, 2), dtype=np.int64)
    # Ties are left out: they are no evidence for either.
    least = (cost == cost.min(axis=1, keepdims=True)) & (cost == cost.min(axis=0, keepdims=True)) & np.isfinite(cost)
    once = least & (least.sum(axis=1, keepdims=True) == 1) & (least.sum(axis=0, keepdims=True) == 1)
    return np.argwhere(once).astype(np.int64)


def epipolar_offsets(first: CraterImage, second: CraterImage) -> FloatArray:
    """Return (n, m) px from each rim's centre in the second image (m) to the epipolar line of each in the first (n).

    Two images from one place have no epipolar lines: then the centre itself is predicted from the attitudes.
    """
    one, other = first.frame.prior_T_cam_body, second.frame.prior_T_cam_body
    # x2 = R x1 + t from the first to the second camera; ``here`` are the sights of the first, rotated by R.
    rotation = other.rotation @ one.rotation.T
    baseline = other.translation_m - rotation @ one.translation_m
    seen, there = (
        np.column_stack([image.detections.ellipses.centre_px, np.ones(len(image.detections.ellipses))])
        for image in (first, second)
    )
    here = seen @ np.linalg.inv(first.camera.matrix).T @ rotation.T
    length = float(np.linalg.norm(baseline))
    if length <= _NO_BASELINE * float(np.linalg.norm(other.translation_m)):
        places = here @ second.camera.matrix.T
        return np.asarray(np.linalg.norm((places[:, :2] / places[:, 2:])[:, None] - there[None, :, :2], axis=2))
    # l = K2^-T [t]x R K1^-1 u, in rows; the distance from the line is |l . u2| over the length of its first two terms.
    lines = here @ cross_matrix(baseline / length).T @ np.linalg.inv(second.camera.matrix)
    return np.asarray(np.abs(lines @ there.T) / np.linalg.norm(lines[:, :2], axis=1, keepdims=True))


def size_ratios(first: CraterImage, second: CraterImage) -> FloatArray:
    """Return (n, m) ratios of the sizes s'/s, corrected for focal length and distance from the body's origin.

    The size is the longer semi-axis, which foreshortening leaves unchanged.
    """
    sizes = [
        image.detections.ellipses.semi_axes_px[:, 0]
        * image.camera.pixel_angle_rad
        * float(np.linalg.norm(image.frame.prior_T_cam_body.translation_m))
        for image in (first, second)
    ]
    return np.asarray(sizes[1][None] / sizes[0][:, None])

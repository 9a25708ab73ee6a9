"""Identification of stars: from a prior attitude, or lost in space by triangles of angular distances."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import binom

from boresight.estimators.stars.detection import Detections
from boresight.estimators.stars.wahba import Attitude, robust_attitude, solve_wahba
from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera
from boresight.scenarios.stars import StarCatalog

_PER_FIELD = 20.0  # stars of the index in a field, of the mean over the sky
_TRIANGLES_OF, _PAIRS_OF = 12, 20  # brightest detections that hypotheses are made of
_PAIR_SIGMAS = 4.0
_LEAST_PX = 0.1  # of the standard deviation that tolerances of angles are from
_WIDE_PX = 2.0  # within which stars are gathered by the attitude of a pair or a triangle
_BLEND_PX = 4.0
_BLEND_MAG = 5.0  # a neighbour of less than a hundredth of the light moves a star by less than 0.04 px
_MOST_TRIED = 3000


@dataclass(frozen=True, slots=True, eq=False)
class Identified:
    """Detections that were identified, as their numbers and those of their stars, with the attitude from them.

    ``false_alarm`` bounds the probability that detections at random places agree as well with any attitude tried.
    """

    attitude: Attitude
    detections: IndexArray
    stars: IndexArray
    false_alarm: float


@dataclass(frozen=True, slots=True, eq=False)
class Sky:
    """A catalogue for one camera: trees of directions, and pairs of bright stars in the order of their distances.

    ``pairs`` (P, 2) are numbers of stars within one field, ``distances_rad`` (P,) ascending. ``blended`` (N,) are stars
    with a neighbour so near and bright that their images cannot be told apart.
    """

    camera: Camera
    catalog: StarCatalog
    tree: cKDTree
    blended: BoolArray
    pairs: IndexArray
    distances_rad: FloatArray

    @classmethod
    def of(cls, camera: Camera, catalog: StarCatalog) -> Sky:
        """Build for a camera; the index has the brightest stars, twenty in a field on average."""
        tree = cKDTree(catalog.directions)
        close = tree.query_pairs(_BLEND_PX * camera.pixel_angle_rad, output_type="ndarray")
        blended = np.zeros(len(catalog), dtype=bool)
        # The catalogue is in the order of magnitudes: the second of a pair is the fainter one.
        close.sort(axis=1)
        blended[close[:, 1]] = True
        blended[close[np.diff(catalog.magnitudes[close], axis=1)[:, 0] < _BLEND_MAG, 0]] = True
        across_rad = 2.0 * _half_field_rad(camera)
        # The solid angle of a field of view is its pixels' on the boresight, less at its edges.
        field_sr = camera.width_px * camera.height_px / (camera.fx_px * camera.fy_px)
        count = int(np.ceil(_PER_FIELD * 4.0 * np.pi / field_sr))
        bright = np.flatnonzero(~blended)[:count]
        near = cKDTree(catalog.directions[bright]).query_pairs(2.0 * np.sin(0.5 * across_rad), output_type="ndarray")
        pairs = bright[near].reshape(-1, 2)
        distances = _angles(*(catalog.directions[pairs[:, end]] for end in (0, 1)))
        order = np.argsort(distances, kind="stable")
        return cls(camera, catalog, tree, blended, pairs[order], distances[order])

    def predicted(self, R_cam_inertial: FloatArray, most: int) -> tuple[IndexArray, FloatArray]:
        """Return the brightest stars in the field of an attitude, and their pixels (n, 2)."""
        half_rad = _half_field_rad(self.camera)
        near = np.array(self.tree.query_ball_point(R_cam_inertial[2], 2.0 * np.sin(0.5 * half_rad)), dtype=np.int64)
        near.sort()
        uv = self.camera.project(self.catalog.directions[near] @ R_cam_inertial.T)
        inside = np.flatnonzero(self.camera.contains(uv) & ~self.blended[near])[:most]
        return near[inside], uv[inside]

    def at_distance(self, angle_rad: float, tolerance_rad: float) -> IndexArray:
        """Return the pairs, in both orders, whose distance is an angle within a tolerance."""
        start, end = np.searchsorted(self.distances_rad, [angle_rad - tolerance_rad, angle_rad + tolerance_rad])
        found = self.pairs[start:end]
        return np.concatenate([found, found[:, ::-1]])


def _half_field_rad(camera: Camera) -> float:
    """Return the greatest angle from the boresight to a corner of the image."""
    width, height = float(camera.width_px), float(camera.height_px)
    corners = camera.unproject(np.array([[0.0, 0.0], [0.0, height], [width, 0.0], [width, height]]))
    return float(np.arccos(corners[:, 2].min()))


def _angles(first: FloatArray, second: FloatArray) -> FloatArray:
    # The chord keeps the digits of small angles, which the dot product loses.
    return np.asarray(2.0 * np.arcsin(0.5 * np.linalg.norm(first - second, axis=-1)))


def identify(
    sky: Sky, seen: Detections, prior: tuple[FloatArray, FloatArray] | None, false_alarm: float
) -> Identified | str:
    """Identify detections and find the attitude; the reason in words if it cannot be found.

    ``prior`` is an attitude R_cam_inertial (3, 3) and the standard deviations (3,), rad, of its error about the camera
    axes; None if the camera is lost in space. Hypotheses come from pairs of stars within the error of the prior, or
    from triangles (Mortari et al. 2004, whose fourth star is here all others). One is accepted if the number of stars
    that agree is found by chance with a probability of at most ``false_alarm``, over all hypotheses tried.
    """
    least = 2 if prior is not None else 4
    if len(seen) < least:
        return f"{len(seen)} point sources in the image: the attitude needs {least} at least"
    search = _Search(sky, seen)
    hypotheses = search.triangles() if prior is None else search.pairs_near(*prior)
    best: Identified | None = None
    for tried, (hypothesis, known, chance) in enumerate(hypotheses, start=1):
        found = search.verified(hypothesis, known)
        if found is not None:
            bound = min(1.0, found.false_alarm * (tried if chance is None else chance))
            if bound <= false_alarm:
                return Identified(found.attitude, found.detections, found.stars, bound)
            best = found if best is None or len(found.stars) > len(best.stars) else best
        if tried == _MOST_TRIED:
            break
    agreed = 0 if best is None else len(best.stars)
    return f"no attitude has enough stars: {agreed} of {len(seen)} point sources agree at most"


Hypothesis = tuple[FloatArray, int, float | None]
"""An attitude, the number of stars that it is made of, and how many such chance makes; None: as many as are tried."""


class _Search:
    """Hypotheses about the attitude of one image, and their verification."""

    def __init__(self, sky: Sky, seen: Detections) -> None:
        self._sky, self._seen = sky, seen
        self._cam = sky.camera.unproject(seen.uv_px)
        self._sigma_px = np.maximum(seen.sigma_px, _LEAST_PX)
        self._sigma_rad = seen.sigma_px * sky.camera.pixel_angle_rad
        self._most = 2 * len(seen) + 10

    def pairs_near(self, R_prior: FloatArray, sigma_rad: FloatArray) -> Iterator[Hypothesis]:
        """Yield attitudes by pairs of detections and stars that are within the error of a prior."""
        sky = self._sky
        stars, uv = sky.predicted(R_prior, self._most)
        # A turn moves a star by the focal length times its angle, about z by the distance from the middle times it.
        corner_px = 0.5 * np.hypot(sky.camera.width_px, sky.camera.height_px)
        errors_px = np.hypot(np.hypot(*sigma_rad[:2]) / sky.camera.pixel_angle_rad, sigma_rad[2] * corner_px)
        reach_px = _PAIR_SIGMAS * float(np.hypot(errors_px, np.median(self._sigma_px)))
        away = np.linalg.norm(self._seen.uv_px[:_PAIRS_OF, None] - uv, axis=2)
        near = [np.flatnonzero(row <= reach_px) for row in away]
        by_chance = len(uv) * np.pi * reach_px**2 / (sky.camera.width_px * sky.camera.height_px)
        pairs = list(combinations(range(len(near)), 2))
        for i, j in pairs:
            for a, b in product(near[i], near[j]):
                if a != b and self._fits((i, j), (stars[a], stars[b])):
                    hypothesis = self._solved((i, j), (stars[a], stars[b]))
                    if hypothesis is not None:
                        # So many stars are near each of the two by chance, for every pair of detections.
                        yield hypothesis, 2, len(pairs) * by_chance**2

    def triangles(self) -> Iterator[Hypothesis]:
        """Yield attitudes by triangles of the brightest detections, in Mortari's order, which spreads the faults."""
        count = min(len(self._seen), _TRIANGLES_OF)
        steps = ((step, more) for step in range(1, count - 1) for more in range(1, count - step))
        for i, j, k in ((i, i + step, i + step + more) for step, more in steps for i in range(count - step - more)):
            for a, b, c in self._corners(i, j, k):
                hypothesis = self._solved((i, j, k), (a, b, c))
                if hypothesis is not None:
                    yield hypothesis, 3, None

    def _corners(self, i: int, j: int, k: int) -> IndexArray:
        """(m, 3) numbers of stars whose triangle has the sides and the sense of that of three detections."""
        sky = self._sky
        first, second = (sky.at_distance(*self._side(i, end)) for end in (j, k))
        second = second[np.argsort(second[:, 0], kind="stable")]
        starts, ends = (np.searchsorted(second[:, 0], first[:, 0], side=side) for side in ("left", "right"))
        counts = ends - starts
        # The rows of `second` that share the corner of each row of `first`.
        offsets = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        corners = np.column_stack([np.repeat(first, counts, axis=0), second[np.repeat(starts, counts) + offsets, 1]])
        at = sky.catalog.directions[corners]
        angle, tolerance = self._side(j, k)
        fits = np.abs(_angles(at[:, 1], at[:, 2]) - angle) <= tolerance
        sense = np.linalg.det(self._cam[[i, j, k]])
        return np.asarray(corners[fits & (np.sign(np.linalg.det(at)) == np.sign(sense))], dtype=np.int64)

    def _side(self, i: int, j: int) -> tuple[float, float]:
        """Return the angle between two detections, and its tolerance."""
        tolerance_px = _PAIR_SIGMAS * float(np.hypot(self._sigma_px[i], self._sigma_px[j]))
        return float(_angles(self._cam[i], self._cam[j])), tolerance_px * self._sky.camera.pixel_angle_rad

    def _fits(self, seen: tuple[int, int], stars: tuple[int, int]) -> bool:
        angle, tolerance = self._side(*seen)
        between = _angles(*self._sky.catalog.directions[list(stars)])
        return bool(abs(float(between) - angle) <= tolerance)

    def _solved(self, seen: tuple[int, ...], stars: tuple[int, ...]) -> FloatArray | None:
        chosen = list(seen)
        try:
            return solve_wahba(self._cam[chosen], self._sky.catalog.directions[list(stars)], self._sigma_rad[chosen])[0]
        except BoresightError:
            return None

    def verified(self, R_cam_inertial: FloatArray, known: int) -> Identified | None:
        """Gather the stars that agree with an attitude made of ``known`` of them, twice, the second time closely.

        The false alarm is the probability that as many of the others are near a star by chance: binomial.
        """
        found: Identified | None = None
        for reach_px in (_WIDE_PX, max(0.5, 4.0 * float(np.median(self._sigma_px)))):
            stars, uv = self._sky.predicted(R_cam_inertial, self._most)
            numbers, places = self._matched(uv, reach_px)
            if len(numbers) < max(2, known):
                return None
            cam, inertial = self._cam[numbers], self._sky.catalog.directions[stars[places]]
            try:
                attitude = robust_attitude(cam, inertial, self._sigma_rad[numbers])
            except BoresightError:
                return None
            R_cam_inertial = attitude.R_cam_inertial
            area_px2 = self._sky.camera.width_px * self._sky.camera.height_px
            chance = min(1.0, len(stars) * np.pi * reach_px**2 / area_px2)
            agree = int(attitude.used.sum())
            alarm = float(binom.sf(agree - known - 1, len(self._seen) - known, chance))
            used = attitude.used
            found = Identified(attitude, numbers[used], stars[places][used], alarm)
        return found

    def _matched(self, uv: FloatArray, reach_px: float) -> tuple[IndexArray, IndexArray]:
        """Return numbers of detections and predicted stars that are each other's nearest within a distance."""
        none = np.zeros(0, dtype=np.int64)
        if not len(uv):
            return none, none
        away = np.linalg.norm(self._seen.uv_px[:, None] - uv[None], axis=2)
        nearest, back = away.argmin(axis=1), away.argmin(axis=0)
        numbers = np.arange(len(nearest))
        mutual = (back[nearest] == numbers) & (away[numbers, nearest] <= reach_px)
        return numbers[mutual], nearest[mutual]

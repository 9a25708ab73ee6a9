"""Features of images, matches along epipolar lines, and tracks of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.geometry import Pose, cross_matrix

_LIT_DN = 20.0
_LARGEST_PX = 2.5  # mean diameter of a track's features: larger ones follow the light more
_ANGLE_DEG = 35.0  # between two views that are matched
_OFF_LINE_PX = 6.0
_RADIUS_M = 3000.0  # of the body: how far a feature may move between two views
_DISTANCE2 = 0.35
_RATIO = 0.8
_FEWEST = 3


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """Observations of landmarks: image (m,), landmark (m,), and place (m, 2), px; n landmarks."""

    image: IndexArray
    landmark: IndexArray
    uv_px: FloatArray
    n: int

    def keep(self, which: NDArray[np.bool_]) -> tuple[Tracks, IndexArray]:
        """Return some observations, without landmarks that fewer than three images see, and the old landmarks' rows."""
        which = which & (np.bincount(self.landmark[which], minlength=self.n) >= _FEWEST)[self.landmark]
        old, new = np.unique(self.landmark[which], return_inverse=True)
        return Tracks(self.image[which], new, self.uv_px[which], len(old)), old


@dataclass(frozen=True, slots=True, eq=False)
class _Features:
    """Places (k, 2) in OpenCV's pixels, diameters (k,), px, and RootSIFT descriptors (k, 128)."""

    place: FloatArray
    size: FloatArray
    descriptor: NDArray[np.float32]


def find_tracks(images: Sequence[NDArray[np.uint8]], poses: Sequence[Pose], focal_px: float) -> Tracks:
    """Match features of images and join the matches to tracks.

    ``poses`` (T_cam_body) are those of the label: matches lie within 6 px of the epipolar lines that they give, so
    that they may be off by as much. The principal point is the centre of the image.
    """
    features = [_features(image) for image in images]
    sights = np.array([pose.camera_position_m / np.linalg.norm(pose.camera_position_m) for pose in poses])
    near = sights @ sights.T > np.cos(np.radians(_ANGLE_DEG))
    first = np.cumsum([0, *(len(one.place) for one in features)])
    centre = (np.array(images[0].shape[::-1]) - 1.0) / 2.0
    edges: list[tuple[int, int]] = []
    for i, j in zip(*np.nonzero(np.triu(near, 1)), strict=True):
        matches = _matches(features[i], features[j], poses[i], poses[j], focal_px, centre)
        edges += [(first[i] + a, first[j] + b) for a, b in matches]
    image = np.concatenate([np.full(len(one.place), i) for i, one in enumerate(features)])
    group = _joined(edges, image)
    counts = np.bincount(group[group >= 0])
    sizes = np.concatenate([one.size for one in features])
    mean = np.bincount(group[group >= 0], sizes[group >= 0]) / np.maximum(counts, 1)
    good = (group >= 0) & ((mean < _LARGEST_PX) & (counts >= _FEWEST))[group]
    rows = np.flatnonzero(good)
    _, landmark = np.unique(group[rows], return_inverse=True)
    # OpenCV has the centre of the first pixel at (0, 0), this package at (0.5, 0.5).
    place = np.concatenate([one.place for one in features])[rows] + 0.5
    return Tracks(image[rows], landmark, place, int(landmark.max()) + 1)


def _features(image: NDArray[np.uint8]) -> _Features:
    finder = cv2.SIFT_create(
        nOctaveLayers=4, contrastThreshold=0.01, edgeThreshold=15, sigma=1.2, enable_precise_upscale=True
    )
    points, descriptors = finder.detectAndCompute(image, None)
    place, size = np.array([point.pt for point in points]), np.array([point.size for point in points])
    u, v = place.astype(int).T
    lit = (cv2.GaussianBlur(image, (0, 0), 2)[v, u] > _LIT_DN) & (size < 16.0)
    root = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-9))
    return _Features(place[lit], size[lit], root[lit])


def _matches(
    a: _Features, b: _Features, pose_a: Pose, pose_b: Pose, focal_px: float, centre: FloatArray
) -> list[tuple[int, int]]:
    """Pair the features of two images that are each other's nearest among those at the epipolar line."""
    turn = pose_b.rotation @ pose_a.rotation.T
    step = pose_b.translation_m - turn @ pose_a.translation_m
    rays_a, rays_b = (np.c_[(one.place - centre) / focal_px, np.ones(len(one.place))] for one in (a, b))
    lines = rays_a @ (cross_matrix(step) @ turn).T
    off_px = np.abs(lines @ rays_b.T) / np.linalg.norm(lines[:, :2], axis=1)[:, None] * focal_px
    # Where a feature would be if it lay as deep as the body's origin: relief takes it along the line from there.
    flat = (rays_a * pose_a.translation_m[2]) @ turn.T + step
    apart = np.linalg.norm((flat[:, :2] / flat[:, 2:])[:, None] - rays_b[:, :2], axis=2) * focal_px
    sights = [pose.camera_position_m / np.linalg.norm(pose.camera_position_m) for pose in (pose_a, pose_b)]
    limit = _RADIUS_M * np.linalg.norm(np.cross(*sights)) / pose_b.translation_m[2] * focal_px + 8.0
    distance2 = np.where((off_px < _OFF_LINE_PX) & (apart < limit), 2.0 - 2.0 * a.descriptor @ b.descriptor.T, 4.0)
    row, nearest = np.arange(len(a.place)), distance2.argmin(axis=1)
    best, mutual = distance2[row, nearest], distance2.argmin(axis=0)[nearest] == row
    # The same place with another orientation is no rival.
    same = np.linalg.norm(b.place[nearest][:, None] - b.place, axis=2) < 2.0
    rival = np.where(same, 4.0, distance2).min(axis=1)
    good = mutual & (best < _DISTANCE2) & (best < _RATIO**2 * rival)
    return list(zip(row[good].tolist(), nearest[good].tolist(), strict=True))


def _joined(edges: Sequence[tuple[int, int]], image: IndexArray) -> IndexArray:
    """Number the groups of matched features, -1 for none; no group has two features of one image."""
    parent = np.arange(len(image))
    seen: dict[int, set[int]] = {}

    def root(a: int) -> int:
        while parent[a] != a:
            parent[a] = parent[parent[a]]
            a = int(parent[a])
        return a

    for a, b in edges:
        one, other = root(a), root(b)
        of_one, of_other = seen.get(one, {int(image[one])}), seen.get(other, {int(image[other])})
        if one != other and not of_one & of_other:
            parent[other] = one
            seen[one] = of_one | of_other
            seen.pop(other, None)
    group = np.full(len(image), -1)
    for a in {a for edge in edges for a in edge}:
        group[a] = root(a)
    return group

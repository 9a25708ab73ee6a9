"""Tracks through a set of images whose attitudes are known: features are matched in pairs of images, and joined.

Of the camera's positions nothing is used: the direction of motion of a pair is found from its matches.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from boresight.estimators.slam.vision.matching import (
    ImageFeatures,
    direction_inliers,
    fitted_direction,
    match_descriptors,
    off_plane,
)
from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.geometry import Camera

# By chance, up to 7 matches agree with a direction of motion: 443 pairs of images of 67P that show other sides of it.
_LEAST_AGREE = 10
_LEAST_SHARE = 0.2  # of the matches: where there are thousands, more than 10 agree by chance
_LEAST_PARALLAX_PX = 1.0  # between the lines of sight of a track: less is the noise of its pixels


@dataclass(frozen=True, slots=True)
class TrackingOptions:
    """Which features are matched, in which images, and how.

    ``detector`` and ``features`` are those of `find_features`, the latter the most of an image. ``angle_max_deg`` is
    the angle between two boresights in body axes, ``following`` the number of later images that one is matched with
    (None: all), ``ratio_max`` as of `match_descriptors`, and ``epipolar_max_px`` the largest distance of a match from
    its epipolar line.
    """

    detector: str = "sift"
    features: int = 3000
    angle_max_deg: float = 40.0
    following: int | None = None
    ratio_max: float = 0.8
    epipolar_max_px: float = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class ImageTracks:
    """S sightings in the order of tracks and of frames, each track of two at least.

    ``tracks`` (S,) are numbers from 0, ``frames`` (S,) those of the images, ``uv_px`` (S, 2) pixels. ``pairs`` is the
    number of pairs of images that were matched, ``agreeing`` that of those with a common direction of motion, and
    ``off_line_px`` (K,) are the signed distances of their matches from the epipolar lines.
    """

    tracks: IndexArray
    frames: IndexArray
    uv_px: FloatArray
    pairs: int
    agreeing: int
    off_line_px: FloatArray

    @property
    def sightings(self) -> IndexArray:
        """Number of sightings of each track."""
        return np.bincount(self.tracks)

    def going_on(self, n_frames: int) -> IndexArray:
        """(n_frames - 1,) number of tracks that are seen in a frame and in the next one."""
        on = (np.diff(self.tracks) == 0) & (np.diff(self.frames) == 1)
        return np.bincount(self.frames[:-1][on], minlength=n_frames - 1)


def track_features(
    features: Sequence[ImageFeatures],
    R_cam_body: FloatArray,
    camera: Camera,
    options: TrackingOptions,
    rng: np.random.Generator,
) -> ImageTracks:
    """Match the features of F images, in the order of time, and join the matches to tracks.

    ``R_cam_body`` (F, 3, 3) are the attitudes, ``camera`` is a pinhole, and ``rng`` draws the samples of RANSAC. A
    track may have gaps. One that would be at two places of an image has a wrong match and is left out, and so is one
    without parallax.
    """
    image = np.repeat(np.arange(len(features)), [len(one) for one in features])
    uv_px = np.concatenate([one.uv_px for one in features])
    # Several features may be at one place, with other orientations: a place is seen once.
    seen, place = np.unique(np.column_stack([image, uv_px]), axis=0, return_inverse=True)
    place = place.ravel()
    rays = camera.unproject(uv_px)
    rays_body = np.einsum("sji,sj->si", R_cam_body[image], rays)
    first = np.cumsum([0, *(len(one) for one in features)])
    links, off_line_px = [np.empty((0, 2), dtype=np.int64)], [np.empty(0)]
    pairs = list(_pairs(R_cam_body, options))
    for i, j in pairs:
        rows = np.array([first[i], first[j]]) + match_descriptors(features[i], features[j], options.ratio_max)
        before, after = rays_body[rows[:, 0]], rays_body[rows[:, 1]]
        kept = direction_inliers(before, after, options.epipolar_max_px * camera.pixel_angle_rad, rng)
        if kept.sum() < max(_LEAST_AGREE, _LEAST_SHARE * len(kept)):
            continue
        links.append(place[rows[kept]])
        off = off_plane(before[kept], after[kept], fitted_direction(before[kept], after[kept]))
        off_line_px.append(off / camera.pixel_angle_rad)
    directions = np.zeros((len(seen), 3))
    directions[place] = rays_body
    least_rad = _LEAST_PARALLAX_PX * camera.pixel_angle_rad
    rows, tracks = _joined(np.concatenate(links), seen[:, 0].astype(np.int64), directions, least_rad)
    return ImageTracks(
        tracks, seen[rows, 0].astype(np.int64), seen[rows, 1:], len(pairs), len(links) - 1, np.concatenate(off_line_px)
    )


def _pairs(R_cam_body: FloatArray, options: TrackingOptions) -> Iterator[tuple[int, int]]:
    """Yield the pairs of images that are matched, the earlier one first."""
    boresights = R_cam_body[:, 2]  # body axes
    near = boresights @ boresights.T >= np.cos(np.radians(options.angle_max_deg))
    for i, j in np.argwhere(np.triu(near, 1)).tolist():
        if options.following is None or j - i <= options.following:
            yield i, j


def _joined(
    links: IndexArray, image: IndexArray, directions: FloatArray, least_rad: float
) -> tuple[IndexArray, IndexArray]:
    """Join places that are linked; return the rows of those in tracks, by track and image, and their tracks.

    ``links`` (K, 2) are rows of places, whose images are ``image`` (n,) and whose lines of sight ``directions`` (n, 3)
    in body axes. A track has a parallax of ``least_rad`` at least.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n = len(image)
    graph = coo_array((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(n, n))
    count, group = connected_components(graph, directed=False)
    size = np.bincount(group, minlength=count)
    both, times = np.unique(np.column_stack([group, image]), axis=0, return_counts=True)
    total = np.zeros((count, 3))
    np.add.at(total, group, directions)
    # Mean length of unit vectors, 1 - v / 2 with v the mean square of their angles from their mean.
    spread = 2.0 * (1.0 - np.linalg.norm(total, axis=1) / np.maximum(size, 1))
    good = (size > 1) & (4.0 * spread > least_rad**2)  # of two lines of sight, v is (angle / 2)^2
    good[both[times > 1, 0]] = False
    rows = np.flatnonzero(good[group])
    _, begin = np.unique(group[rows], return_index=True)
    # Numbered in the order in which they begin: places are in the order of images.
    number = np.full(count, -1)
    number[group[rows][np.sort(begin)]] = np.arange(len(begin))
    rows = rows[np.argsort(number[group[rows]], kind="stable")]
    return rows, number[group[rows]]

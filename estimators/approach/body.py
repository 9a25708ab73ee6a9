"""The lit body in an image, and renderings of the body in windows of the image."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from boresight.estimators.contract import ImageRenderer
from boresight.estimators.landmark.signal import background_level, unusable
from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.geometry import Camera, Pose, View
from boresight.scenarios.observation import Frame

_SIGMAS, _SHARE = 5.0, 0.02
_LEAST_PIXELS = 3
_MARGIN_PX = 5
_STAR_PX = 7  # side of a group that may be a star
# Of the area of the body's group: what is smaller and touches the border of the image is a cosmic ray, not the body.
_SPECK_SHARE = 0.005
_SKY_ROWS = 128
_SKY_BLOCKS = 16  # on the shorter side of an image
BODY_SHARE = 0.2
"""Of the bright level of a body: dust before the sky of 67P has up to a tenth."""
# Of the predicted lit area: errors of the shape, and shadows of relief, which only darken.
_MOST_LIT, _LEAST_LIT = 2.0, 0.25
# Sides of a rendered body, px: below it is rendered enlarged, and pixels are means of what is rendered.
RENDERED_PX, _MOST_ENLARGED = 96, 32


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """A rectangle of an image: its pixels (h, w), and the column and row of the first one, which may be negative."""

    image: FloatArray
    column: int
    row: int

    def cut(self, like: Patch) -> FloatArray:
        """Return the pixels of this patch at those of another (h, w), 0 where it has none."""
        found = np.zeros(like.image.shape)
        top, left = like.row - self.row, like.column - self.column
        rows = slice(max(top, 0), min(top + len(found), len(self.image)))
        columns = slice(max(left, 0), min(left + found[0].size, self.image[0].size))
        if rows.start < rows.stop and columns.start < columns.stop:
            inside = slice(rows.start - top, rows.stop - top), slice(columns.start - left, columns.stop - left)
            found[inside] = self.image[rows, columns]
        return found

    def centres(self) -> tuple[FloatArray, FloatArray]:
        """Return the columns (1, w) and rows (h, 1) of the centres of the pixels, px of the image."""
        height, width = self.image.shape
        columns, rows = np.arange(width, dtype=np.float64)[None], np.arange(height, dtype=np.float64)[:, None]
        return columns + (self.column + 0.5), rows + (self.row + 0.5)


@dataclass(frozen=True, slots=True, eq=False)
class LitBody:
    """The lit body in an image.

    ``patch`` has the image without the level of the sky in the box of the body, ``lit`` (h, w) are its pixels that are
    brighter than ``floor``, and pixels farther than two from those are 0. ``noise`` is the standard deviation of a
    pixel of the sky. ``cut`` says whether lit pixels are at the border of the image.
    """

    patch: Patch
    lit: BoolArray
    floor: float
    noise: float
    cut: bool

    @property
    def extent_px(self) -> float:
        """Longer side of the box of the lit pixels, px."""
        return float(max(np.ptp(np.flatnonzero(self.lit.any(axis=axis))) for axis in (0, 1)) + 1)

    def brighter(self, share: float) -> LitBody:
        """Return the body by its pixels above a share of its bright level: dust around a comet is darker."""
        floor = max(self.floor, share * float(np.percentile(self.patch.image[self.lit], 99.0)))
        return replace(self, lit=self.patch.image > floor, floor=floor)


def find_body(frame: Frame, camera: Camera, diameter_px: float, lit_px: float, blur_px: float) -> LitBody | str:
    """Find the lit body in an image, or return the reason why there is none.

    A sky that grows brighter across the frame is made even before, see `sky_slope`. The body is the group of
    neighbouring pixels, three at least, brighter than five standard deviations of the sky and than a
    fiftieth of the image's bright level, whose area is nearest by ratio to the predicted one: ``lit_px`` grown all
    around by half a pixel and by two standard deviations ``blur_px`` of the point spread, where an edge falls to a
    fiftieth. All such groups within ``diameter_px`` of its middle that are not larger belong to it: shadows divide a
    body. A group that does not fit with the larger ones into one circle is of another body; the circle is
    ``diameter_px`` wide, and wider by two standard deviations of the range, or as wide as that of the first group.
    Small groups beyond half of ``diameter_px`` are taken for stars, and groups of less than 0.5 % of the area at the
    border of the image for tracks of cosmic rays, so that they do not say that the frame cuts the body. Groups within
    five standard deviations of where the prior has the body come first: stars may be larger than a small body.

    What is found is another body if its bright part is more than twice the predicted area, or if it is less than a
    quarter of ``lit_px`` and the frame does not cut it, by more than five standard deviations of the range. Raise
    BoresightError if the image does not have the camera's size.
    """
    if fault := unusable(frame, camera):
        return fault
    image = frame.image
    # Of some rows: that of all takes longer than the rest of a method.
    every = max(1, image.shape[0] // _SKY_ROWS)
    level, noise = background_level(image[::every])
    if (slope := sky_slope(image, noise)) is not None:
        image = image - slope
        level, noise = background_level(image[::every])
    lit = image > np.float32(level + _SIGMAS * noise)
    rows, columns = np.flatnonzero(lit.any(axis=1)), np.flatnonzero(lit.any(axis=0))
    if not len(rows):
        return "nothing is brighter than the background: the image is black, or the body fills it"
    top, left = int(rows[0]), int(columns[0])
    box = slice(top, int(rows[-1]) + 1), slice(left, int(columns[-1]) + 1)
    full = float(np.percentile(image[box][lit[box]], 99.0)) - level
    floor = max(_SIGMAS * noise, _SHARE * full)
    lit = image[box] > np.float32(level + floor)
    _, labels, stats, middles = cv2.connectedComponentsWithStats(lit.astype(np.uint8), connectivity=8)
    areas = stats[:, cv2.CC_STAT_AREA]
    areas[0] = 0  # the sky
    if areas.max() < _LEAST_PIXELS:
        return f"the image shows no body: no {_LEAST_PIXELS} neighbouring pixels are brighter than the sky"
    expected_px, reach_px = _expected(frame, camera)
    near_prior = np.linalg.norm(middles - (expected_px - [left, top]), axis=1) <= reach_px + diameter_px
    sizes = np.where(areas >= _LEAST_PIXELS, areas, 1e-9)
    preferred = np.where(near_prior, sizes, 1e-9)
    edge_px = 2.0 * blur_px + 0.5
    seen_px = lit_px + np.pi * edge_px * (diameter_px + edge_px)
    ratio = (preferred if preferred.max() > 1.0 else sizes) / seen_px
    first = int(np.abs(np.log(ratio)).argmin())
    apart_px = np.linalg.norm(middles - middles[first], axis=1)
    sides = stats[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].max(axis=1)
    star = (sides <= _STAR_PX) & (apart_px > 0.5 * diameter_px)
    kept = (areas >= _LEAST_PIXELS) & (areas <= areas[first]) & (apart_px <= diameter_px + _MARGIN_PX) & ~star
    corners = stats[:, [cv2.CC_STAT_LEFT, cv2.CC_STAT_TOP]] + [left, top]
    ends, whole = corners + stats[:, [2, 3]], np.array([camera.width_px, camera.height_px])
    at_border = ((corners <= 0) | (ends >= whole)).any(axis=1)
    kept &= ~at_border | (areas >= _SPECK_SHARE * areas[first])
    sigma = _range_sigma(frame)
    kept &= of_one_body(labels, stats[:, :4], np.where(kept, areas, 0), diameter_px * (1.0 + 2.0 * sigma))
    cut = bool(at_border[kept].any())
    low = np.maximum(corners[kept].min(axis=0) - _MARGIN_PX, 0)
    high = np.minimum(ends[kept].max(axis=0) + _MARGIN_PX, whole)
    box = slice(low[1], high[1]), slice(low[0], high[0])
    chosen = Patch(kept[labels].astype(np.float64), left, top)
    patch = Patch(image[box].astype(np.float64) - level, int(low[0]), int(low[1]))
    lit = chosen.cut(patch) > 0.0
    body = LitBody(replace(patch, image=near(patch.image, lit)), lit, floor, noise, cut)
    scale = (1.0 + _SIGMAS * sigma) ** 2
    if (found_px := np.count_nonzero(body.brighter(BODY_SHARE).lit)) > (most_px := _MOST_LIT * scale * seen_px):
        return f"what is lit covers {found_px} px, but the body at most {most_px:.0f} px: it is another one, or two"
    if not cut and (found_px := np.count_nonzero(lit)) < (least_px := _LEAST_LIT / scale * lit_px):
        return f"what is lit covers {found_px} px, but the body at least {least_px:.0f} px: it is another one"
    return body


def sky_slope(image: NDArray[np.float32], noise: float) -> NDArray[np.float32] | None:
    """Return the plane (H, W) of a sky that is not even over an image (H, W), as by stray light; None if it is.

    Light of the body only adds. So the plane is fitted to the medians of blocks of the image, and those above it by
    more than the noise of a pixel, ``noise``, are left out until none is. The slope counts if the rest is an eighth of
    all blocks, as wide and as high as half the frame, if it is known to five standard deviations, and if the sky
    differs over the frame by five of a pixel, which are taken for light. Dust around the comet 67P makes it differ by
    two or three, and is no plane.
    """
    height, width = image.shape
    side = max(4, min(height, width) // _SKY_BLOCKS)
    rows, columns = height // side, width // side
    some = image[: rows * side, : columns * side].reshape(rows, side, columns, side)[:, :: max(1, side // 8)]
    medians = np.median(some.transpose(0, 2, 1, 3).reshape(rows * columns, -1), axis=1).astype(np.float64)
    down, across = (part.ravel() / of for part, of in zip(np.indices((rows, columns)), (rows, columns), strict=True))
    plane = np.column_stack([across, down, np.ones(len(medians))])
    kept, before = np.ones(len(medians), dtype=bool), None
    while before is None or not np.array_equal(kept, before):
        if kept.sum() < len(medians) // 8:
            return None
        before = kept
        fit = np.linalg.lstsq(plane[kept], medians[kept], rcond=None)[0]
        kept = kept & (medians - plane @ fit <= noise)
    fall, apart = fit[:2], medians[kept] - plane[kept] @ fit
    centred = plane[kept, :2] - plane[kept, :2].mean(axis=0)
    certain = fall @ (centred.T @ centred) @ fall > _SIGMAS**2 * apart.var()
    counts = certain and np.abs(fall).sum() >= _SIGMAS * noise
    if noise == 0.0 or not counts or np.ptp(plane[kept, :2], axis=0).min() < 0.5:
        return None
    x, y = (np.arange(size, dtype=np.float32) / np.float32(size) for size in (width, height))
    return np.asarray(np.float32(fall[0]) * x + np.float32(fall[1]) * y[:, None], dtype=np.float32)


def of_one_body(labels: IndexArray, boxes: IndexArray, areas: IndexArray, diameter_px: float) -> BoolArray:
    """(G,) whether a group, of ``labels`` (H, W), is in one circle with the larger ones; an area of 0 is of none.

    ``boxes`` (G, 4) are left, top, width and height. The circle is as wide as the body may be, ``diameter_px``, or as
    that of the largest group, and the margin wider.
    """
    order = np.argsort(-areas, kind="stable")[: np.count_nonzero(areas)]
    one = np.zeros(len(areas), dtype=bool)
    hull, widest_px = np.zeros((0, 1, 2), dtype=np.float32), np.inf
    for group in order:
        left, top, width, height = boxes[group]
        ends = row_ends(labels[top : top + height, left : left + width] == group)
        points = (ends + np.array([left, top]))[:, None].astype(np.float32)
        both = cv2.convexHull(np.concatenate([hull, points]))
        across_px = 2.0 * cv2.minEnclosingCircle(both)[1] + 1.0
        one[group] = across_px <= widest_px
        hull = both if one[group] else hull
        widest_px = min(widest_px, max(diameter_px, across_px) + _MARGIN_PX)
    return one


def row_ends(mask: BoolArray) -> IndexArray:
    """Columns and rows (n, 2) of the first and last pixels of the rows of a mask (h, w), which hold its convex hull."""
    rows = np.flatnonzero(mask.any(axis=1))
    last = mask.shape[1] - 1 - mask[rows, ::-1].argmax(axis=1)
    return np.column_stack([np.concatenate([mask[rows].argmax(axis=1), last]), np.tile(rows, 2)])


def _expected(frame: Frame, camera: Camera) -> tuple[FloatArray, float]:
    """Return where the prior has the body's origin (2,), px, and five standard deviations of that, px."""
    translation_m = frame.prior_T_cam_body.translation_m
    by_position = camera.jacobian(translation_m)
    covariance_px2 = by_position @ frame.prior_covariance[3:, 3:] @ by_position.T
    return camera.project(translation_m), _SIGMAS * float(np.sqrt(np.trace(covariance_px2)))


def _range_sigma(frame: Frame) -> float:
    """Return the standard deviation of the range of the prior, as a share of it."""
    translation_m = frame.prior_T_cam_body.translation_m
    range_m = float(np.linalg.norm(translation_m))
    sight = translation_m / range_m
    return float(np.sqrt(sight @ frame.prior_covariance[3:, 3:] @ sight)) / range_m


def near(image: FloatArray, lit: BoolArray) -> FloatArray:
    """Return an image (h, w) with 0 where no pixel of ``lit`` (h, w) is within two pixels: the blur of the optics."""
    grown = cv2.dilate(lit.astype(np.uint8), np.ones((5, 5), dtype=np.uint8))
    return np.where(grown > 0, image, 0.0)


def sphere_px(radius_m: float, T_cam_body: Pose, camera: Camera) -> float:
    """Return the diameter, px, of a sphere about the body's origin in the image, seen from outside."""
    range_m = float(np.linalg.norm(T_cam_body.translation_m))
    return 2.0 * radius_m / max(range_m, radius_m) / camera.pixel_angle_rad


def lit_area_px(area_vectors_m2: FloatArray, T_cam_body: Pose, sun_dir_cam: FloatArray, camera: Camera) -> float:
    """Return the area, px, of the facets (F, 3) of a closed mesh that are lit and face the camera.

    Exact for a convex body far away; of others what is shadowed or hidden is counted too.
    """
    camera_m = T_cam_body.camera_position_m
    range_m = float(np.linalg.norm(camera_m))
    across_m2 = area_vectors_m2 @ (camera_m / range_m)
    lit = (across_m2 > 0.0) & (area_vectors_m2 @ (T_cam_body.rotation.T @ sun_dir_cam) > 0.0)
    return float(across_m2[lit].sum()) / (range_m * camera.pixel_angle_rad) ** 2


@dataclass(frozen=True, slots=True, eq=False)
class BodyView:
    """Renderings of a body in windows of the image, by its distance from the camera.

    ``radius_m`` is the radius of a sphere about the origin that holds the body, ``area_vectors_m2`` (F, 3) are those of
    its facets, ``sun_dir_cam`` (3,) is in camera axes, and ``blur_px`` the standard deviation of the point spread
    function.
    """

    renderer: ImageRenderer
    radius_m: float
    area_vectors_m2: FloatArray
    camera: Camera
    sun_dir_cam: FloatArray
    blur_px: float

    def diameter_px(self, T_cam_body: Pose) -> float:
        """Diameter of the sphere in the image, px."""
        return sphere_px(self.radius_m, T_cam_body, self.camera)

    def find_body(self, frame: Frame) -> LitBody | str:
        """Find the body in an image of the camera; see `find_body`."""
        prior = frame.prior_T_cam_body
        lit = lit_area_px(self.area_vectors_m2, prior, self.sun_dir_cam, self.camera)
        return find_body(frame, self.camera, self.diameter_px(prior), lit, self.blur_px)

    def render(self, T_cam_body: Pose) -> Patch | None:
        """Render the body in a window that has all of it; None if it is dark or behind the camera.

        A small body is rendered enlarged, and pixels are means of squares.
        """
        middle_px = self.camera.project(T_cam_body.translation_m)
        diameter_px = self.diameter_px(T_cam_body)
        if not np.isfinite(middle_px).all() or diameter_px > 4 * max(self.camera.width_px, self.camera.height_px):
            return None
        # Off the boresight a sphere is an ellipse, longer by the secant of its angle.
        half = int(np.ceil(0.5 * diameter_px * float(np.linalg.norm(T_cam_body.translation_m))
                           / float(T_cam_body.translation_m[2]))) + _MARGIN_PX  # fmt: skip
        column, row = (int(value) - half for value in np.floor(middle_px))
        enlarged = int(np.clip(np.ceil(RENDERED_PX / diameter_px), 1, _MOST_ENLARGED))
        camera = self.camera
        window = Camera(
            2 * half * enlarged,
            2 * half * enlarged,
            camera.fx_px * enlarged,
            camera.fy_px * enlarged,
            (camera.cx_px - column) * enlarged,
            (camera.cy_px - row) * enlarged,
        )
        image = self.renderer.render(View(window, T_cam_body, T_cam_body.rotation.T @ self.sun_dir_cam))
        if not image.any():
            return None
        image = cv2.resize(np.asarray(image, dtype=np.float64), (2 * half, 2 * half), interpolation=cv2.INTER_AREA)
        if self.blur_px > 0.0:
            image = cv2.GaussianBlur(image, (0, 0), self.blur_px)
        return Patch(np.asarray(image, dtype=np.float64), column, row)

"""Preliminary matching after Cheng et al. (2003): pairs of images that may show the same craters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from boresight.estimators.craters.contract import CraterImage, GroundModel
from boresight.estimators.craters.matching.transfer import LocatedCraters, locate_craters
from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.geometry import Camera, Pose
from boresight.scenarios.spec.base import SpecModel, length

_BLOCK_SIZE = 64  # landmarks compared with all others at once, to bound the memory


class PreliminaryOptions(SpecModel):
    """Conditions on landmarks that may be the same, and on pairs of images worth matching."""

    gate_sigma: float = Field(3.5, gt=0.0, description="Largest distance of two landmarks, in sigmas")
    height_sigma_m: float = length(
        30.0, "Standard deviation of the a priori shape's height under a crater", body=0.0009, gt=0.0
    )
    size_ratio: float = Field(1.5, gt=1.0, description="Largest ratio of the radii of two landmarks, or its inverse")
    landmarks: int = Field(1, ge=1, description="Landmarks of an image pair that may be the same, at the least")
    overlap: float = Field(0.1, ge=0.0, le=1.0, description="Share of a lit region that the other image shows lit")
    footprint: int = Field(8, ge=2, description="Points on a side of the grid of lines of sight of an image")


@dataclass(frozen=True, slots=True, eq=False)
class ImagePairs:
    """Pairs (k, 2) of images that are likely to share craters, by their places in the sequence of images, ascending.

    ``landmarks`` (k,) is how many landmarks may be the same, and ``overlap`` (k,) the share of the sunlit points of one
    image that are in the frame of the other; the larger of both.
    """

    pairs: IndexArray
    landmarks: IndexArray
    overlap: FloatArray


def preliminary_pairs(
    images: Sequence[CraterImage], ground: GroundModel, options: PreliminaryOptions | None = None
) -> ImagePairs:
    """Find the pairs of images whose landmarks may be the same and whose lit regions overlap."""
    options = options or PreliminaryOptions()
    if not images:
        return ImagePairs(np.zeros((0, 2), dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0))
    # All landmarks of all images: the image, position with covariance, effect of the errors that all images share (see
    # `CraterImage.common`), and logarithm of the radius in metres.
    parts = []
    for number, image in enumerate(images):
        located = locate_craters(image, ground)
        known = located.on_body
        covariance = landmark_covariances(image, located, options.height_sigma_m)
        here, log_radii = np.full(int(known.sum()), number), np.log(located.radii_m(image)[known])
        moved = located.by_pose()[known] @ image.common
        parts.append((here, located.points_body_m[known], covariance[known], moved, log_radii))
    image_of, points, covariances, moved, radii = (np.concatenate(column) for column in zip(*parts, strict=True))
    couples = couples_at_same_place(points, covariances, options.gate_sigma, moved)
    ratio = np.abs(np.diff(radii[couples], axis=1)[:, 0])
    between = image_of[couples]
    # Sorted, so that (i, j) and (j, i) count as one pair of images.
    between = np.sort(between[(ratio < np.log(options.size_ratio)) & (between[:, 0] != between[:, 1])], axis=1)
    # How often each pair of images occurs is the number of landmarks that may be the same.
    pairs, counts = np.unique(between.reshape(-1, 2), axis=0, return_counts=True)
    lit = []
    for image in images:
        pose = image.frame.prior_T_cam_body
        sun_dir_body = pose.rotation.T @ image.frame.sun_dir_cam
        lit.append(lit_points(image.camera, pose, sun_dir_body, ground, options.footprint)[0])
    shares = np.array([max(_share_in_frame(images[j], lit[i]), _share_in_frame(images[i], lit[j])) for i, j in pairs])
    kept = (counts >= options.landmarks) & (shares >= options.overlap)
    return ImagePairs(pairs[kept], counts[kept], shares[kept])


def couples_at_same_place(
    points_m: FloatArray, covariances_m2: FloatArray, gate_sigma: float, by_common: FloatArray | None = None
) -> IndexArray:
    """List pairs (k, 2) of landmarks (n, 3) whose positions agree within their uncertainty (n, 3, 3).

    ``by_common`` (n, 3, s), m, is the effect of s errors of unit variance that all positions share: a part of their
    uncertainty, of which only the difference between two positions separates them.
    """
    n = len(points_m)
    shared = np.zeros((n, 3, 0)) if by_common is None else by_common
    reach = gate_sigma * np.sqrt(np.trace(covariances_m2, axis1=1, axis2=2))
    found = [np.zeros((0, 2), dtype=np.int64)]
    for start in range(0, n, _BLOCK_SIZE):
        here = np.arange(start, min(start + _BLOCK_SIZE, n))
        apart = np.linalg.norm(points_m[here, None] - points_m[None], axis=2)
        # The distance alone excludes most pairs: few are left for the exact test.
        # It excludes none by mistake: the sigma of a difference in any direction is at most the sum of both sigmas.
        near = (apart < reach[here, None] + reach) & (np.arange(n) > here[:, None])
        rows, others = np.nonzero(near)
        rows = here[rows]
        offset = points_m[rows] - points_m[others]
        # Cov(x1 - x2) = P1 + P2 - P12 - P21, with P12 from the errors that both share.
        cross = shared[rows] @ np.swapaxes(shared[others], 1, 2)
        together = covariances_m2[rows] + covariances_m2[others] - cross - np.swapaxes(cross, 1, 2)
        far = np.einsum("ki,ki->k", offset, np.linalg.solve(together, offset[..., None])[..., 0])
        found.append(np.column_stack([rows, others])[far < gate_sigma**2])
    return np.concatenate(found)


def landmark_covariances(image: CraterImage, located: LocatedCraters, height_sigma_m: float) -> FloatArray:
    """Return (n, 3, 3) m^2 of located craters: from the pose, half a pixel of the centre, and the shape's height."""
    by_pose, by_height = located.by_pose(), located.by_height()
    pixel_m = 0.5 * located.ranges_m * image.camera.pixel_angle_rad
    covariance = by_pose @ image.frame.prior_covariance @ np.swapaxes(by_pose, 1, 2)
    # A higher ground is met earlier: the point moves along the line of sight, the farther the more slanted.
    covariance += height_sigma_m**2 * np.einsum("ni,nj->nij", by_height, by_height)
    return np.asarray(covariance + pixel_m[:, None, None] ** 2 * np.eye(3), dtype=np.float64)


def lit_points(
    camera: Camera, T_cam_body: Pose, sun_dir_body: FloatArray, ground: GroundModel, side: int
) -> tuple[FloatArray, FloatArray]:
    """Return (k, 3) sunlit points of the shape on a grid of lines of sight, and (k, 3) normals there."""
    steps = (np.arange(side) + 0.5) / side
    u, v = np.meshgrid(steps * camera.width_px, steps * camera.height_px)
    rays = T_cam_body.inverse().rotate(camera.unproject(np.column_stack([u.ravel(), v.ravel()])))
    points, normals = ground.intersect(np.broadcast_to(T_cam_body.camera_position_m, rays.shape), rays)
    with np.errstate(invalid="ignore"):
        # Rays that miss the body have NaN normals, for which the comparison is false. Cast shadows are not computed.
        lit = normals @ sun_dir_body > 0.0
    return points[lit], normals[lit]


def _share_in_frame(image: CraterImage, points_body_m: FloatArray) -> float:
    """Return the share of points in the frame of an image; 0 if there are none."""
    if len(points_body_m) == 0:
        return 0.0
    uv_px = image.camera.project(image.frame.prior_T_cam_body.transform(points_body_m))
    return float(image.camera.contains(uv_px).mean())

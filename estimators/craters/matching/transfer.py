"""Craters of one image on the a priori shape, and their prediction in another image, with the errors of the poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boresight.estimators.craters.contract import CraterImage, GroundModel
from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.geometry import Camera, Ellipses, Pose, cross_matrix

_RIM_POINTS = 8
_MIN_ON_BODY = 5


@dataclass(frozen=True, slots=True, eq=False)
class LocatedCraters:
    """Positions of the craters of an image on the shape, from its prior pose.

    ``points_body_m`` (n, 3) are where the line of sight of a rim's centre meets the plane of the rim, NaN off the body,
    and ``normals_body`` (n, 3) the outward unit normals of those planes. ``T_cam_body`` is the prior pose that was
    used.
    """

    points_body_m: FloatArray
    normals_body: FloatArray
    T_cam_body: Pose

    @property
    def on_body(self) -> BoolArray:
        """Return (n,) whether the line of sight met the body."""
        return np.asarray(np.isfinite(self.points_body_m).all(axis=1))

    @property
    def ranges_m(self) -> FloatArray:
        """Return (n,) distances from the camera, NaN off the body."""
        return np.asarray(np.linalg.norm(self.points_body_m - self.T_cam_body.camera_position_m, axis=1))

    def radii_m(self, image: CraterImage) -> FloatArray:
        """Return (n,) radii on the ground of the rims of the ``image`` that was located, NaN off the body."""
        # Foreshortening leaves the longer semi-axis unchanged.
        return image.detections.ellipses.semi_axes_px[:, 0] * image.camera.pixel_angle_rad * self.ranges_m

    def __getitem__(self, rows: IndexArray | BoolArray) -> LocatedCraters:
        return LocatedCraters(self.points_body_m[rows], self.normals_body[rows], self.T_cam_body)

    def by_pose(self) -> FloatArray:
        """Differentiate each point by the error of the pose, (n, 3, 6) m in body axes.

        The error is that of `Pose.perturbed`, [rotation_rad, translation_m]; the line of sight in the camera and the
        plane on the body are fixed. With x = R p + t, the unit line of sight d and the normal m in camera axes,
        R dp = d (m . e) / (m . d) - e where e = w x R p + dt.
        """
        pose = self.T_cam_body
        turned = self.points_body_m @ pose.rotation.T
        seen = turned + pose.translation_m
        sight = seen / np.linalg.norm(seen, axis=1, keepdims=True)
        normal = self.normals_body @ pose.rotation.T
        slant = np.einsum("ni,ni->n", normal, sight)
        error = by_small_motion(turned)
        # The moved point stays on the line of sight and on the plane: R dp = s d - e with m . R dp = 0, s = m . e / m .
        # d.
        along = np.einsum("ni,nij->nj", normal, error) / slant[:, None]
        moved = sight[:, :, None] * along[:, None, :] - error
        return np.asarray(np.einsum("ji,njk->nik", pose.rotation, moved), dtype=np.float64)

    def by_height(self) -> FloatArray:
        """Differentiate each point by the height of the shape, (n, 3): it moves along the line of sight."""
        sight = self.points_body_m - self.T_cam_body.camera_position_m
        sight /= np.linalg.norm(sight, axis=1, keepdims=True)
        # A plane raised by h along its normal meets the line d at h / (n . d): towards the camera, as n . d < 0.
        return np.asarray(sight / np.einsum("ni,ni->n", self.normals_body, sight)[:, None], dtype=np.float64)


def locate_craters(image: CraterImage, ground: GroundModel) -> LocatedCraters:
    """Locate the craters of an image on the a priori shape from its prior pose.

    The plane of a rim is fitted to the points of the shape under the rim, so that single facets of a plate model do not
    determine the normal; for a rim that extends over the limb it is that of its centre.
    """
    ellipses, pose = image.detections.ellipses, image.frame.prior_T_cam_body
    centre_dir = pose.inverse().rotate(image.camera.unproject(ellipses.centre_px))
    points, normals = _intersect(ground, pose, centre_dir)
    rim, _ = _intersect(ground, pose, pose.inverse().rotate(image.camera.unproject(ellipses.points(_RIM_POINTS)[0])))
    # The centre is located on the plane of the rim: where the shape has the crater, the ray meets its floor.
    middles, fitted = _fit_planes(rim, normals)
    known = np.isfinite(middles).all(axis=1)
    slant = np.einsum("ni,ni->n", fitted, centre_dir)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.einsum("ni,ni->n", fitted, middles - pose.camera_position_m) / slant
    known &= slant < -1e-3  # planes seen edge-on have no intersection of any accuracy
    moved = pose.camera_position_m + depth[:, None] * centre_dir
    return LocatedCraters(np.where(known[:, None], moved, points), np.where(known[:, None], fitted, normals), pose)


def occluded(
    points_body_m: FloatArray, seen_from_body_m: FloatArray, ground: GroundModel, slack_m: FloatArray
) -> BoolArray:
    """Return (n,) whether the shape is more than ``slack_m``, (n,), nearer than the points as seen from a place."""
    rays = points_body_m - seen_from_body_m
    ranges = np.linalg.norm(rays, axis=1)
    met, _ = ground.intersect(np.broadcast_to(seen_from_body_m, rays.shape), rays / ranges[:, None])
    # NaN where the ray misses the body: then nothing is in the way, and the comparison is false.
    nearer = ranges - np.linalg.norm(met - seen_from_body_m, axis=1)
    with np.errstate(invalid="ignore"):
        return np.asarray(nearer > slack_m)


def _intersect(ground: GroundModel, pose: Pose, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Intersect lines of sight (..., 3) with the shape: points and normals of the same shape."""
    flat = directions.reshape(-1, 3)
    points, normals = ground.intersect(np.broadcast_to(pose.camera_position_m, flat.shape), flat)
    return points.reshape(directions.shape), normals.reshape(directions.shape)


def _fit_planes(rims: FloatArray, normals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fit planes to the points of rims on the body: centroids and normals, (n, 3), on the side of ``normals``.

    NaN if too little of a rim, (n, k, 3), is on the body. Rims wholly on the body are fitted all at once.
    """
    on_body = np.asarray(np.isfinite(rims).all(axis=2), dtype=np.bool_)
    fitted = (on_body.sum(axis=1) >= _MIN_ON_BODY) & np.isfinite(normals).all(axis=1)
    middles, across = np.full(normals.shape, np.nan), normals.copy()
    whole = fitted & on_body.all(axis=1)
    if whole.any():
        middles[whole], across[whole] = _fit_plane(rims[whole])
    for row in np.flatnonzero(fitted & ~whole):
        middles[row], across[row] = _fit_plane(rims[row, on_body[row]])
    # The singular vector has either sign: it is turned to the side of the shape's normal.
    inwards = np.einsum("ni,ni->n", across, normals) <= 0.0
    return middles, np.where(inwards[:, None] & fitted[:, None], -across, across)


def _fit_plane(rims: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fit planes of least squares to points (..., k, 3): their centroids and normals of either sign."""
    middle = rims.mean(axis=-2)
    # The direction of least variance is the last right singular vector.
    return middle, np.linalg.svd(rims - middle[..., None, :])[2][..., 2, :]


@dataclass(frozen=True, slots=True, eq=False)
class CraterTransfer:
    """Craters of a first image as expected in a second one.

    ``rows`` (p,) are those of the first image's detections that the second image should show, ``homographies``
    (p, 3, 3) equation (5) as a matrix, from pixels of the first to pixels of the second, and ``ellipses`` the p
    predicted rims. ``by_error`` (p, 2, 12) is px by the errors of the prior poses, [rotation_rad, translation_m] of the
    first and the second, and ``by_height`` (p, 2) px per metre of error in the shape's height.
    """

    rows: IndexArray
    homographies: FloatArray
    ellipses: Ellipses
    by_error: FloatArray
    by_height: FloatArray


def transfer_craters(
    first: CraterImage, second: CraterImage, located: LocatedCraters, ground: GroundModel
) -> CraterTransfer:
    """Predict the craters of a first image in a second one from both prior poses and the a priori shape.

    Left out are craters that are off the body, turned away from the second camera, occluded by the shape, or outside
    its frame by more than three standard deviations of the prior.
    """
    pose, camera = second.frame.prior_T_cam_body, second.camera
    rows = np.flatnonzero(located.on_body)
    planes = located[rows]
    towards = pose.camera_position_m - planes.points_body_m
    away = np.einsum("ni,ni->n", planes.normals_body, towards) <= 0.0
    # Two radii of slack: the rim is above the ground on which its crater was located.
    kept = ~away & ~occluded(planes.points_body_m, pose.camera_position_m, ground, 2.0 * located.radii_m(first)[rows])
    rows, planes = rows[kept], planes[kept]
    by_error, by_height = _sensitivity(planes, camera, pose)
    maps = plane_homographies(planes, first.camera, camera, pose)
    ellipses, real = map_ellipses(first.detections.ellipses[rows], maps)
    spread = 3.0 * np.sqrt(np.einsum("nij,jk,nik->ni", by_error, joint_covariance(first, second), by_error))
    inside = np.zeros(len(rows), dtype=np.bool_)
    centre_px, size_px = ellipses.centre_px, np.array([camera.width_px, camera.height_px])
    inside[real] = ((centre_px > -spread[real]) & (centre_px < size_px + spread[real])).all(axis=1)
    return CraterTransfer(rows[inside], maps[inside], ellipses[inside[real]], by_error[inside], by_height[inside])


def joint_covariance(first: CraterImage, second: CraterImage) -> FloatArray:
    """Return the (12, 12) covariance of the errors of both prior poses, correlated by their common errors."""
    # Both poses are linear in the same unit errors c: Cov(B1 c, B2 c) = B1 B2^T.
    between = first.common @ second.common.T
    blocks = [[first.frame.prior_covariance, between], [between.T, second.frame.prior_covariance]]
    return np.asarray(np.block(blocks), dtype=np.float64)


def plane_homographies(located: LocatedCraters, first: Camera, second: Camera, T_second_body: Pose) -> FloatArray:
    """Return (n, 3, 3) homographies of equation (5), from pixels of the first to pixels of the second image.

    For the plane m . x = h in axes of the first camera, K2 (R + t m^T / h) K1^-1.
    """
    rotation = T_second_body.rotation @ located.T_cam_body.rotation.T
    shift = T_second_body.translation_m - rotation @ located.T_cam_body.translation_m
    # On the plane m . x / h = 1, so that x2 = R x + t = (R + t m^T / h) x.
    normal = located.T_cam_body.rotate(located.normals_body)
    height = np.einsum("ni,ni->n", normal, located.T_cam_body.transform(located.points_body_m))
    moved = rotation + shift[:, None] * (normal / height[:, None])[:, None, :]
    return np.asarray(second.matrix @ moved @ np.linalg.inv(first.matrix), dtype=np.float64)  # eq. (5)


def map_ellipses(ellipses: Ellipses, maps: FloatArray) -> tuple[Ellipses, BoolArray]:
    """Map n ellipses by n homographies: those whose images are ellipses, and (n,) which they are."""
    # With x' = T x the conic becomes T^-T C T^-1; equation (9) as printed, T^T C T, is that for x = T x'.
    inverse = np.linalg.inv(maps)
    conics = np.swapaxes(inverse, 1, 2) @ ellipses.conics() @ inverse  # eq. (9) for x' = T x
    return Ellipses.among(conics)


def _sensitivity(located: LocatedCraters, camera: Camera, pose: Pose) -> tuple[FloatArray, FloatArray]:
    """Differentiate the places in an image by the errors of both poses, (n, 2, 12), and by the shape's height, (n, 2).

    Pixels per rad and metre; the errors are [rotation_rad, translation_m] of the first and the second pose.
    """
    turned = located.points_body_m @ pose.rotation.T
    by_point = camera.jacobian(turned + pose.translation_m)
    # An error of the first pose moves the point on the body; one of the second moves its image.
    first = by_point @ pose.rotation @ located.by_pose()
    second = by_point @ by_small_motion(turned)
    by_height = np.einsum("nij,nj->ni", by_point @ pose.rotation, located.by_height())
    return np.concatenate([first, second], axis=2), by_height


def by_small_motion(turned_m: FloatArray) -> FloatArray:
    """Differentiate R p + t by `Pose.perturbed`, (n, 3, 6), [rotation_rad, translation_m], at R p, (n, 3)."""
    # It moves by w x (R p) + d, so that the derivative by w is -[R p]x.
    return np.concatenate([-cross_matrix(turned_m), np.broadcast_to(np.eye(3), (len(turned_m), 3, 3))], axis=2)

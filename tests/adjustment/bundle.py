"""Normal equations of images and landmarks, landmarks eliminated; the covariance of all that is left."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.spatial.transform import Rotation

from adjustment.tracks import Tracks
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import cross_matrix

SIGMA_PX = 0.33
_CAUCHY = 3.0  # scale of the weights, in SIGMA_PX


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Rotations (n, 3, 3) and translations (n, 3), m, of T_cam_body, and landmarks (k, 3), m, in the body."""

    rotations: FloatArray
    translations_m: FloatArray
    landmarks_m: FloatArray

    def moved(self, scale: float, turn: FloatArray, shift_m: FloatArray) -> Block:
        """Return the block with landmarks at ``scale turn x + shift_m`` and the cameras moved with them."""
        rotations = self.rotations @ turn.T
        translations_m = scale * self.translations_m - rotations @ shift_m
        return Block(rotations, translations_m, scale * self.landmarks_m @ turn.T + shift_m)


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A residual (k,) of each landmark to the shape, m, its normals (k, 3), weights, and derivative by the scale."""

    residual_m: FloatArray
    normal: FloatArray
    weight: FloatArray
    by_scale_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """Pseudo-observations of poses: residual (6n,) + pose - design z, weights (6n,), with a prior of z (m,)."""

    residual: FloatArray
    weight: FloatArray
    design: FloatArray
    prior: FloatArray
    prior_offset: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """One step: the new block, the change of the scale and of z, the residuals (m, 2), px, and the covariance.

    The covariance is that of poses (6n), [rotation_rad, translation_m] in camera axes, of the scale, and of z.
    """

    block: Block
    scale: float
    z: FloatArray
    residual_px: FloatArray
    covariance: FloatArray


def residuals(block: Block, tracks: Tracks, focal_px: float, centre_px: float) -> tuple[FloatArray, FloatArray]:
    """Return R x (m, 3) of the observed landmarks, m, and observed minus projected places (m, 2), px."""
    turned = np.einsum("oij,oj->oi", block.rotations[tracks.image], block.landmarks_m[tracks.landmark])
    x = turned + block.translations_m[tracks.image]
    return turned, tracks.uv_px - (focal_px * x[:, :2] / x[:, 2:] + centre_px)


def triangulate(
    tracks: Tracks, rotations: FloatArray, translations_m: FloatArray, focal_px: float, centre_px: float
) -> FloatArray:
    """Return the points (k, 3) nearest to the rays of their observations."""
    rays = np.c_[(tracks.uv_px - centre_px) / focal_px, np.ones(len(tracks.uv_px))]
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    to_body = rotations.transpose(0, 2, 1)[tracks.image]
    rays, origin = (
        np.einsum("oij,oj->oi", to_body, rays),
        -np.einsum("oij,oj->oi", to_body, translations_m[tracks.image]),
    )
    across = np.eye(3) - rays[:, :, None] * rays[:, None]
    left, right = np.zeros((tracks.n, 3, 3)), np.zeros((tracks.n, 3))
    np.add.at(left, tracks.landmark, across)
    np.add.at(right, tracks.landmark, np.einsum("oij,oj->oi", across, origin))
    return np.linalg.solve(left, right[..., None])[..., 0]


def _linearised(
    block: Block, tracks: Tracks, focal_px: float, centre_px: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return residuals (m, 2), and derivatives of the places by poses (m, 2, 6) and landmarks (m, 2, 3)."""
    turned, e = residuals(block, tracks, focal_px, centre_px)
    x = turned + block.translations_m[tracks.image]
    by_x = np.zeros((len(e), 2, 3))
    by_x[:, [0, 1], [0, 1]] = (focal_px / x[:, 2])[:, None]
    by_x[:, :, 2] = -focal_px * x[:, :2] / x[:, 2:] ** 2
    by_pose = np.concatenate([-by_x @ cross_matrix(turned), by_x], axis=2)
    return e, by_pose, by_x @ block.rotations[tracks.image]


def resect(block: Block, tracks: Tracks, image: int, focal_px: float, centre_px: float) -> tuple[Block, FloatArray]:
    """Find the pose of one image from landmarks as they are; its covariance (6, 6) is scaled by the residuals."""
    seen = tracks.image == image
    own = Tracks(tracks.image[seen], tracks.landmark[seen], tracks.uv_px[seen], tracks.n)
    for _ in range(10):
        e, by_pose, _ = _linearised(block, own, focal_px, centre_px)
        w = 1.0 / (1.0 + (e**2).sum(axis=1) / (_CAUCHY * SIGMA_PX) ** 2)
        information = np.einsum("o,oki,okj->ij", w, by_pose, by_pose)
        d = np.linalg.solve(information, np.einsum("o,oki,ok->i", w, by_pose, e))
        rotations, translations_m = block.rotations.copy(), block.translations_m.copy()
        rotations[image] = Rotation.from_rotvec(d[:3]).as_matrix() @ rotations[image]
        translations_m[image] += d[3:]
        block = Block(rotations, translations_m, block.landmarks_m)
    variance_px2 = float(w @ (e**2).sum(axis=1) / (2 * len(e) - 6))
    return block, variance_px2 * np.linalg.inv(information)


def step(
    block: Block, tracks: Tracks, focal_px: float, centre_px: float, model: Model, surface: Surface | None = None
) -> Step:
    """Make one Gauss-Newton step of all poses, landmarks, the scale of the landmarks and the model of the poses.

    Landmarks are eliminated; observations have Cauchy's weights. Without ``surface`` the scale stays as it is.
    """
    n, k, image, landmark = len(block.rotations), tracks.n, tracks.image, tracks.landmark
    e, by_pose, by_landmark = _linearised(block, tracks, focal_px, centre_px)
    w = (1.0 / (1.0 + (e**2).sum(axis=1) / (_CAUCHY * SIGMA_PX) ** 2) / SIGMA_PX**2)[:, None, None]
    poses, points = np.zeros((n, 6, 6)), np.zeros((k, 3, 3))
    pose_side, point_side = np.zeros((n, 6)), np.zeros((k, 3))
    np.add.at(poses, image, w * by_pose.transpose(0, 2, 1) @ by_pose)
    np.add.at(points, landmark, w * by_landmark.transpose(0, 2, 1) @ by_landmark)
    np.add.at(pose_side, image, w[:, 0] * np.einsum("oki,ok->oi", by_pose, e))
    np.add.at(point_side, landmark, w[:, 0] * np.einsum("oki,ok->oi", by_landmark, e))
    scale_row, scale_self, scale_side = np.zeros((k, 3)), 1.0, 0.0
    if surface is not None:
        pull = surface.weight[:, None] * surface.normal
        points += pull[:, :, None] * surface.normal[:, None]
        point_side -= pull * surface.residual_m[:, None]
        scale_row = pull * surface.by_scale_m[:, None]
        scale_self = float(surface.weight @ surface.by_scale_m**2)
        scale_side = -float(surface.weight @ (surface.by_scale_m * surface.residual_m))
    # The normal equations of poses and scale, without the landmarks.
    rows = np.broadcast_to(6 * image[:, None, None] + np.arange(6)[:, None], (len(e), 6, 3))
    columns = np.broadcast_to(3 * landmark[:, None, None] + np.arange(3), (len(e), 6, 3))
    mixed = sparse.csr_matrix(
        ((w * by_pose.transpose(0, 2, 1) @ by_landmark).ravel(), (rows.ravel(), columns.ravel())), (6 * n, 3 * k)
    )
    mixed = sparse.vstack([mixed, sparse.csr_matrix(scale_row.reshape(1, -1))]).tocsr()
    inverse = sparse.bsr_matrix((np.linalg.inv(points), np.arange(k), np.arange(k + 1))).tocsr()
    carried = mixed @ inverse
    s = sparse.block_diag([*poses, np.array([[scale_self]])]).toarray() - (carried @ mixed.T).toarray()
    side = np.append(pose_side.ravel(), scale_side) - carried @ point_side.ravel()
    # The model ties the poses: weight (residual + d_pose - design d_z)^2.
    m, p = model.design.shape[1], 6 * n
    full = np.zeros((p + 1 + m, p + 1 + m))
    full[: p + 1, : p + 1] = s
    full[:p, :p] += np.diag(model.weight)
    full[:p, p + 1 :] = -model.weight[:, None] * model.design
    full[p + 1 :, :p] = full[:p, p + 1 :].T
    full[p + 1 :, p + 1 :] = model.design.T @ (model.weight[:, None] * model.design) + np.diag(model.prior)
    right = np.append(side, model.design.T @ (model.weight * model.residual) - model.prior * model.prior_offset)
    right[:p] -= model.weight * model.residual
    covariance = np.linalg.inv(full)
    d = covariance @ right
    d_points = inverse @ (point_side.ravel() - mixed.T @ d[: p + 1])
    d_pose = d[:p].reshape(n, 6)
    new = Block(
        Rotation.from_rotvec(d_pose[:, :3]).as_matrix() @ block.rotations,
        block.translations_m + d_pose[:, 3:],
        block.landmarks_m + d_points.reshape(k, 3),
    )
    return Step(new, float(d[p]), d[p + 1 :], e, covariance)


def free(
    rotations: FloatArray, translations_m: FloatArray, sigma_deg: float, sigma_m: float
) -> Callable[[Block], Model]:
    """Return a model that holds poses weakly where they started: it fixes the seven free numbers alone."""
    n = len(rotations)

    def model(block: Block) -> Model:
        turn = Rotation.from_matrix(block.rotations @ rotations.transpose(0, 2, 1)).as_rotvec()
        residual = np.concatenate([turn, block.translations_m - translations_m], axis=1)
        weight = np.tile(np.repeat([np.radians(sigma_deg) ** -2, sigma_m**-2], 3), n)
        return Model(residual.ravel(), weight, np.zeros((6 * n, 0)), np.zeros(0), np.zeros(0))

    return model

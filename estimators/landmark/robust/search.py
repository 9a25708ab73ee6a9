"""The best of all poses that the prior admits."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from estimators.landmark.robust.mixture import Mixture, Poses
from estimators.landmark.robust.options import SearchOptions
from scenarios.geometry import Camera, Pose

FloatArray = NDArray[np.float64]


def rotation_grid(radius_rad: float, step_rad: float, most: int) -> FloatArray:
    """Rotation vectors (H, 3) on a cubic grid in a ball; the step grows until there are at most ``most``."""
    while True:
        count = int(np.floor(radius_rad / step_rad))
        axis = step_rad * np.arange(-count, count + 1)
        grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
        ball: FloatArray = grid[np.linalg.norm(grid, axis=1) <= radius_rad]
        if len(ball) <= most:
            return ball
        step_rad *= 1.1


def corner_map(corners_px: FloatArray, camera: Camera, blur_px: float) -> NDArray[np.float32]:
    """Density of corners an image, (H, W) px^-2, blurred."""
    counts = np.zeros((camera.height_px, camera.width_px), dtype=np.float32)
    column, row = np.clip(np.floor(corners_px), 0, [camera.width_px - 1, camera.height_px - 1]).astype(int).T
    np.add.at(counts, (row, column), 1.0)
    return np.asarray(cv2.GaussianBlur(counts, (0, 0), blur_px), dtype=np.float32)


def best_hypotheses(
    mixture: Mixture, start: Pose, turn_sigma_rad: float, corners_px: FloatArray, camera: Camera, options: SearchOptions
) -> Poses:
    """Score turns and shifts of the start on a blurred map of the corners, and return the best.

    The score of a hypothesis is the log likelihood of `Mixture` with isotropic covariances of the map's blur, taken at
    the pixel of each landmark, and the log prior of its turn.
    """
    size_m = float(np.median(np.linalg.norm(mixture.points_m, axis=1)))
    pixel_m = float(np.linalg.norm(start.translation_m)) * camera.pixel_angle_rad
    turns = rotation_grid(options.reach_sigma * turn_sigma_rad, options.step_px * pixel_m / size_m, options.max_turns)
    rotations = Rotation.from_rotvec(turns).as_matrix() @ start.rotation
    poses = Poses(rotations, np.repeat(start.translation_m[None], len(turns), axis=0))
    shifts = np.arange(-options.shift_px, options.shift_px + 1)
    du, dv = (grid.ravel() for grid in np.meshgrid(shifts, shifts))
    prior = -0.5 * np.square(turns).sum(axis=1) / turn_sigma_rad**2
    scores = map_scores(mixture, poses, corners_px, camera, options.blur_px, du, dv) + prior[:, None]
    best = np.argsort(-scores.ravel(), kind="stable")[: options.refined]
    turn, shift = np.divmod(best, len(du))
    across_m = np.stack([du[shift], dv[shift], np.zeros(len(best))], axis=1) * pixel_m
    return Poses(rotations[turn], start.translation_m + across_m)


def map_scores(
    mixture: Mixture,
    poses: Poses,
    corners_px: FloatArray,
    camera: Camera,
    blur_px: float,
    du: NDArray[np.int_],
    dv: NDArray[np.int_],
) -> FloatArray:
    """Log likelihoods (H, S) of poses, shifted by whole pixels, on a blurred map of the corners."""
    log_density = np.log1p(mixture.odds_px2 * corner_map(corners_px, camera, blur_px))
    return _scores(log_density, mixture.project(poses), du, dv)


def _scores(
    log_density: NDArray[np.float32], uv_px: FloatArray, du: NDArray[np.int_], dv: NDArray[np.int_]
) -> FloatArray:
    """Sum the map over the landmarks, (H, S), for each shift; landmarks out of the image add nothing."""
    reach = int(np.abs(np.concatenate([du, dv])).max())
    padded = np.pad(log_density, reach + 1)
    height, width = log_density.shape
    column = np.clip(np.floor(uv_px[..., 0]), -1, width).astype(np.intp) + reach + 1
    row = np.clip(np.floor(uv_px[..., 1]), -1, height).astype(np.intp) + reach + 1
    flat = row * padded.shape[1] + column
    steps = dv * padded.shape[1] + du
    edge = padded.ravel()
    return np.stack(
        [edge[np.clip(flat + step, 0, edge.size - 1)].sum(axis=1) for step in steps], axis=1, dtype=np.float64
    )


def refine_hypotheses(mixture: Mixture, hypotheses: Poses, corner_sigma_px: float, options: SearchOptions) -> Pose:
    """Climb from each hypothesis while the corner error shrinks, and return the pose of the greatest posterior."""
    poses = hypotheses
    for sigma_px in options.anneal_px:
        poses = mixture.climb(poses, sigma_px, options.iterations)
    order = np.argsort(-mixture.step(poses, options.anneal_px[-1]).log_posterior, kind="stable")
    last = mixture.climb(poses.take(order[: options.finalists]), corner_sigma_px, options.max_iterations, 1e-3)
    return last.pose(int(np.argmax(mixture.step(last, corner_sigma_px).log_posterior)))

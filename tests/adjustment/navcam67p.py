"""Adjust the 60 NAVCAM images of 67P jointly, and write their poses with covariances beside the scenarios.

Run as ``python -m adjustment.navcam67p`` with the data set navcam-67p and the shape 67p-16k.obj in the data folder.
``--rendered RUN NAME`` adjusts the renderings of scenario NAME in the folder of a run with ``--keep-images`` instead,
and prints the errors of the adjustment: there, the truth is known.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from adjustment.bundle import Block, Model, Step, free, resect, residuals, step, triangulate
from adjustment.surface import Shape
from adjustment.tracks import Tracks, find_tracks
from boresight.renderers.images import PosedImageSet
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.bodies import load_body
from boresight.scenarios.geometry import Pose
from boresight.scenarios.load import load_scenario

NAME = "joint"
TABLE = Path(__file__).resolve().parents[2] / "scenarios" / "catalog" / "navcam_67p_joint.csv"
PAIRS = [(i, j) for i in range(6) for j in range(i, 6)]

# Chosen on renderings (relief of seed 67), before the poses were compared with those of any estimator.
CUTS_PX = (3.0, 2.0, 1.5)
SHAPE_SIGMA_M = 70.0  # 10 m of each landmark; errors of neighbours are alike, so that about 1 in 50 counts
ATTITUDE_DEG = 0.03  # of an image about the rotation of the label, turned and with a linear drift
DRIFT_DEG = 0.3
RANGE_M = 30.0  # of an image about the label's, scaled
SCALE = 0.0025  # of the shape, next to the ranges of the label
LIGHT_PX = 0.25  # all features may be displaced alike across the line of sight, as light falls from one side


@dataclass(frozen=True, slots=True, eq=False)
class Label:
    """Rotations (n, 3, 3) and translations (n, 3), m, T_cam_body of the mission, and the epochs, -1 to 1."""

    rotations: FloatArray
    translations_m: FloatArray
    epochs: FloatArray
    focal_px: float
    centre_px: float


@dataclass(frozen=True, slots=True, eq=False)
class Adjusted:
    """A block, the scale of its landmarks, the covariance (n, 6, 6) of poses, drift (3,), deg, and scale of ranges."""

    block: Block
    scale: float
    covariance: FloatArray
    drift_deg: FloatArray
    range_scale: float


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def without_outliers(tracks: Tracks, label: Label) -> tuple[Tracks, Block]:
    """Adjust poses that are free but for the gauge, and leave out observations by their residuals, in three cuts."""
    points = triangulate(tracks, label.rotations, label.translations_m, label.focal_px, label.centre_px)
    block = Block(label.rotations, label.translations_m, points)
    gauge = free(label.rotations, label.translations_m, 5.0, 3000.0)
    for cut in (*CUTS_PX, None):
        for _ in range(20):
            block = step(block, tracks, label.focal_px, label.centre_px, gauge(block)).block
        if cut is not None:
            _, e = residuals(block, tracks, label.focal_px, label.centre_px)
            near = np.linalg.norm(block.landmarks_m, axis=1) < 4000.0
            tracks, rows = tracks.keep((np.linalg.norm(e, axis=1) < cut) & near[tracks.landmark])
            block = replace(block, landmarks_m=block.landmarks_m[rows])
    return tracks, block


def adjust(tracks: Tracks, block: Block, label: Label, shape: Shape, left_out: int | None = None) -> Adjusted:
    """Adjust poses, landmarks, the place of the shape, and the rotation and the scale of the label together.

    An attitude is that of the label, turned by the same rotation in the body for all images and by one that grows
    linearly in time, camera axes. A range is that of the label times a scale. Positions across the line of sight are
    free. Landmarks may be farther out than the shape, all by the same factor: features move with the light.
    ``left_out`` is an image that the model does not tie.
    """
    n = len(label.rotations)
    turn = Rotation.from_matrix(label.rotations.transpose(0, 2, 1) @ block.rotations).mean().as_matrix()
    drift, range_scale, scale = np.zeros(3), 0.0, 0.005
    for _ in range(30):
        moved = Rotation.from_rotvec(label.epochs[:, None] * drift).as_matrix() @ label.rotations @ turn
        residual, weight, design = np.zeros((n, 6)), np.zeros((n, 6)), np.zeros((n, 6, 7))
        residual[:, :3] = Rotation.from_matrix(block.rotations @ moved.transpose(0, 2, 1)).as_rotvec()
        residual[:, 5] = block.translations_m[:, 2] - (1.0 + range_scale) * label.translations_m[:, 2]
        weight[:, :3], weight[:, 5] = np.radians(ATTITUDE_DEG) ** -2, RANGE_M**-2
        if left_out is not None:
            weight[left_out] = np.repeat([1.0, 1e-6], 3)  # so little that it ties nothing, but the matrix is regular
        design[:, :3, :3] = block.rotations
        design[:, :3, 3:6] = label.epochs[:, None, None] * np.eye(3)
        design[:, 5, 6] = label.translations_m[:, 2]
        model = Model(
            residual.ravel(),
            weight.ravel(),
            design.reshape(6 * n, 7),
            np.array([0.0] * 3 + [np.radians(DRIFT_DEG) ** -2] * 3 + [SCALE**-2]),
            np.array([0.0, 0.0, 0.0, *drift, range_scale]),
        )
        surface = shape.surface(block.landmarks_m, scale, SHAPE_SIGMA_M)
        done = step(block, tracks, label.focal_px, label.centre_px, model, surface)
        block, scale = done.block, scale + done.scale
        turn = turn @ Rotation.from_rotvec(done.z[:3]).as_matrix()
        drift, range_scale = drift + done.z[3:6], range_scale + float(done.z[6])
        if np.abs(done.z[:3]).max() < 2e-5 and abs(done.scale) < 2e-5:
            break
    return Adjusted(block, scale, _covariance(done, block, label.focal_px), np.degrees(drift), range_scale)


def _covariance(done: Step, block: Block, focal_px: float) -> FloatArray:
    """Return the covariance (n, 6, 6) of poses, with that of features that the light displaces."""
    n = len(block.rotations)
    found = np.stack([done.covariance[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] for i in range(n)])
    across_m = LIGHT_PX / focal_px * block.translations_m[:, 2]
    found[:, 3, 3] += across_m**2
    found[:, 4, 4] += across_m**2
    return found


def print_errors(found: Adjusted, true: Iterable[Pose], focal_px: float) -> None:
    """Print the errors of an adjustment of renderings: means over the images and standard deviations about them."""
    poses = list(true)
    rotations, translations_m = np.stack([p.rotation for p in poses]), np.stack([p.translation_m for p in poses])
    turn = Rotation.from_matrix(found.block.rotations @ rotations.transpose(0, 2, 1)).as_rotvec()
    off_m = found.block.translations_m - translations_m
    error = np.concatenate([turn, off_m], axis=1)
    rows = {
        "attitude in the body, deg": np.degrees(np.einsum("nji,nj->ni", rotations, turn)),
        "across the line of sight, px": off_m[:, :2] / translations_m[:, 2:] * focal_px,
        "range, m": off_m[:, 2:],
    }
    for what, values in rows.items():
        _say(f"{what}: mean {values.mean(axis=0).round(3)}, sd {values.std(axis=0).round(3)}")
    nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.covariance), error)
    _say(f"NEES/6 {nees.mean() / 6.0:.3f}")


def print_left_out(tracks: Tracks, found: Adjusted, label: Label, shape: Shape, every: int) -> None:
    """Print the poses of images from the landmarks of the others, next to those of the joint adjustment.

    Neither the image nor the label of its pose takes part in the adjustment of the others.
    """
    off = []
    for image in range(0, len(label.rotations), every):
        others, rows = tracks.keep(tracks.image != image)
        start = replace(found.block, landmarks_m=found.block.landmarks_m[rows])
        alone = adjust(others, start, label, shape, left_out=image).block
        known = np.full(tracks.n, -1)
        known[rows] = np.arange(len(rows))
        own = Tracks(tracks.image, known[tracks.landmark], tracks.uv_px, others.n)
        own = replace(own, image=np.where(own.landmark >= 0, own.image, -1))
        pose, covariance = resect(alone, own, image, label.focal_px, label.centre_px)
        turn = Rotation.from_matrix(pose.rotations[image] @ found.block.rotations[image].T).as_rotvec()
        move = pose.translations_m[image] - found.block.translations_m[image]
        px = move[:2] / label.translations_m[image, 2] * label.focal_px
        error = np.concatenate([turn, move])
        off.append([*np.degrees(turn), *px, move[2], error @ np.linalg.solve(covariance, error) / 6.0])
    off_all = np.array(off)
    rms, ratio = np.sqrt((off_all[:, :6] ** 2).mean(axis=0)).round(3), off_all[:, 6]
    _say(f"left out, n = {len(off_all)}: RMS {rms} deg, px, m; squared over covariance / 6: mean {ratio.mean():.2f}")


def write_table(path: Path, images: PosedImageSet, found: Adjusted) -> None:
    """Write the poses, the Sun in the axes of the shape, and the upper triangles of the covariances."""
    heading = ["file", "time_s", *(f"{NAME}_q{a}" for a in "wxyz"), *(f"{NAME}_t{a}_m" for a in "xyz")]
    heading += [*(f"sun_body_{a}" for a in "xyz"), *(f"{NAME}_cov_{i}{j}" for i, j in PAIRS)]
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(heading)
        for k, name in enumerate(images.names):
            view = images.view(k, "label")
            pose = Pose(found.block.rotations[k], found.block.translations_m[k])
            sun = pose.rotation.T @ view.T_cam_body.rotate(view.sun_dir_body)
            numbers = [*pose.quat_wxyz, *pose.translation_m, *sun, *(found.covariance[k][i, j] for i, j in PAIRS)]
            writer.writerow([name, f"{images.time_s(k):.0f}", *(f"{number:.9g}" for number in numbers)])


def read_images(images: PosedImageSet, rendered: list[str] | None) -> tuple[list[NDArray[np.uint8]], list[Pose] | None]:
    """Read the images of the set, or renderings of their views with the true poses."""
    if rendered is None:
        return [images.image(k).astype(np.uint8) for k in range(len(images))], None
    run, name = Path(rendered[0]), rendered[1]
    rows = pd.concat([pd.read_parquet(file) for file in sorted((run / "rows").glob(f"{name}-*.parquet"))])
    rows = rows.drop_duplicates("image").set_index("image").loc[list(images.names)]
    pictures, poses = [], []
    for row in rows.to_dict("records"):
        picture = cv2.imread(str(run / "images" / name / f"{row['trial']:07d}.tiff"), cv2.IMREAD_UNCHANGED)
        pictures.append(np.clip(picture, 0, 255).astype(np.uint8))
        quat_wxyz = np.array([row[f"true_q{a}"] for a in "wxyz"])
        poses.append(Pose.from_quat_wxyz(quat_wxyz, np.array([row[f"true_t{a}_m"] for a in "xyz"])))
    return pictures, poses


def main(arguments: list[str]) -> None:
    """Adjust the images, print what was found, and write the table unless the images are renderings."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rendered", nargs=2, metavar=("RUN", "NAME"))
    parser.add_argument("--left-out", type=int, default=0, metavar="N", help="leave out every N-th image in turn")
    parser.add_argument("--out", type=Path, default=TABLE)
    chosen = parser.parse_args(arguments)
    scenario = load_scenario("navcam67p-real")
    spec, camera = scenario.spec.images, scenario.spec.camera.camera()
    images = PosedImageSet.open(spec, camera, scenario.search_dirs)
    pictures, true = read_images(images, chosen.rendered)
    poses = [images.view(k, "label").T_cam_body for k in range(len(images))]
    times_s = np.array([images.time_s(k) for k in range(len(images))])
    label = Label(
        np.stack([pose.rotation for pose in poses]),
        np.stack([pose.translation_m for pose in poses]),
        2.0 * (times_s - times_s.min()) / np.ptp(times_s) - 1.0,
        camera.fx_px,
        camera.cx_px,
    )
    tracks, block = without_outliers(find_tracks(pictures, poses, camera.fx_px), label)
    shape = Shape.of(load_body(scenario.spec.body, scenario.search_dirs).mesh)
    found = adjust(tracks, shape.placed(block), label, shape)
    _, e = residuals(found.block, tracks, label.focal_px, label.centre_px)
    seen = np.bincount(tracks.image)
    _say(f"{tracks.n} landmarks, {len(e)} observations, {seen.min()} to {seen.max()} an image, RMS {e.std(axis=0)} px")
    _say(f"drift {found.drift_deg} deg, landmarks {found.scale:.4f} outside, ranges {found.range_scale:.5f}")
    sigma = np.sqrt(np.median(np.diagonal(found.covariance, axis1=1, axis2=2), axis=0))
    _say(f"sigma {np.degrees(sigma[:3]).round(3)} deg, {sigma[3:].round(2)} m")
    if chosen.left_out:
        print_left_out(tracks, found, label, shape, chosen.left_out)
    if true is not None:
        print_errors(found, true, camera.fx_px)
    else:
        write_table(chosen.out, images, found)


if __name__ == "__main__":
    main(sys.argv[1:])

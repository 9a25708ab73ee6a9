"""Matching of all pairs of images, kept in blocks so that it goes on where it was interrupted."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimators.craters.contract import CraterImage, CraterMatcher, CraterMatches, Ground
from estimators.craters.database.files import read_matches, write_matches
from estimators.craters.database.numbering import PairMatches
from estimators.craters.navigation.stages import Stages
from estimators.craters.navigation.task import Exposure, NavigationTask
from estimators.craters.navigation.trajectory import Trajectory
from scenarios.geometry import Pose, cross_matrix
from scenarios.observation import Frame

MATCHING = "matching"
_BLOCK = 50

FloatArray = NDArray[np.float64]


def placed_images(exposures: Sequence[Exposure], trajectory: Trajectory, task: NavigationTask) -> list[CraterImage]:
    """Give each image the pose of its time; the trajectory has one place for each, in their order."""
    turns, known = task.knowledge.field.rotation.at(trajectory.times_s), task.knowledge
    images = []
    for i, (exposure, turn, position) in enumerate(zip(exposures, turns, trajectory.positions_m, strict=True)):
        attitude = exposure.R_cam_inertial
        rotation = attitude @ turn.T
        pose = Pose(rotation, -rotation @ (turn @ position + task.shape.centre_of_mass_m))
        by_turn, by_place = _by_turn(pose), np.vstack([np.zeros((3, 3)), -attitude])
        covariance = (known.attitude_sigma_rad**2 + known.misalignment_sigma_rad**2) * by_turn @ by_turn.T
        covariance += by_place @ trajectory.covariances_m2[i] @ by_place.T
        common = np.hstack([known.misalignment_sigma_rad * by_turn, by_place @ trajectory.by_common_m[i]])
        frame = Frame(exposure.pixels, exposure.sun_dir_cam, pose, covariance, exposure.time_s)
        images.append(CraterImage(exposure.number, frame, known.camera, exposure.detections, common))
    return images


def _by_turn(pose: Pose) -> FloatArray:
    """(6, 3) `Pose.perturbed`'s error by a turn w of the camera about itself: x = R p + t, so that t moves by w x t."""
    return np.vstack([np.eye(3), -cross_matrix(pose.translation_m)])


def match_pairs(
    images: Sequence[CraterImage], pairs: NDArray[np.int64], matcher: CraterMatcher, ground: Ground, stages: Stages
) -> tuple[PairMatches, ...]:
    """Match the pairs (k, 2) of images, by their places in the sequence."""
    found: list[PairMatches] = []
    for start in range(0, len(pairs), _BLOCK):
        block = pairs[start : start + _BLOCK]

        def match(path: Path, block: NDArray[np.int64] = block) -> None:
            ones = [PairMatches(i, j, matcher.match(images[i], images[j], ground)) for i, j in block.tolist()]
            write_matches(path, ones)

        found += stages.kept(f"pairs-{start // _BLOCK:05d}.txt", MATCHING, match, read_matches)
    return tuple(found)


def believed(found: Sequence[PairMatches], agreeing: int) -> tuple[PairMatches, ...]:
    """Reject the pairs of images with fewer matches than ``agreeing``."""
    return tuple(
        replace(pair, matches=CraterMatches.none(f"{count} matches are fewer than the {agreeing} that have to agree"))
        if 0 < (count := len(pair.matches.pairs)) < agreeing
        else pair
        for pair in found
    )


def matching_key(images: Sequence[CraterImage], *what: object) -> str:
    """Hash poses, uncertainties and craters of images, and the repr of whatever else decides their matches."""
    digest = hashlib.sha256(repr(what).encode())
    for image in images:
        pose, rims = image.frame.prior_T_cam_body, image.detections.ellipses
        placed = (pose.rotation, pose.translation_m, image.frame.prior_covariance, image.common)
        for part in (*placed, rims.centre_px, rims.semi_axes_px, rims.angle_rad):
            digest.update(np.ascontiguousarray(part).tobytes())
    return digest.hexdigest()[:16]

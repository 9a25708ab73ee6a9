"""Matching of all pairs of images, kept in blocks so that it goes on where it was interrupted."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimators.craters.contract import CraterImage, CraterMatcher, CraterMatches, Ground
from estimators.craters.database.match_files import read_matches, write_matches
from estimators.craters.database.numbering import PairMatches
from estimators.craters.navigation.stages import Stages

MATCHING = "matching"
_BLOCK = 50


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

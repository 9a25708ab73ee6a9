"""Scores of crater detections: matches, duplicates, false alarms, and errors of ellipses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boresight.campaign.trial.checks import check_array, check_type
from boresight.estimators.craters.contract import CraterDetections
from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.craters.simulated import NO_CRATER
from boresight.scenarios.craters.truth import LEAST_DIAMETER_PX, CraterTruth
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Ellipses
from boresight.scenarios.load import LoadedScenario

CENTRE_RADII, CENTRE_PX = 0.3, 1.5
"""A match's centre lies within the larger of these."""

LOG_RADIUS = 0.36
"""A match's radius differs by less than this in its logarithm."""

_MOST_PX = 1e6
_MOST_UNLISTED = 0.5  # share of the craters of detectable size

NONE = -1


def check_listed(scenario: LoadedScenario) -> None:
    """Refuse a truth that leaves most detectable craters out: when found, they would count as false alarms.

    Raise BoresightError if more than half of the craters that are large enough at the range of the views are not
    listed.
    """
    craters, m_per_px = scenario.spec.craters, scenario.spec.m_per_px
    if craters is None or m_per_px is None:
        return
    least_m = LEAST_DIAMETER_PX * m_per_px
    unlisted = craters.unlisted_share(least_m)
    if unlisted > _MOST_UNLISTED:
        raise BoresightError(
            f"{scenario.path}: craters.known_diameter_m: {craters.listed_from_m:g} m is"
            f" {craters.listed_from_m / m_per_px:.3g} px at the range of the views, and {100.0 * unlisted:.0f} % of the"
            f" craters of {LEAST_DIAMETER_PX:g} px or more would not be listed in the truth: leave the key out, or give"
            f" at most {least_m:.3g}"
        )


@dataclass(frozen=True, slots=True, eq=False)
class DetectionMatches:
    """Classification of each of m detections.

    ``crater`` (m,) is the row of the true crater that it stands for, -1 for a false alarm. ``duplicate`` (m,) marks
    false alarms that fit a crater which a more confident detection stands for.
    """

    crater: IndexArray
    duplicate: BoolArray


def match_detections(found: Ellipses, true: Ellipses) -> DetectionMatches:
    """Match detections, the most confident first, with all craters of an image, one to one.

    A detection takes the nearest crater that is left of those that it fits: the centres within max(0.3 r, 1.5 px), r
    the crater's radius, and the logarithm of the ratio of the radii within 0.36 of 0. As the more confident choose
    first, what a detection is does not depend on where a threshold is put below it.
    """
    crater = np.full(len(found), NONE, dtype=np.int64)
    duplicate = np.zeros(len(found), dtype=bool)
    if len(true) == 0:
        return DetectionMatches(crater, duplicate)
    apart = np.linalg.norm(found.centre_px[:, None] - true.centre_px, axis=2)
    limit = np.maximum(CENTRE_RADII * true.radius_px, CENTRE_PX)
    ratio = np.abs(np.log(found.radius_px[:, None] / true.radius_px))
    cost = np.where((apart <= limit) & (ratio < LOG_RADIUS), (apart / limit) ** 2 + (ratio / LOG_RADIUS) ** 2, np.inf)
    for row in range(len(found)):
        nearest = int(np.argmin(cost[row]))
        if np.isfinite(cost[row, nearest]):
            crater[row] = nearest
            # Those that come later fit it as well, but only as duplicates.
            duplicate[row + 1 :] |= np.isfinite(cost[row + 1 :, nearest])
            cost[row + 1 :, nearest] = np.inf
    return DetectionMatches(crater, duplicate & (crater == NONE))


def identified(found: Ellipses, truth: CraterTruth) -> IndexArray:
    """Return the numbers (m,) of the true craters that detections stand for; ``NO_CRATER`` for a false alarm."""
    # The last of the numbers is that of no crater, which is row -1 as well.
    numbers = np.append(truth.crater, NO_CRATER).astype(np.int64)
    return np.asarray(numbers[match_detections(found, truth.ellipses).crater])


def ellipse_errors(found: Ellipses, true: Ellipses) -> dict[str, FloatArray]:
    """Errors (k,), px, of k ellipses against k true ones: centre, its coordinates, and the two semi-axes."""
    offset = found.centre_px - true.centre_px
    axes = found.semi_axes_px - true.semi_axes_px
    return {
        "centre_error_px": np.linalg.norm(offset, axis=1),
        "centre_error_u_px": offset[:, 0],
        "centre_error_v_px": offset[:, 1],
        "major_error_px": axes[:, 0],
        "minor_error_px": axes[:, 1],
    }


def check_detections(found: CraterDetections) -> None:
    """Refuse detections that do not keep the contract.

    Raise `ValueError` if it is none, lengths differ, a number is not finite or of an impossible size, axes are not
    positive with the longer first, or the confidence ascends.
    """
    check_type(found, CraterDetections)
    check_type(found.ellipses, Ellipses)
    ellipses, confidence = found.ellipses, np.asarray(found.confidence)
    n = len(ellipses)
    check_array("the centres of detections", ellipses.centre_px, (n, 2), _MOST_PX)
    check_array("the axes of detections", ellipses.semi_axes_px, (n, 2), _MOST_PX)
    check_array("the angles of detections", ellipses.angle_rad, (n,))
    check_array("the confidence of detections", confidence, (n,))
    if np.any(ellipses.semi_axes_px[:, 1] <= 0.0) or np.any(np.diff(ellipses.semi_axes_px, axis=1) > 0.0):
        raise ValueError("semi-axes of detections must be positive, the longer one first")
    if np.any(np.diff(confidence) > 0.0):
        raise ValueError("detections must come in the order of their confidence, the most confident first")

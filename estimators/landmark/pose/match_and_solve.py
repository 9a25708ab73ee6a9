"""Match landmarks and solve for the pose alternately, until the matches no longer change.

Section 3.4.3 of Rowell et al. (2015).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from boresight.estimators.landmark.database import LandmarkDatabase
from boresight.estimators.landmark.matching import Matches, inverse_2x2, match_landmarks
from boresight.estimators.landmark.pose.levenberg_marquardt import (
    MarquardtOptions,
    PoseFit,
    pose_covariance,
    refine_pose,
)
from boresight.estimators.landmark.pose.problem import MIN_LANDMARKS, PoseProblem, solve_epnp
from boresight.estimators.landmark.projection import Projection, project_landmarks, visible_landmarks
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import Camera, Pose
from boresight.scenarios.spec.base import SpecModel


class PoseOptions(SpecModel):
    """Options of matching and solving."""

    method: Literal["both", "closed-form", "non-linear"] = Field(
        "both", description="EPnP and then Levenberg-Marquardt, or one of them alone"
    )
    marquardt: MarquardtOptions = MarquardtOptions()
    match_d2_max: float = Field(36.0, gt=0, description="Largest weighted squared distance of a match")
    max_rounds: int = Field(30, ge=1, le=1000, description="Rounds of matching and solving")


@dataclass(frozen=True, slots=True, eq=False)
class MatchingRound:
    """One round of matching and solving.

    ``projection`` has all landmarks, projected at the pose before the round, and ``visible`` (N,) those visible from
    there. ``closed_form`` is the pose by EPnP, None if not wanted or not found; ``fit`` is the pose after the round,
    None if there were too few matches or no solution.
    """

    projection: Projection
    visible: NDArray[np.bool_]
    matches: Matches
    closed_form: Pose | None = None
    fit: PoseFit | None = None


@dataclass(frozen=True, slots=True, eq=False)
class PoseSolution:
    """All rounds and the fit of the last; ``failure`` is the reason if there is none."""

    rounds: tuple[MatchingRound, ...]
    stable: bool = False
    failure: str = ""
    fit: PoseFit | None = field(default=None)


def solve_matches(problem: PoseProblem, start: Pose, options: PoseOptions) -> tuple[Pose | None, PoseFit | None]:
    """Solve once; return the closed-form pose, if wanted, and the fit.

    If EPnP finds no pose with the landmarks in front of the camera, the refinement begins at ``start``.
    """
    closed_form = None if options.method == "non-linear" else solve_epnp(problem)
    if options.method == "closed-form":
        if closed_form is None:
            return None, None
        fit = PoseFit(closed_form, float(problem.chi2(closed_form)), pose_covariance(problem, closed_form), 0)
    else:
        fit = refine_pose(problem, closed_form or start, options.marquardt)
    usable = np.isfinite(fit.chi2) and np.isfinite(fit.covariance).all()
    return closed_form, fit if usable else None


def solve_pose(
    database: LandmarkDatabase, camera: Camera, start: Pose, corners_px: FloatArray, options: PoseOptions
) -> PoseSolution:
    """Recognise landmarks among corners (M, 2), px, and solve for the pose; they are first predicted from ``start``."""
    mesh = database.mesh()
    pose = start
    rounds: list[MatchingRound] = []
    for _ in range(options.max_rounds):
        projection = project_landmarks(database, camera, pose)
        visible = visible_landmarks(mesh, camera, pose)
        matches = match_landmarks(
            projection.uv_px, projection.covariances_px2, visible, corners_px, options.match_d2_max
        )
        # The same matches give the same pose but for the weights, so that the set is stable.
        if rounds and rounds[-1].fit is not None and matches.same_pairs(rounds[-1].matches):
            return PoseSolution(tuple(rounds), True, "", rounds[-1].fit)
        rounds.append(MatchingRound(projection, visible, matches))
        if len(matches) < MIN_LANDMARKS:
            return PoseSolution(tuple(rounds), False, f"{len(matches)} landmarks recognised, {MIN_LANDMARKS} needed")
        problem = PoseProblem(
            database.means_m[matches.landmark],
            corners_px[matches.corner],
            # Weights from the pose before the round: constant during the fit, so that chi-square is a plain sum of
            # squares.
            inverse_2x2(projection.covariances_px2[matches.landmark]),
            camera,
        )
        closed_form, fit = solve_matches(problem, pose, options)
        rounds[-1] = MatchingRound(projection, visible, matches, closed_form, fit)
        if fit is None:
            return PoseSolution(tuple(rounds), False, f"{len(matches)} recognised landmarks fix no pose")
        pose = fit.T_cam_body
    return PoseSolution(tuple(rounds), False, "", rounds[-1].fit)

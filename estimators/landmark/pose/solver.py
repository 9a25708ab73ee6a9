"""Pose solvers on stacks of problems: closed form, non-linear, or both (section 3.4)."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from estimators.landmark.build import DatabaseOptions
from estimators.landmark.pose.batch import FitStack, refine_poses
from estimators.landmark.pose.epnp import solve_epnp
from estimators.landmark.pose.levenberg_marquardt import MarquardtOptions
from estimators.landmark.pose.stack import PoseStack, ProblemStack
from scenarios.geometry import Pose
from scenarios.spec.base import SpecModel

NAME = "pose-solver"
VERSION = 1


class PoseSolverOptions(SpecModel):
    """A pose solver and the data base whose landmarks it is tried on."""

    database: DatabaseOptions = DatabaseOptions()
    method: Literal["both", "closed-form", "non-linear"] = Field(
        "both", description="EPnP and then Levenberg-Marquardt, or one of them alone"
    )
    marquardt: MarquardtOptions = MarquardtOptions()


def closed_forms(problems: ProblemStack) -> list[Pose | None]:
    """Solve each problem by EPnP; None where it finds no pose in front of the camera."""
    return [solve_epnp(problems.problem(row)) for row in range(len(problems))]


def solve_stack(
    problems: ProblemStack, priors: PoseStack, closed: list[Pose | None], options: PoseSolverOptions
) -> FitStack:
    """Solve each problem; where EPnP found no pose, both stages together begin at the prior, as in ``solve_matches``.

    Parameters
    ----------
    problems, priors
        B problems and the poses known beforehand.
    closed
        Their solutions by EPnP.
    options
        Which solver.

    Returns
    -------
    The fits; an infinite chi-square where there is none.
    """
    starts = priors if options.method == "non-linear" else _or_prior(closed, priors)
    if options.method != "closed-form":
        return refine_poses(problems, starts, options.marquardt)
    found = np.array([pose is not None for pose in closed])
    return FitStack(starts, np.where(found, problems.chi2(starts), np.inf), np.zeros(len(found), dtype=np.int64))


def _or_prior(closed: list[Pose | None], priors: PoseStack) -> PoseStack:
    rotations, translations_m = priors.rotations.copy(), priors.translations_m.copy()
    for row, pose in enumerate(closed):
        if pose is not None:
            rotations[row], translations_m[row] = pose.rotation, pose.translation_m
    return PoseStack(rotations, translations_m)

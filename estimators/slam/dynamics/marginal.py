"""Marginalisation of the oldest view, its velocity and lost landmarks out of an adjustment with dynamics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimators.slam.dynamics.problem import DynamicAdjustment, DynamicPrior, DynamicState, gathered
from estimators.slam.dynamics.system import Rows, dynamic_equations
from estimators.slam.marginal import departing, schur, touched

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


def marginalised_dynamic(problem: DynamicAdjustment, state: DynamicState, view: int, lost: BoolArray) -> DynamicPrior:
    """Marginalise a view with its velocity, and the landmarks marked in ``lost`` (L,), all linearised at ``state``.

    The quadratic is about all other views, the parameters, and the landmarks that something departing speaks of.

    Raises
    ------
    numpy.linalg.LinAlgError
        If what goes is not determined.
    """
    part = _departing(problem, view, lost)
    rows = Rows.of(part)
    matrix, right, _ = dynamic_equations(part, state, rows).reduced()
    views = np.flatnonzero(np.arange(len(problem.R_body_inertial)) != view)
    points = np.flatnonzero(part.vision.free_points & ~lost)
    kept = rows.of_prior(views, points)
    staying = np.zeros(rows.count, dtype=np.bool_)
    staying[kept[kept >= 0]] = True
    information, gradient = schur(matrix, -right, ~staying)
    place = np.append(np.cumsum(staying) - 1, -1)[kept]  # what is fixed keeps rows of zeros
    padded = np.zeros((len(information) + 1, len(information) + 1))
    padded[:-1, :-1] = information
    return DynamicPrior(
        views, points, gathered(state, views, points), padded[np.ix_(place, place)], np.append(gradient, 0.0)[place]
    )


def _departing(problem: DynamicAdjustment, view: int, lost: BoolArray) -> DynamicAdjustment:
    """Return the part of ``problem`` that goes; of its landmarks only those that it speaks of are free."""
    vision = departing(problem.vision, view, lost)
    joined = np.zeros(len(lost), dtype=np.bool_)
    if problem.prior is not None:
        joined[problem.prior.points] = True
    told = touched(vision) | joined
    vision = replace(vision, free_points=vision.free_points & told, kept_points=told & (joined | ~lost))
    return replace(problem, vision=vision, arcs=problem.arcs.of_view(view))

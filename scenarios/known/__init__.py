"""A priori knowledge of the estimators by scenario: which parts are identical with the truth and which are not."""

from __future__ import annotations

from boresight.scenarios.known.images import (
    crater_detection,
    crater_pairs,
    data_bases,
    pose_solvers,
    real_images,
    single_images,
)
from boresight.scenarios.known.orbits import orbits, plans
from boresight.scenarios.known.record import Item, Known, correlated, merged
from boresight.scenarios.known.sequences import sequences
from boresight.scenarios.spec.scenario import ScenarioSpec

__all__ = ["Item", "Known", "correlated", "known_on_board", "merged"]

_OF_VIEWS = {
    "crater-detection": crater_detection,
    "landmark-database": data_bases,
    "pose-convergence": pose_solvers,
}


def known_on_board(spec: ScenarioSpec, experiment: str = "") -> Known:
    """Return which parts of the truth an estimator has exactly, with errors, or not at all.

    Parameters
    ----------
    spec
        The scenario.
    experiment
        The kind of the trials, which determines the data given to estimators.
    """
    if spec.sequence is not None:
        return sequences(spec.sequence)
    if spec.orbit is not None:
        return plans(spec.orbit) if experiment == "image-survey" else orbits(spec, spec.orbit)
    if spec.crater_pairs is not None:
        return crater_pairs(spec)
    if spec.images is not None:
        return real_images(spec, spec.images)
    return _OF_VIEWS.get(experiment, single_images)(spec)

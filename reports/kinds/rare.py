"""How often a requirement is missed by another law of the pose errors than the one that a run has drawn by."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from boresight.reports.kinds.requirements import independent_units, required_values
from boresight.reports.run.data import RunData
from boresight.reports.schema.grid import Grid, row_grid
from boresight.reports.statistics.rare import weighted_rate
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.spec.world import PoseErrorSpec
from boresight.scenarios.weights import pose_error_weights

_KINDS = "single-image", "pose-convergence"
_FAR = 4.0  # standard deviations
_NOTE = (
    "Missed: trials beyond the limit, or without an estimate. Rate: of misses by the wanted law of the pose errors,"
    " with its 95 % interval, which allows for one miss more of the largest weight. Effective: unweighted trials that"
    " know a mean as well."
)


def rare_grid(run: RunData, wanted: Mapping[str, PoseErrorSpec]) -> Grid:
    """Tabulate how often each requirement of a run is missed by the ``wanted`` laws of its scenarios.

    Raise BoresightError if its trials have no pose errors of their own or depend on each other, or a law cannot be
    weighted by.
    """
    name, experiment = run.manifest.name, run.manifest.experiment
    if experiment not in _KINDS:
        raise BoresightError(f"{name}: a run of {experiment}: only those of {' and '.join(_KINDS)} can be weighted")
    specs, rows, apart = run.specs, [], []
    if specs is None:
        raise BoresightError(f"{name}: its scenarios are those of another version of boresight: run it again")
    for requirement, scenario, estimator, values in required_values(run):
        if not len(values := values.dropna()):
            raise BoresightError(f"{name}: no trial of {estimator} in {scenario} is stored")
        own = run.rows.loc[values.index]
        if len(np.unique(independent_units(run, own))) < len(own):
            raise BoresightError(f"{name}: trials of {scenario} share images: only independent ones can be weighted")
        trials = own["trial"].to_numpy()
        weights = pose_error_weights(wanted[scenario], specs[scenario].pose_error, run.manifest.seed, trials)
        found = weighted_rate(requirement.missed(np.asarray(values, dtype=np.float64)), weights)
        if experiment == _KINDS[0] and specs[scenario].believed_pose_error != wanted[scenario]:
            apart.append(f"{scenario}: estimators were told another law than the wanted one: give onboard.pose_error.")
        if abs(found.weight - 1.0) > _FAR * found.weight_sigma:
            apart.append(f"{scenario}: the mean weight is {found.weight:.3g}, not 1: wanted errors are not drawn.")
        rows.append(
            {
                "requirement": requirement.written,
                "scenario": scenario,
                "estimator": estimator,
                "missed": f"{found.missed}/{found.n}",
                "rate [95 %]": f"{found.rate:.3g} [{found.low:.3g}, {found.high:.3g}]",
                "effective": f"{found.effective:.0f}",
            }
        )
    return row_grid(
        "Misses by another law of the pose errors",
        rows,
        ("requirement", "scenario", "estimator"),
        " ".join([_NOTE, *dict.fromkeys(apart)]),
    )

"""What is drawn of an orbit determination: residuals of the sightings, and the error with its sigma."""

from __future__ import annotations

import numpy as np
import pandas as pd

from campaign.inspection.recompute import Recomputed
from campaign.inspection.show import Drawn
from campaign.kinds.orbit_determination.score import orbit_errors, residual_records, wrong_sightings
from campaign.kinds.orbit_determination.trial import DeterminedOrbit
from reports.figures.orbit import draw_orbit_case_errors, draw_residuals, draw_sightings_used
from reports.schema.named_figure import NamedFigure


def draw_orbit_case(again: Recomputed) -> Drawn | None:
    """Draw a solution, also one that was rejected; without any there is nothing to draw."""
    shown, what = again.shown, str(again.case)
    if not isinstance(shown, DeterminedOrbit):
        return None
    orbit = None if shown.estimate is None else shown.estimate.orbit
    if shown.estimate is None or orbit is None:
        return Drawn([], notes=["There is nothing to draw: no solution came out."])
    errors = pd.DataFrame(list(orbit_errors(orbit, shown.truth, shown.data)))
    residuals = pd.DataFrame(list(residual_records(orbit, shown.data)))
    placed = np.isfinite(orbit.residuals_px[:, 0])
    residuals = residuals.assign(wrong=wrong_sightings(orbit, shown.truth, shown.data)[placed])
    figures = [
        NamedFigure(
            "errors",
            draw_orbit_case_errors(errors, what),
            f"{what}. Error of the position in inertial space, and what the covariance foretells: the dashed line is"
            " the root of its trace. Right of the grey line no image is taken.",
            "Components of the error and its length over days.",
        ),
        NamedFigure(
            "residuals",
            draw_residuals(residuals, what),
            f"{what}. Residuals of the sightings that the filter used.",
            "Two scatters about zero over days.",
        ),
        NamedFigure(
            "sightings",
            draw_sightings_used(residuals, what),
            f"{what}. Residuals of all sightings: used or edited by the filter, right or of another crater than their"
            " number stands for.",
            "A scatter of residuals in four classes.",
        ),
    ]
    rejected = shown.estimate.status == "failed"
    return Drawn(figures, notes=[f"The solution was rejected: {shown.estimate.reason}."] if rejected else [])

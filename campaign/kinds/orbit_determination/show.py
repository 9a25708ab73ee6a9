"""What trials of orbit determination show of themselves."""

from __future__ import annotations

import numpy as np
import pandas as pd

from campaign.inspection.recompute import Recomputed
from campaign.inspection.show import Drawn, Kept, Show
from campaign.kinds.orbit_determination.look import look_at_orbits
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


def kept(shown: object) -> Kept:
    """Return the orbit of a solution; nothing where none came out."""
    if not isinstance(shown, DeterminedOrbit) or shown.estimate is None or shown.estimate.orbit is None:
        return Kept()
    orbit = shown.estimate.orbit
    solution = {
        "status": shown.estimate.status,
        "reason": shown.estimate.reason,
        "state_inertial": orbit.state.tolist(),
        "covariance": orbit.covariance.tolist(),
        "times_s": shown.data.wanted_s.tolist(),
        "positions_inertial_m": orbit.positions_m.tolist(),
    }
    return Kept({}, solution)


SHOW = Show(draw=draw_orbit_case, kept=kept, look=look_at_orbits)

"""Columns of orbit determination: an orbit from sightings of craters and radiometric data."""

from __future__ import annotations

from dataclasses import replace

from boresight.reports.schema.column import Column, Columns, KindSchema, flag, measured, names, number
from boresight.reports.schema.common import DATABASE, KEY, POSE_ERROR, VIEW


def _of_arc(name: str, meaning: str, label: str = "") -> Column:
    return measured(name, meaning, label, error=True, detail=bool(label))


ROW: Columns = (
    replace(POSE_ERROR[0], meaning="position error at the epoch, inertial axes"),
    number("nees", "error of the state weighted by its covariance (6 degrees of freedom)"),
    number("position_sigma_m", "RMS position error at the epoch that the covariance foretells"),
    *VIEW[:1],
)
_ARC: Columns = (
    _of_arc("arc_rms_m", "root mean square of the same", "RMS position error over the arc"),
    _of_arc("arc_median_m", "median position error over the arc, every 6 h", "median position error over the arc"),
    _of_arc("arc_p90_m", "90 % of the same"),
    _of_arc("predicted_error_m", "position error at the end of the predicted days", "predicted position error"),
    _of_arc("residual_rms_px", "RMS of a coordinate of the residuals that were not edited"),
)
_EDITING: Columns = (
    _of_arc("wrong_left_share", "share of wrong sightings among those that were not edited"),
    _of_arc("right_edited_share", "share of the right sightings that were edited"),
)
ORBIT_COLUMNS = names((*_ARC, *_EDITING))
"""Errors of an orbit in the table ``orbits``; the position error is that at the epoch."""

METRICS = ("position_error_m", *names(_ARC))
_BY_NAME = {column.name: column for column in (*_ARC, *_EDITING)}

SCHEMA = KindSchema(
    row=(*DATABASE, *ROW),
    tables={
        "orbits": (
            *KEY,
            measured("epoch_error_m", "position error at the epoch, inertial axes", "position error at the epoch"),
            number("epoch_velocity_error_m_s", "velocity error there"),
            number("epoch_nees", "error of the state weighted by its covariance, over 6: 1 is expected"),
            _BY_NAME["arc_median_m"],
            _BY_NAME["arc_rms_m"],
            _BY_NAME["arc_p90_m"],
            number("arc_nees", "mean over the arc of the position error weighted by its covariance, over 3"),
            _BY_NAME["predicted_error_m"],
            number("predicted_sigma_m", "RMS position error that the covariance foretells there"),
            _BY_NAME["residual_rms_px"],
            *_EDITING,
            number("gm_error", "relative error of GM"),
            number("solar_pressure_error", "relative error of the size of solar pressure"),
        ),
        "orbit_errors": (
            *KEY,
            number("time_days", "time after the epoch"),
            flag("predicted", "whether it is later than the last image"),
            number("position_error_m", "length of r_est - r_true, inertial axes"),
            number("radial_m", "component of the same away from the body"),
            number("along_m", "component along the true motion, at a right angle to the radial one"),
            number("cross_m", "component along radial x along"),
            number("position_sigma_m", "RMS position error that the covariance foretells"),
        ),
        "residuals": (
            *KEY,
            number("time_days", "time of the image after the epoch; of the first trial alone"),
            number("u_px", "column seen less predicted"),
            number("v_px", "row seen less predicted"),
            flag("used", "whether the sighting was not edited"),
        ),
    },
    metrics=METRICS,
    nees="orbits",
    databases_note=(
        "Positions and prominence of the craters were drawn {n} times; trials have them in turn. Intervals take that"
        " draw for what is independent (Student's t over the draws), so that they include the variation between them."
        " The body and its a priori shape are the same in all trials of a scenario."
    ),
)

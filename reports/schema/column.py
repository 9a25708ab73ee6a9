"""Measures, columns of stored tables, what a kind of trial stores and reports, and what several kinds share."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import pyarrow as pa

# Units by the end of a name: of columns, and of numbers that estimators report.
_SUFFIXES = {
    "_px": "px", "_m": "m", "_deg": "deg", "_m_s": "m/s", "_s": "s", "_days": "days", "_bytes": "bytes",
}  # fmt: skip


def unit_by_suffix(name: str) -> str:
    """Return the unit that the end of a name says, '' where it says none."""
    return next((unit for end, unit in _SUFFIXES.items() if name.endswith(end)), "")


@dataclass(frozen=True, slots=True, kw_only=True)
class Measure:
    """A number that reports print, by its name in tidy tables, comparisons and files of published values.

    ``label`` is in words, without the unit; '' for the name without its unit. ``unit`` None is that of the end of the
    name. Of an ``error`` smaller is better. A stored column that is not ``printed`` is there for users alone; one with
    ``detail`` is listed in the table of details, others in tables of their kind.
    """

    name: str
    label: str = ""
    unit: str | None = None
    error: bool = False
    printed: bool = True
    detail: bool = False

    @property
    def axis(self) -> str:
        """In words, with the unit."""
        return f"{self.label}, {self.unit}" if self.unit else self.label


@dataclass(frozen=True, slots=True, kw_only=True)
class Column(Measure):
    """A column of a stored table: a measure, if reports print it, with its Arrow type and meaning.

    One of whole numbers with ``gaps`` has rows without a number.
    """

    type: pa.DataType
    meaning: str
    gaps: bool = False
    printed: bool = False

    @property
    def stored_unit(self) -> str:
        """Unit of the stored numbers; '' if they have none."""
        return unit_by_suffix(self.name) if self.unit is None else self.unit


Columns = tuple[Column, ...]


def text(name: str, meaning: str) -> Column:
    """Make a column of texts."""
    return Column(name=name, type=pa.string(), meaning=meaning)


def count(name: str, meaning: str, label: str = "", *, gaps: bool = False) -> Column:
    """Make a column of whole numbers; one with a label is a measure of the table of details."""
    shown = bool(label)
    return Column(name=name, type=pa.int64(), meaning=meaning, gaps=gaps, label=label, printed=shown, detail=shown)


def flag(name: str, meaning: str) -> Column:
    """Make a column of truth values."""
    return Column(name=name, type=pa.bool_(), meaning=meaning)


def number(name: str, meaning: str) -> Column:
    """Make a column of numbers that no report prints by its name."""
    return Column(name=name, type=pa.float64(), meaning=meaning)


def measured(name: str, meaning: str, label: str = "", *, error: bool = False, detail: bool = True) -> Column:
    """Make a column of numbers that is a measure."""
    return Column(name=name, type=pa.float64(), meaning=meaning, label=label, error=error, printed=True, detail=detail)


def names(columns: Iterable[Measure]) -> tuple[str, ...]:
    """Return the names of measures or columns."""
    return tuple(column.name for column in columns)


@dataclass(frozen=True, slots=True, kw_only=True)
class KindSchema:
    """Stored columns and reported measures of a kind of trial.

    ``row`` has the columns of its rows after those that all kinds have, ``tables`` its further tables, ``measures``
    what is worked out of them. ``metrics`` are measures of each trial that comparisons may go by before there is a run,
    the usual one first. ``nees`` is the table of the normalised squared errors: ``rows`` of poses, ``epochs`` of
    positions frame by frame, ``orbits`` of states at an epoch. ``frames``: a trial consists of frames, one of which the
    reason of a failure names. ``databases_note`` says what intervals rest on where ``{n}`` data bases take turns.
    """

    row: Columns = ()
    tables: Mapping[str, Columns] = field(default_factory=dict)
    measures: tuple[Measure, ...] = ()
    metrics: tuple[str, ...]
    nees: Literal["rows", "epochs", "orbits"] = "rows"
    frames: bool = False
    databases_note: str = (
        "Each estimator's data base was drawn {n} times, with the errors of the shape on board where it has some, and"
        " with another world of craters where there is one; trials have them in turn. Intervals and tests take the"
        " data base for what is independent (Student's t over them), so that they tell of other data bases too."
    )


FRESH_IMAGE, STORED_IMAGE = "image", "stored_image"
"""Stages of ``timings``: an image that was rendered or read in this run, or kept from another."""

IMAGE_KEY: Columns = (count("trial", "number of the trial, from 0"), text("scenario", "name of the scenario"))
KEY: Columns = (*IMAGE_KEY, text("estimator", "label of the estimator"))
COMMON_ROW: Columns = (
    *KEY,
    text("status", "ok, failed (with a reason) or error (it raised, was stopped or returned an invalid result)"),
    text("reason", "why it is not ok; empty when ok"),
    count("n_landmarks", "landmarks that the estimate rests on; 0 where it uses none", "landmarks an image"),
)
"""The row of a trial and method, whatever the kind."""

DATABASE: Columns = (
    count("database", "number of the data base that it had, from 0; empty where it has none", gaps=True),
)
VIEW: Columns = (
    number("range_m", "true distance of the camera from the body's origin"),
    number("phase_deg", "true phase angle at the body's origin"),
)

_IN = {"x": "right", "y": "down", "z": "along the boresight"}
POSE_ERROR: Columns = (
    measured(
        "position_error_m", "length of c_est - c_true, the camera in the body frame", "position error", error=True,
        detail=False,
    ),
    measured(
        "attitude_error_deg", "angle of the rotation from the true to the estimated attitude", "attitude error",
        error=True, detail=False,
    ),
    *(
        measured(
            f"position_error_{axis}_m", f"{axis} of R_true (c_est - c_true) in camera axes: {where}",
            f"position error, {axis}", error=True, detail=False,
        )
        for axis, where in _IN.items()
    ),
)  # fmt: skip
POSE_COLUMNS = names(POSE_ERROR)
PRIOR_ERROR: Columns = tuple(
    Column(name=f"prior_{c.name}", type=c.type, meaning=f"of the prior: {c.meaning}") for c in POSE_ERROR
)
LATERAL, BORESIGHT = "lateral_error_m", "boresight_error_m"
COMPONENTS: Mapping[str, tuple[str, ...]] = {
    LATERAL: ("position_error_x_m", "position_error_y_m"),
    BORESIGHT: ("position_error_z_m",),
}
"""Errors across and along the camera's boresight, by the columns whose root sum of squares they are."""

POSE_METRICS = (*POSE_COLUMNS, *COMPONENTS)

SIGHT = "sight_error_m"
"""Distance by which the estimated line of sight misses the body's origin, in camera axes: no error of attitude."""


def ellipse(what: str) -> Columns:
    """Return the columns of an ellipse in an image."""
    return (
        number("u_px", f"column of the centre of {what}, continuous pixels"),
        number("v_px", "row of the centre"),
        number("major_px", "longer semi-axis"),
        number("minor_px", "shorter semi-axis"),
        number("angle_deg", "from the column axis to the longer one, towards the row axis"),
    )


SHARED_TABLES: Mapping[str, Columns] = {
    "diagnostics": (*KEY, text("name", "name of a number that the estimator reports"), number("value", "its value")),
    "timings": (*KEY, text("stage", "stage of the trial or of the estimator"), number("seconds", "wall time")),
    "said": (
        *KEY,
        text("stream", "stdout, stderr, or warnings of Python"),
        text("text", "what the method wrote there; only the beginning where much, which it then says"),
    ),
    "tracebacks": (*KEY, text("traceback", "Python traceback of an estimator that raised")),
}


def share(name: str, label: str = "", *, error: bool = False, detail: bool = True) -> Measure:
    """Make a measure in per cent; one without a label is only in the table of its kind."""
    return Measure(name=name, label=label, unit="%", error=error, detail=detail and bool(label))


def plain(name: str, label: str = "", *, error: bool = False) -> Measure:
    """Make a measure; one with a label is listed in the table of details."""
    return Measure(name=name, label=label, error=error, detail=bool(label))


SHARED_MEASURES = (
    Measure(name=LATERAL, label="position error across the boresight", error=True),
    Measure(name=BORESIGHT, label="position error along the boresight", error=True),
    Measure(name=SIGHT, label="error of the line of sight", error=True),
    Measure(name=f"prior_{LATERAL}", label="prior error across the boresight"),
    Measure(name=f"prior_{BORESIGHT}", label="prior error along the boresight"),
    Measure(name="phase_deg", label="phase angle"),
    Measure(name="latitude_deg", label="latitude of the camera"),
    Measure(name="longitude_deg", label="longitude of the camera"),
    Measure(name="off_pointing_deg", label="off-pointing"),
    Measure(name="view_deg", label="angle between the two cameras"),
    Measure(name="sun_deg", label="angle between the two directions of the Sun"),
    Measure(name="seconds", label="time", unit="s"),
    Measure(name="processing_seconds", unit="s"),
    share("success_share", "success"),
    share("four_landmarks_share", "four landmarks or more"),
    plain("landmark_observations", "landmark observations"),
    plain("position_reduction_m", "reduction of the position error"),
    plain("attitude_reduction_deg", "reduction of the attitude error"),
    plain("landmarks", "landmarks in the data base"),
    plain("facets", "facets of the data base"),
    plain("images", "images of the arc"),
    plain("outlier_rounds", "outlier rounds"),
    plain("database_landmarks", "landmarks in the data base"),
    plain("database_facets", "facets of the data base"),
    plain("database_bytes", "size of the data base"),
    plain("centroid_offset_px", "offset of the brightness centroid"),
    plain("centroid_du_px", "offset of the centroid along the columns"),
    plain("extent_px", "extent of the body, longer side"),
    plain("diameter_px", "extent of the body, disc of equal area"),
    plain("pixel_scale_m", "a pixel on the surface"),
    plain("pixel_rotation_deg", "rotation of the body by a pixel"),
    plain("pixel_displacement_m", "displacement of the camera by a pixel"),
)

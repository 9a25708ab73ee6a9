"""A stored run, read back: the only thing that a report is made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, field_validator

from scenarios.checksums import refuse_damaged
from scenarios.errors import BoresightError
from scenarios.known import Known, known_on_board
from scenarios.parquet import Layout, read_frame
from scenarios.reading import held_to, plain_json, unreadable
from scenarios.spec.scenario import ScenarioSpec

TRIAL_KEY = ["scenario", "estimator", "trial"]
"""Columns that tell the row of a trial and method from all others."""

POSE_COLUMNS = (
    "position_error_m",
    "attitude_error_deg",
    "position_error_x_m",
    "position_error_y_m",
    "position_error_z_m",
)
_KEY = ("scenario", "estimator", "trial")
_TEXTS = frozenset({"scenario", "estimator", "status", "reason", "stage", "reference", "name", "kind"})
_ELLIPSE = ("u_px", "v_px", "major_px", "minor_px", "angle_deg")
_COLUMNS: Mapping[str, tuple[str, ...]] = {
    "rows": (*_KEY, "status", "reason", *(f"prior_{name}" for name in POSE_COLUMNS), *POSE_COLUMNS),
    "stages": (*_KEY, "stage", *POSE_COLUMNS),
    "references": (*_KEY, "reference", *POSE_COLUMNS),
    "landmarks": (*_KEY, "landmark", "error_m", "chi_square"),
    "diagnostics": (*_KEY, "name", "value"),
    "timings": (*_KEY, "stage", "seconds"),
    "vision": (
        *_KEY,
        "frame",
        "n_features",
        "repeatability",
        "n_matches",
        "right_share",
        "n_kept",
        "kept_right_share",
        "n_tracks",
        "n_wrong",
        "error_px",
        "sigma_px",
    ),
    "crater_matches": (
        *_KEY,
        "view_deg",
        "sun_deg",
        "n_common",
        "n_correct",
        "n_wrong",
        "n_missed",
        "epipolar_offset_px",
    ),
    "crater_images": ("scenario", "trial", "phase_deg", "n_craters", "n_detectable", "n_clean"),
    "craters": (
        "scenario",
        "trial",
        "crater",
        *_ELLIPSE,
        "degradation",
        "incidence_deg",
        "detectable",
        "clean",
    ),
    "detections": (
        *_KEY,
        "rank",
        "confidence",
        "kept",
        *_ELLIPSE,
        "crater",
        "duplicate",
        "detectable",
        "clean",
        "centre_error_px",
        "major_error_px",
        "minor_error_px",
    ),
    "orbits": (
        *_KEY,
        "epoch_error_m",
        "epoch_nees",
        "arc_median_m",
        "arc_rms_m",
        "arc_nees",
        "predicted_error_m",
        "residual_rms_px",
        "wrong_left_share",
        "right_edited_share",
        "gm_error",
        "solar_pressure_error",
    ),
    "orbit_errors": (*_KEY, "time_days", "predicted", "position_error_m", "position_sigma_m"),
    "residuals": (*_KEY, "time_days", "u_px", "v_px", "used"),
    "navigation": (
        *_KEY,
        "rounds",
        "n_images",
        "n_detections",
        "n_false",
        "n_pairs",
        "n_correct",
        "n_wrong",
        "n_common",
        "n_landmarks",
    ),
    "navigated_images": (*_KEY, "n_detections", "n_numbered"),
    "navigated_landmarks": (*_KEY, "hits", "n_other", "first_days", "last_days"),
    "surveyed_images": (*_KEY, "image", "n_detections", "n_similar"),
    "surveyed_craters": (*_KEY, "crater", "hits"),
    "epochs": (*_KEY, "frame", "anomaly_deg", "position_error_m", "landmark_rmse_m", "settled_landmark_rmse_m"),
}


class Product(BaseModel):
    """What is known of a product that was built before the trials, such as a landmark data base.

    ``scenario`` and ``estimator`` say whose it is, ``folder`` which it is: what several share has one folder. Empty
    where it is not said. ``database`` is the number of the data base that it belongs to.
    """

    model_config = ConfigDict(frozen=True, extra="allow")

    kind: str
    scenario: str = ""
    estimator: str = ""
    folder: str = ""
    database: int = 0
    n_landmarks: int | None = None
    n_facets: int | None = None
    bytes: int | None = None
    seconds: float | None = None
    images: int | None = None


class DesignAxis(BaseModel):
    """An axis of a campaign's grid: the names of its levels, the reference first, and their values if they have any."""

    model_config = ConfigDict(frozen=True)

    name: str
    label: str
    levels: tuple[str, ...]
    values: tuple[float, ...] | None = None


class Variation(BaseModel):
    """Where a scenario stands in a grid: the scenario that it varies, and its level of each axis."""

    model_config = ConfigDict(frozen=True)

    name: str
    base: str
    levels: Mapping[str, str]


class Design(BaseModel):
    """A campaign's grid: its axes, and its scenarios in order, the reference first."""

    model_config = ConfigDict(frozen=True)

    design: str
    axes: tuple[DesignAxis, ...]
    scenarios: tuple[Variation, ...]


class Manifest(BaseModel):
    """What a report needs of ``manifest.json``; further keys are left alone.

    ``credits`` has no default: a figure of somebody else's images without its credit line is not acceptable.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    name: str
    title: str = ""
    description: str = ""
    seed: int
    trials: int = Field(ge=0)
    created: str = ""
    commit: str = ""
    scenarios: Mapping[str, Mapping[str, Any]]
    estimators: tuple[Any, ...]
    versions: Mapping[str, Any]
    machine: Mapping[str, Any]
    credits: tuple[str, ...]
    report: str | None = None
    command: str = ""
    notes: tuple[str, ...] = ()
    products: tuple[Product, ...] = ()
    grid: Design | None = None
    campaign: Mapping[str, Any] = {}

    @property
    def experiment(self) -> str:
        """The kind of its trials; empty where it is not said."""
        return str(self.campaign.get("experiment", ""))

    @field_validator("scenarios")
    @classmethod
    def _have_sections(cls, scenarios: Mapping[str, Mapping[str, Any]]) -> Mapping[str, Mapping[str, Any]]:
        for name, spec in scenarios.items():
            for key in ("images", "sequence"):
                if not isinstance(spec.get(key) or {}, Mapping):
                    raise ValueError(f"{name}.{key} is no section")  # noqa: TRY004  pydantic wants a ValueError
        return scenarios


@dataclass(frozen=True, eq=False)
class RunData:
    """The tables of a run, sorted by trial, scenario and estimator; a table that was not stored is empty.

    Parameters
    ----------
    folder
        Where the run lies.
    manifest
        How it was made.
    rows
        One row per trial and estimator; ``image`` is '' where the image was rendered, ``n_landmarks`` is
        NaN where the estimator does not count landmarks, ``database`` where it has no data base.
    stages, references, landmarks, diagnostics, timings
        Detail tables: errors after each stage, errors against further reference poses, recognised
        landmarks, numbers that estimators report, wall times.
    epochs
        Of sequences: the errors of every frame.
    vision
        Of sequences of images: what the vision layer found in every frame.
    crater_matches
        Of pairs of images: how many craters were matched.
    crater_images, craters, detections
        Of images of craters: what each is like, the true craters in it, and what every detector found.
    orbits, orbit_errors, residuals
        Of orbit determination: what each trial comes to, errors over time, and residuals of the first trial.
    navigation, navigated_images, navigated_landmarks
        Of crater navigation: what each trial comes to before the orbit, its images, and the landmarks of its data base.
    surveyed_images, surveyed_craters
        Of arcs of planned images: what each image shows, and how often each crater is seen.
    """

    folder: Path
    manifest: Manifest
    rows: pd.DataFrame
    stages: pd.DataFrame
    references: pd.DataFrame
    landmarks: pd.DataFrame
    diagnostics: pd.DataFrame
    timings: pd.DataFrame
    epochs: pd.DataFrame = field(default_factory=pd.DataFrame)
    vision: pd.DataFrame = field(default_factory=pd.DataFrame)
    crater_matches: pd.DataFrame = field(default_factory=pd.DataFrame)
    crater_images: pd.DataFrame = field(default_factory=pd.DataFrame)
    craters: pd.DataFrame = field(default_factory=pd.DataFrame)
    detections: pd.DataFrame = field(default_factory=pd.DataFrame)
    orbits: pd.DataFrame = field(default_factory=pd.DataFrame)
    orbit_errors: pd.DataFrame = field(default_factory=pd.DataFrame)
    residuals: pd.DataFrame = field(default_factory=pd.DataFrame)
    navigation: pd.DataFrame = field(default_factory=pd.DataFrame)
    navigated_images: pd.DataFrame = field(default_factory=pd.DataFrame)
    navigated_landmarks: pd.DataFrame = field(default_factory=pd.DataFrame)
    surveyed_images: pd.DataFrame = field(default_factory=pd.DataFrame)
    surveyed_craters: pd.DataFrame = field(default_factory=pd.DataFrame)

    @cached_property
    def image_of_trial(self) -> pd.Series:
        """Names of real images by scenario and trial, '' where the image was rendered."""
        return self.rows.drop_duplicates(["scenario", "trial"]).set_index(["scenario", "trial"])["image"]

    @cached_property
    def databases(self) -> int:
        """Count the data bases that an estimator had, trial by trial in turn."""
        return len(self.rows["database"].dropna().unique()) if "database" in self.rows else 0

    @cached_property
    def database_of_trial(self) -> pd.Series:
        """Numbers of data bases by `TRIAL_KEY`, NaN where an estimator has none."""
        return self.rows.set_index(TRIAL_KEY)["database"]

    @cached_property
    def known(self) -> Mapping[str, Known] | None:
        """What each scenario takes for known on board; None where one is not what this version of boresight reads."""
        try:
            specs = {name: ScenarioSpec.model_validate(dict(spec)) for name, spec in self.manifest.scenarios.items()}
        except ValueError:
            return None
        return {name: known_on_board(spec, self.manifest.experiment) for name, spec in specs.items()}

    def pairs(self) -> list[tuple[str, str]]:
        """List (scenario, estimator) in the order in which the rows name them."""
        return list(self.rows[["scenario", "estimator"]].drop_duplicates().itertuples(index=False, name=None))

    def posed_pairs(self) -> list[tuple[str, str]]:
        """List those of them that are about poses: their trials have a prior."""
        posed = self.rows[self.rows["prior_position_error_m"].notna()]
        return list(posed[["scenario", "estimator"]].drop_duplicates().itertuples(index=False, name=None))

    def progress(self) -> tuple[int, int]:
        """Count the trials that are stored and those that were asked for, over all scenarios."""
        done = len(self.rows[["scenario", "trial"]].drop_duplicates())
        return done, self.manifest.trials * len(self.manifest.scenarios)

    def truth_name(self, scenario: str) -> str:
        """Name the pose that the rows are scored against: that of a real image set, or ``truth``."""
        images = self.manifest.scenarios.get(scenario, {}).get("images") or {}
        return str(images.get("truth", "truth"))


def select(table: pd.DataFrame, scenario: str, estimator: str) -> pd.DataFrame:
    """Rows of one scenario and estimator."""
    return table[(table["scenario"] == scenario) & (table["estimator"] == estimator)]


def in_order_of(rows: pd.DataFrame, numbers: pd.Series) -> NDArray[np.float64]:
    """Bring ``numbers``, which go by `TRIAL_KEY`, into the order of rows (n,); NaN where a row has none."""
    return numbers.reindex(pd.MultiIndex.from_frame(rows[TRIAL_KEY])).to_numpy(dtype=np.float64)


def read_run(folder: str | PathLike[str]) -> RunData:
    """Read a run folder.

    Raises
    ------
    BoresightError
        If the manifest is missing or broken, a file is not what was stored, or no trial has been stored yet.
    """
    folder = Path(folder)
    manifest = _read_manifest(folder / "manifest.json")
    refuse_damaged(folder)
    tables = {name: _read_table(folder / name, columns, manifest) for name, columns in _COLUMNS.items()}
    rows = tables.pop("rows")
    if rows.empty:
        raise BoresightError(f"{folder}/rows: no finished trial is stored; continue the run first")
    unknown = sorted(set(rows["scenario"]) - manifest.scenarios.keys())
    if unknown:
        raise BoresightError(f"{folder}/rows: are of the scenario {unknown[0]}, which the manifest does not name")
    image = rows["image"].fillna("").astype(str) if "image" in rows else ""
    n_landmarks = rows["n_landmarks"].astype(float) if "n_landmarks" in rows else float("nan")
    database = rows["database"].astype(float) if "database" in rows else float("nan")
    rows = rows.assign(image=image, n_landmarks=n_landmarks, database=database, reason=rows["reason"].fillna(""))
    return RunData(folder, manifest, rows, **tables)


def _read_manifest(path: Path) -> Manifest:
    try:
        return held_to(Manifest, plain_json(path))
    except FileNotFoundError:
        raise BoresightError(f"{path}: not found; is {path.parent} the folder of a run?") from None
    except (OSError, ValueError) as error:
        raise unreadable(path, "a manifest", error) from error


def _read_table(folder: Path, columns: tuple[str, ...], manifest: Manifest) -> pd.DataFrame:
    """Read a Parquet folder, in an order that does not depend on how its parts were written."""
    if not folder.is_dir() or not any(folder.glob("*.parquet")):
        return pd.DataFrame(columns=list(columns))
    keys = tuple(name for name in ("trial", "scenario", "estimator") if name in columns)
    table = read_frame(folder, Layout(keys, _is_text))
    missing = [name for name in columns if name not in table.columns]
    if missing:
        made = manifest.commit or f"version {manifest.versions.get('boresight', 'unknown')}"
        raise BoresightError(
            f"{folder}: columns {', '.join(missing)} are missing; the run was stored by boresight {made}:"
            f" read it with that, or run it again: boresight run {manifest.name}"
        )
    return table.sort_values(list(keys), kind="stable").reset_index(drop=True)


def _is_text(column: str) -> bool | None:
    """Tell whether a column holds texts; ``image`` is a name in rows, a number elsewhere."""
    return None if column == "image" else column in _TEXTS

"""A stored run, read from its folder: the only input of a report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, field_validator

from boresight.reports.schema.column import names
from boresight.reports.schema.tables import ALL_ROW_COLUMNS, TABLES, columns_of, kind_schema, layout, refuse_older
from boresight.scenarios.checksums import refuse_damaged
from boresight.scenarios.errors import BoresightError, printable
from boresight.scenarios.known import Known, known_on_board
from boresight.scenarios.parquet import read_frame
from boresight.scenarios.reading import held_to, plain_json, unreadable
from boresight.scenarios.spec.scenario import ScenarioSpec

_NOT_REPORTED = ("said", "tracebacks")
_SOLVED = "solved"
TRIAL_KEY = ["scenario", "estimator", "trial"]
"""Columns that identify a row: one trial of one method."""


class StoredProduct(BaseModel):
    """Manifest entry of a product that was built before the trials, such as a landmark data base.

    ``scenario`` and ``estimator`` name its user, ``folder`` the product: one that several share has one folder. Empty
    where the manifest does not give them. ``database`` is the number of the data base that it belongs to.
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


class StoredShape(BaseModel):
    """Manifest entry of the shape that an estimator holds on board: facets, and bytes of vertices and facets."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    scenario: str
    estimator: str
    facets: int
    bytes: int


class GridAxis(BaseModel):
    """An axis of a campaign's grid: the names of its levels, the reference first, and their values if they have any."""

    model_config = ConfigDict(frozen=True)

    name: str
    label: str
    levels: tuple[str, ...]
    values: tuple[float, ...] | None = None


class ScenarioLevels(BaseModel):
    """Position of a scenario in a grid: the scenario that it varies, and its level of each axis."""

    model_config = ConfigDict(frozen=True)

    name: str
    base: str
    levels: Mapping[str, str]


class ScenarioGrid(BaseModel):
    """A campaign's grid: its axes, and its scenarios in order, the reference first."""

    model_config = ConfigDict(frozen=True)

    design: str
    axes: tuple[GridAxis, ...]
    scenarios: tuple[ScenarioLevels, ...]


class StoredRequirement(BaseModel):
    """A requirement, the labels of those that must meet it and the scenarios in which; empty: all."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    that: str
    estimators: tuple[str, ...] = ()
    scenarios: tuple[str, ...] = ()


class Manifest(BaseModel):
    """The keys of ``manifest.json`` that a report needs; further keys are ignored.

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
    requirements: tuple[StoredRequirement, ...] = ()
    looked: bool = False
    command: str = ""
    notes: tuple[str, ...] = ()
    embedded: tuple[str, ...] = ()
    draft: float = 1.0
    products: tuple[StoredProduct, ...] = ()
    shapes: tuple[StoredShape, ...] | None = None
    grid: ScenarioGrid | None = None
    campaign: Mapping[str, Any] = {}

    @property
    def experiment(self) -> str:
        """The kind of its trials; empty where the manifest has none."""
        return str(self.campaign.get("experiment", ""))

    @field_validator("scenarios")
    @classmethod
    def _have_sections(cls, scenarios: Mapping[str, Mapping[str, Any]]) -> Mapping[str, Mapping[str, Any]]:
        for name, spec in scenarios.items():
            for key in ("images", "sequence"):
                if not isinstance(spec.get(key) or {}, Mapping):
                    raise ValueError(f"{name}.{key} is not a section")  # noqa: TRY004  pydantic wants a ValueError
        return scenarios


@dataclass(frozen=True, eq=False)
class RunData:
    """The tables of a run, sorted by trial, scenario and estimator; a table that was not stored is empty.

    Parameters
    ----------
    folder
        Folder of the run.
    manifest
        Its manifest.
    rows
        One row per trial and estimator; ``image`` is '' where the image was rendered, ``n_landmarks`` is
        NaN where the estimator does not count landmarks, ``database`` where it has no data base.
    tables
        The other tables of the run by their names (`reports.schema.tables.TABLES`); see `table`.
    """

    folder: Path
    manifest: Manifest
    rows: pd.DataFrame
    tables: Mapping[str, pd.DataFrame] = field(default_factory=dict)

    def table(self, name: str) -> pd.DataFrame:
        """Return a table of the run; one that was not stored is empty, with its columns.

        Raises
        ------
        BoresightError
            If no table has that name, or a file of it cannot be read.
        """
        if name not in TABLES:
            raise BoresightError(f"{self.folder}: no table is called {name!r}; there are: {', '.join(TABLES)}")
        if name == "rows":
            return self.rows
        if name in _NOT_REPORTED:
            return _read_table(self.folder / name, self.manifest.experiment)
        return self.tables[name] if name in self.tables else pd.DataFrame(columns=list(names(columns_of(name))))

    @cached_property
    def image_of_trial(self) -> pd.Series:
        """Names of images of a set by scenario and trial, '' where there is no set."""
        return self.rows.drop_duplicates(["scenario", "trial"]).set_index(["scenario", "trial"])["image"]

    @cached_property
    def databases(self) -> int:
        """Count the data bases that estimators used in turn, trial by trial."""
        return len(self.rows["database"].dropna().unique())

    @cached_property
    def database_of_trial(self) -> pd.Series:
        """Numbers of data bases by `TRIAL_KEY`, NaN where an estimator has none."""
        return self.rows.set_index(TRIAL_KEY)["database"]

    @cached_property
    def known(self) -> Mapping[str, Known] | None:
        """Exact knowledge on board by scenario; None where this version of boresight cannot read a scenario."""
        if self.specs is None:
            return None
        return {name: known_on_board(spec, self.manifest.experiment) for name, spec in self.specs.items()}

    @cached_property
    def specs(self) -> Mapping[str, ScenarioSpec] | None:
        """Scenarios by name; None where this version of boresight cannot read one."""
        try:
            return {name: ScenarioSpec.model_validate(dict(spec)) for name, spec in self.manifest.scenarios.items()}
        except ValueError:
            return None

    def of(self, scenario: str, estimator: str, name: str = "rows") -> pd.DataFrame:
        """Return the lines of one scenario and estimator in a table of the run, in their order; see `table`."""
        if name not in self._grouped:
            whole = self.table(name)
            self._grouped[name] = whole, whole.groupby(["scenario", "estimator"], sort=False).indices
        key = name, scenario, estimator
        if key not in self._lines:
            whole, places = self._grouped[name]
            self._lines[key] = whole.iloc[places.get((scenario, estimator), [])]
        # A view of it: a column that somebody adds stays theirs.
        return self._lines[key].copy(deep=False)

    def place_in_rows(self, scenario: str, estimator: str) -> NDArray[np.integer]:
        """Return the positions in `rows` (n,) of one scenario and estimator."""
        self.of(scenario, estimator)
        return np.asarray(self._grouped["rows"][1].get((scenario, estimator), []), dtype=np.int64)

    def solved(self, scenario: str, estimator: str) -> pd.DataFrame:
        """Return the rows of one scenario and estimator with an estimate."""
        if _SOLVED not in self._grouped:
            whole = self.rows[self.rows["status"] == "ok"]
            self._grouped[_SOLVED] = whole, whole.groupby(["scenario", "estimator"], sort=False).indices
        return self.of(scenario, estimator, _SOLVED)

    @cached_property
    def _grouped(self) -> dict[str, tuple[pd.DataFrame, Mapping[Any, Any]]]:
        """Tables, and the numbers of their lines by scenario and estimator: grouped once, as a run may have many."""
        return {}

    @cached_property
    def _lines(self) -> dict[tuple[str, str, str], pd.DataFrame]:
        """Lines of a table, a scenario and an estimator that were asked for, as most are again and again."""
        return {}

    @cached_property
    def has_images(self) -> bool:
        """Whether images of a set were read."""
        return bool((self.image_of_trial != "").any())

    def pairs(self) -> list[tuple[str, str]]:
        """List (scenario, estimator) in the order in which the rows name them."""
        return list(self.rows[["scenario", "estimator"]].drop_duplicates().itertuples(index=False, name=None))

    def posed_pairs(self) -> list[tuple[str, str]]:
        """List the pairs that estimate poses: their trials have a prior."""
        posed = self.rows[self.rows["prior_position_error_m"].notna()]
        return list(posed[["scenario", "estimator"]].drop_duplicates().itertuples(index=False, name=None))

    def place_of(self, label: str) -> int:
        """Return the place of an estimator in the campaign; one that it does not name comes after all others."""
        labels = list(map(str, self.manifest.estimators))
        return labels.index(label) if label in labels else len(labels)

    def progress(self) -> tuple[int, int]:
        """Count the trials that are stored and those that were asked for, over all scenarios."""
        done = len(self.rows[["scenario", "trial"]].drop_duplicates())
        return done, self.manifest.trials * len(self.manifest.scenarios)

    def truth_name(self, scenario: str) -> str:
        """Name the pose that the rows are scored against: that of a real image set, or ``truth``."""
        images = self.manifest.scenarios.get(scenario, {}).get("images") or {}
        return str(images.get("truth", "truth"))


def value_at(spec: Mapping[str, Any], key: str, missing: object = None) -> object:
    """Look a dotted key of a scenario up; ``missing`` where there is none."""
    value: object = spec
    for part in key.split("."):
        if not isinstance(value, Mapping) or part not in value:
            return missing
        value = value[part]
    return value


def in_order_of(rows: pd.DataFrame, table: pd.DataFrame, columns: list[str]) -> pd.DataFrame:
    """Return columns of numbers of a detail table in the order and with the index of rows; NaN where a row has none.

    Of several lines for a trial the first counts.
    """
    lines = table.drop_duplicates(TRIAL_KEY).set_index(TRIAL_KEY)[columns]
    return lines.reindex(pd.MultiIndex.from_frame(rows[TRIAL_KEY])).set_axis(rows.index).astype(float)


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
    kind = manifest.experiment
    tables = {name: _read_table(folder / name, kind) for name in TABLES if name not in _NOT_REPORTED}
    rows = tables.pop("rows")
    if rows.empty:
        raise BoresightError(f"{folder}/rows: no finished trial is stored; continue the run first")
    unknown = sorted(set(rows["scenario"]) - manifest.scenarios.keys())
    if unknown:
        raise BoresightError(f"{folder}/rows: have the scenario {unknown[0]}, which the manifest does not name")
    return RunData(folder, manifest, _with_all_columns(rows), tables)


def _printable(texts: pd.Series, kept: str = "") -> pd.Series:
    """Escape control characters but those kept: a text of a method or of a damaged file must not steer a terminal."""
    steering = {
        text: "".join(char if char in kept else printable(char) for char in text)
        for text in texts.dropna().unique()
        if not text.isprintable()
    }
    return texts.replace(steering) if steering else texts


def _with_all_columns(rows: pd.DataFrame) -> pd.DataFrame:
    """Give rows the columns of all kinds of trial: NaN, or '' for texts, where this kind has none."""
    rows = rows.reindex(columns=[*rows, *(name for name in names(ALL_ROW_COLUMNS) if name not in rows)])
    whole = {name: rows[name].astype(float) for name in ("n_landmarks", "database")}
    texts = {name: rows[name].astype(object).where(rows[name].notna(), "").astype(str) for name in ("image", "reason")}
    return rows.assign(**whole, **texts)


def _read_manifest(path: Path) -> Manifest:
    try:
        found = plain_json(path)
        refuse_older(found, path)
        manifest = held_to(Manifest, _without_control(found))
    except FileNotFoundError:
        raise BoresightError(f"{path}: not found; is {path.parent} the folder of a run?") from None
    except (OSError, ValueError) as error:
        raise unreadable(path, "a manifest", error) from error
    try:
        kind_schema(manifest.experiment)
    except BoresightError as error:
        raise BoresightError(f"{path}: campaign.{error}") from None
    return manifest


def _without_control(found: Any) -> Any:
    """Escape control characters, but for line breaks, in all texts of a JSON value."""
    if isinstance(found, dict):
        return {_without_control(key): _without_control(value) for key, value in found.items()}
    if isinstance(found, list):
        return [_without_control(value) for value in found]
    return "\n".join(map(printable, found.split("\n"))) if isinstance(found, str) else found


def _read_table(folder: Path, experiment: str) -> pd.DataFrame:
    """Read a Parquet folder, in an order that does not depend on how its parts were written."""
    columns = names(columns_of(folder.name, experiment))
    if not folder.is_dir() or not any(folder.glob("*.parquet")):
        return pd.DataFrame(columns=list(columns))
    table = read_frame(folder, layout(folder.name, experiment))
    missing = [name for name in columns if name not in table.columns]
    if missing:
        raise BoresightError(
            f"{folder}: columns {', '.join(missing)} are missing: run the campaign again, into another folder (--out)"
        )
    for column in columns_of(folder.name, experiment):
        if column.type == pa.string():
            table[column.name] = _printable(table[column.name], "\n" if folder.name in _NOT_REPORTED else "")
    keys = [name for name in ("trial", "scenario", "estimator") if name in columns]
    return table.sort_values(keys, kind="stable").reset_index(drop=True)

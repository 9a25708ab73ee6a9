"""A stored run with known numbers: written as Parquet, so that the reports read what a store would hold."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from reports.build import ReportFiles, write_report

SCENARIO, ESTIMATOR = "itokawa", "landmark-harris"


def pose_error(vector, attitude_deg):
    return {
        "position_error_m": float(np.linalg.norm(vector)),
        "attitude_error_deg": float(attitude_deg),
        **{f"position_error_{axis}_m": float(x) for axis, x in zip("xyz", vector, strict=True)},
    }


@dataclass
class RunBuilder:
    """Collects trials and writes them as a run folder."""

    folder: Path
    manifest: dict[str, object] = field(default_factory=dict)
    tables: dict[str, list[dict[str, object]]] = field(default_factory=dict)

    def add(self, table, **row):
        self.tables.setdefault(table, []).append(row)

    def trial(self, trial, prior, final, *, estimator=ESTIMATOR, centroid=None, image="", n_landmarks=0, reason=""):
        """Add one trial; ``prior`` and ``final`` are (vector_m, attitude_deg), ``final`` None for a failure."""
        key = {"trial": trial, "scenario": SCENARIO, "estimator": estimator}
        nothing = dict.fromkeys(pose_error(np.zeros(3), 0), np.nan)
        self.add(
            "rows",
            **key,
            status="ok" if final else "failed",
            reason=reason,
            image=image,
            n_landmarks=n_landmarks,
            **{f"prior_{name}": value for name, value in pose_error(*prior).items()},
            **(pose_error(*final) if final else nothing),
        )
        for stage, error in (("prior", prior), ("centroid", centroid), ("recognition", final)):
            if centroid and error:
                self.add("stages", **key, stage=stage, **pose_error(*error))

    def write(self, **manifest) -> Path:
        for name, rows in self.tables.items():
            (self.folder / name).mkdir(parents=True, exist_ok=True)
            pd.DataFrame(rows).to_parquet(self.folder / name / "block-0.parquet")
        trials = len({row["trial"] for row in self.tables.get("rows", [])})
        whole = {
            "name": "rowell2015-simulated",
            "title": "Landmarks on <Itokawa>",
            "seed": 7,
            "trials": trials,
            "scenarios": {SCENARIO: {"name": SCENARIO}},
            "estimators": ["prior", ESTIMATOR],
            "versions": {"boresight": "0.1.0"},
            "machine": {"cores": 2},
            "credits": [],
        }
        self.folder.mkdir(parents=True, exist_ok=True)
        (self.folder / "manifest.json").write_text(json.dumps(whole | manifest), encoding="utf-8")
        return self.folder


@pytest.fixture
def builder(tmp_path: Path) -> RunBuilder:
    return RunBuilder(tmp_path / "run")


@pytest.fixture
def full_run(builder: RunBuilder) -> Callable[..., Path]:
    """A run like the paper's: 120 trials of uniform priors, with every table."""
    return lambda **manifest: write_full_run(builder, **manifest)


@pytest.fixture(scope="session")
def report(tmp_path_factory: pytest.TempPathFactory) -> ReportFiles:
    """The report of that run, made once for the tests that only read it."""
    builder = RunBuilder(tmp_path_factory.mktemp("report") / "run")
    return write_report(write_full_run(builder, commit="abc123"))


def write_full_run(builder: RunBuilder, **manifest) -> Path:
    rng = np.random.default_rng(20150709)
    for trial in range(120):
        prior = (rng.uniform(-1, 1, 3) * [50, 50, 5], rng.uniform(0, 2))
        final = (rng.normal(0, [14, 14, 12]), abs(rng.normal(0, 0.8))) if trial % 20 else None
        centroid = (rng.normal(0, [15, 15, 3]), prior[1])
        reason = "" if final else "3 landmarks | 4 are needed"
        builder.trial(trial, prior, final, centroid=centroid, n_landmarks=int(rng.poisson(55)), reason=reason)
        builder.trial(trial, prior, prior, estimator="prior")
        key = {"trial": trial, "scenario": SCENARIO, "estimator": ESTIMATOR}
        for landmark in range(20):
            error, square = rng.gamma(2, 1.2), rng.chisquare(3)
            builder.add("landmarks", **key, landmark=landmark, error_m=error, chi_square=square)
        for stage, seconds in (("mesh_rendering", 0.03), ("recognition", 1.5)):
            builder.add("timings", **key, stage=stage, seconds=seconds * rng.uniform(0.9, 1.1))
    product = {"kind": "landmark-database", "n_landmarks": 412, "n_facets": 820}
    return builder.write(**{"report": "rowell2015-simulated", "products": [product]} | manifest)

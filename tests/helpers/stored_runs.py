"""Stored runs with known numbers: written as Parquet, so that the reports read what a store would hold."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa

from boresight.reports.schema.tables import FORMAT_VERSION, columns_of
from boresight.scenarios.checksums import checksum_text

KIND_OF = {
    "epochs": "sequence",
    "crater_matches": "crater-matching",
    "crater_images": "crater-detection",
    "surveyed_images": "image-survey",
    "navigation": "crater-navigation",
    "orbits": "orbit-determination",
}
"""The kind of trial that stores a table."""
SCENARIO, ESTIMATOR = "itokawa", "landmark-harris"


def pose_error(vector, attitude_deg):
    return {
        "position_error_m": float(np.linalg.norm(vector)),
        "attitude_error_deg": float(attitude_deg),
        **{f"position_error_{axis}_m": float(x) for axis, x in zip("xyz", vector, strict=True)},
    }


def seal(run: Path) -> Path:
    """Write the checksums of the tables as they are now; return the run folder."""
    (run / "checksums").mkdir(exist_ok=True)
    for sums in (run / "checksums").glob("*.sha256"):
        sums.unlink()
    for block in (run / "rows").glob("*.parquet"):
        files = {str(path.relative_to(run)): path.read_bytes() for path in sorted(run.glob(f"*/{block.name}"))}
        (run / "checksums" / f"{block.stem}.sha256").write_text(checksum_text(files))
    return run


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
        kind = next((kind for table, kind in KIND_OF.items() if table in self.tables), "single-image")
        for name, rows in self.tables.items():
            (self.folder / name).mkdir(parents=True, exist_ok=True)
            table = pd.DataFrame(rows)
            for column in columns_of(name, kind):
                if column.name not in table:
                    table[column.name] = "" if column.type == pa.string() else np.nan
            table.to_parquet(self.folder / name / "block-0.parquet")
        trials = len({row["trial"] for row in self.tables.get("rows", [])})
        whole = {
            "format": FORMAT_VERSION,
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
        whole = whole | manifest
        whole["campaign"] = {"experiment": kind, **whole.get("campaign", {})}
        self.folder.mkdir(parents=True, exist_ok=True)
        (self.folder / "manifest.json").write_text(json.dumps(whole), encoding="utf-8")
        return seal(self.folder)


def find(records, **wanted):
    """Return the first record whose fields equal ``wanted`` (``reference`` is '' unless given); None without one."""
    wanted = {"reference": "", **wanted}
    return next((r for r in records if all(getattr(r, name) == value for name, value in wanted.items())), None)

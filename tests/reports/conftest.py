"""A stored run like the paper's, and what adds to it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from stored_runs import ESTIMATOR, SCENARIO, RunBuilder

from boresight.reports.pages.build import ReportFiles, write_report


@pytest.fixture
def builder(tmp_path: Path) -> RunBuilder:
    return RunBuilder(tmp_path / "run")


@pytest.fixture
def full_run(builder: RunBuilder) -> Callable[..., Path]:
    """A run like the paper's: 120 trials of uniform priors, with every table."""
    return lambda **manifest: write_full_run(builder, **manifest)


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Write an empty file for each figure, for tests that read texts alone: drawing takes most of a report's time."""
    leave_undrawn(monkeypatch)


def leave_undrawn(patch: pytest.MonkeyPatch) -> None:
    patch.setattr("boresight.reports.figures.style.render", lambda *_: b"")
    patch.setattr("boresight.reports.pages.build.add_provenance", lambda *_: None)


@pytest.fixture(scope="session")
def unfinished(tmp_path_factory: pytest.TempPathFactory) -> ReportFiles:
    """The report of 120 of its 6000 trials, with a commit, a command and credits, without drawn figures."""
    builder = RunBuilder(tmp_path_factory.mktemp("unfinished") / "run")
    told = {"commit": "abc123", "command": "boresight run x --set 'a=<b>'", "credits": ["ESA/Rosetta/NAVCAM, CC BY"]}
    with pytest.MonkeyPatch.context() as patch:
        leave_undrawn(patch)
        return write_report(write_full_run(builder, trials=6000, **told))


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

"""Estimators of third parties, found by their entry points: whatever they do ends in a row and stops no run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from tiny_campaign import RESULTS, SCENE, boresight, compute, files, run, write_campaign

from boresight.campaign.cli import main
from boresight.campaign.store import RunFolder

TRIALS = 12
# One estimator for each way to break the contract; `answer` gets the prior pose and returns what `estimate` returns.
MODULE = """
import numpy as np
from boresight.estimators.contract import Estimate, Stage
from boresight.scenarios.geometry import Pose

class Base:
    version = 1
    @classmethod
    def from_options(cls, options, assets):
        return cls()
    def estimate(self, observation, *, rng):
        return self.answer(observation.frame.prior_T_cam_body, rng)

class Good(Base):
    name = "good"
    def answer(self, prior, rng):
        pose = prior.perturbed(np.zeros(3), rng.normal(size=3))
        return Estimate("ok", pose=pose, diagnostics={"luck": rng.random()})

class Raises(Base):
    name = "raises"
    def answer(self, prior, rng):
        if rng.random() < 0.5:
            return Estimate("ok", pose=prior)
        return 1 / 0

class Nan(Base):
    name = "nan"
    def answer(self, prior, rng):
        return Estimate("ok", pose=Pose(prior.rotation, [np.nan, 0, 0]))

class NanRotation(Base):
    name = "nan-rotation"
    def answer(self, prior, rng):
        return Estimate("ok", pose=Pose(np.full((3, 3), np.nan), prior.translation_m))

class Mirror(Base):
    name = "mirror"
    def answer(self, prior, rng):
        return Estimate("ok", pose=Pose(-prior.rotation, prior.translation_m))

class Unnormalised(Base):
    name = "unnormalised"
    def answer(self, prior, rng):
        return Estimate("ok", pose=Pose(1.01 * prior.rotation, prior.translation_m))

class NoPose(Base):
    name = "no-pose"
    def answer(self, prior, rng):
        return Estimate("ok", covariance=np.eye(6))

class Nothing(Base):
    name = "nothing"
    def answer(self, prior, rng):
        return None

class Maybe(Base):
    name = "maybe"
    def answer(self, prior, rng):
        return Estimate("maybe", pose=prior)

class Silent(Base):
    name = "silent"
    def answer(self, prior, rng):
        return Estimate("failed")

class NanStage(Base):
    name = "nan-stage"
    def answer(self, prior, rng):
        stages = (Stage("half", Pose(prior.rotation, [0, 0, np.inf])),)
        return Estimate("failed", reason="half way", stages=stages)

class NanNumber(Base):
    name = "nan-number"
    def answer(self, prior, rng):
        return Estimate("ok", pose=prior, diagnostics={"chi2": np.nan})

class NoCovariance(Base):
    name = "no-covariance"
    def answer(self, prior, rng):
        return Estimate("ok", pose=prior, covariance=np.eye(3))

class HalfTable(Base):
    name = "half-table"
    def answer(self, prior, rng):
        return Estimate("ok", pose=prior, details={"landmarks": {"landmark": np.arange(3), "u_px": np.ones(3)}})

class FlatLandmark(Base):
    name = "flat-landmark"
    def answer(self, prior, rng):
        names = ("u_px", "v_px", "x_m", "y_m", "z_m", "sxx_m2", "sxy_m2", "sxz_m2", "syy_m2", "syz_m2", "szz_m2")
        table = {"landmark": np.arange(2), **{name: np.zeros(2) for name in names}}
        return Estimate("ok", pose=prior, details={"landmarks": table})

class Huge(Base):
    name = "huge"
    def answer(self, prior, rng):
        return Estimate("ok", pose=Pose(prior.rotation, [0, 0, 1e200]))

class Quits(Base):
    name = "quits"
    def answer(self, prior, rng):
        raise SystemExit(0)

class Changes(Base):
    name = "changes"
    def estimate(self, observation, *, rng):
        observation.frame.image[:] = 0
        return Estimate("failed", reason="dark")
"""
RUBBISH = {
    "nan": "translation [nan",
    "nan-rotation": "rotation off by nan",
    "mirror": "is not rigid",
    "unnormalised": "is not rigid: rotation off by 2.0e-02",
    "no-pose": "an ok estimate has no pose",
    "nothing": "NoneType",
    "maybe": "status is 'maybe', not ok or failed",
    "silent": "gives as its reason ''",
    "nan-stage": "the pose after half is not rigid",
    "nan-number": "diagnostics: chi2 is nan",
    "no-covariance": "a covariance of shape (3, 3)",
    "half-table": "columns are missing: v_px, x_m",
    "flat-landmark": "a covariance is singular",
    "huge": "translation [0.e+000 0.e+000 1.e+200]",
    "quits": "SystemExit: 0",
    "changes": "assignment destination is read-only",
}


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install a package with these estimators, as pip would leave it."""
    folder = tmp_path_factory.mktemp("site")
    (folder / "thirdparty.py").write_text(MODULE)
    info = folder / "thirdparty-2.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: thirdparty\nVersion: 2.0\n")
    names = {"good": "Good", "raises": "Raises", **{n: n.title().replace("-", "") for n in RUBBISH}}
    lines = [f"{name} = thirdparty:{attribute}" for name, attribute in names.items()]
    (info / "entry_points.txt").write_text("\n".join(["[boresight.estimators]", *lines]) + "\n")
    return folder


def campaign(folder: Path, *estimators: str) -> Path:
    text = f"scenarios: [scene]\nestimators: [prior, {', '.join(estimators)}]\ntrials: {TRIALS}\nseed: 5\n"
    return write_campaign(folder, text)


def test_an_estimator_that_raises_costs_its_own_rows_alone(package, tmp_path):
    file, out = campaign(tmp_path, "good", "raises"), tmp_path / "run"
    done = boresight("run", file, "--jobs", 2, "--out", out, PYTHONPATH=str(package))
    assert done.returncode == 3, done.stderr
    rows = pd.read_parquet(out / "rows")
    assert len(rows) == 3 * TRIALS
    errors = rows[rows["status"] == "error"]
    assert set(errors["estimator"]) == {"raises"}
    assert 0 < len(errors) < TRIALS
    assert set(errors["reason"]) == {"the estimator raised ZeroDivisionError: division by zero"}
    assert errors["position_error_m"].isna().all()
    assert errors["prior_position_error_m"].notna().all()
    traces = pd.read_parquet(out / "tracebacks")
    pd.testing.assert_frame_equal(
        traces[["trial", "estimator"]], errors[["trial", "estimator"]].reset_index(drop=True), check_dtype=False
    )
    assert traces["traceback"].str.contains(r"(?s)in answer\n.*return 1 / 0\n.*ZeroDivisionError", regex=True).all()


def test_rows_of_a_raising_estimator_are_as_reproducible_as_any(package, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(package))
    file = campaign(tmp_path, "good", "raises")
    for name in ("first", "second"):
        compute(file, tmp_path / name, TRIALS)
    assert files(tmp_path / "first", *RESULTS, "tracebacks") == files(tmp_path / "second", *RESULTS, "tracebacks")
    luck = pd.read_parquet(tmp_path / "first" / "diagnostics")["value"]
    assert len(set(luck)) == TRIALS, "each trial has its own random numbers"


def test_rubbish_is_an_error_with_a_traceback_and_the_others_go_on(package, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(package))
    out = tmp_path / "run"
    compute(campaign(tmp_path, "good", *RUBBISH), out, TRIALS)
    rows, traces = (pd.read_parquet(out / name) for name in ("rows", "tracebacks"))
    assert (rows["estimator"].value_counts() == TRIALS).all()
    statuses = rows.groupby("estimator")["status"].unique().map(list).to_dict()
    assert statuses == {"prior": ["ok"], "good": ["ok"], **{name: ["error"] for name in RUBBISH}}
    for name, message in RUBBISH.items():
        said = traces[traces["estimator"] == name]["traceback"]
        assert len(said) == TRIALS
        assert said.str.contains(message, regex=False).all(), f"{name}: {said.iloc[0]}"
        reasons = rows[rows["estimator"] == name]["reason"]
        assert reasons.str.match("the estimator (raised|returned an invalid result: ).*[a-z]").all(), reasons.iloc[0]
    numbers = rows.select_dtypes("number")
    assert not np.isinf(numbers).any(axis=None)
    doubtful = [column for column in numbers if column.endswith(("_sigma_m", "_sigma_deg", "_bound_m", "_bound_deg"))]
    given = numbers.drop(columns=["nees", "database", *doubtful])
    # An estimator may have no covariance and no data base.
    assert given[rows["status"] == "ok"].notna().all(axis=None)
    assert not {"stages", "landmarks"} & {path.name for path in out.iterdir()}, (
        "nothing of a refused estimate is stored"
    )


def test_the_exit_code_tells_of_errors_also_where_all_is_stored(package, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(package))
    file, out = campaign(tmp_path, "raises"), tmp_path / "run"
    compute(file, out, TRIALS)
    assert run(file, out) == 3


def test_a_third_party_is_in_the_list(package, monkeypatch, capsys):
    monkeypatch.syspath_prepend(str(package))
    assert main(["list", "--all"]) == 0
    said = capsys.readouterr().out
    assert all(name in said for name in ("landmark-harris", "prior", "good", "raises"))


def test_a_version_of_a_third_party_is_part_of_the_run(package, tmp_path, monkeypatch, capsys):
    monkeypatch.syspath_prepend(str(package))
    file, out = campaign(tmp_path, "good"), tmp_path / "run"
    compute(file, out, TRIALS)
    monkeypatch.setattr("thirdparty.Good.version", 2)
    assert run(file, out) == 2
    assert "holds another run" in capsys.readouterr().err


@pytest.mark.parametrize("read_noise_e", [0, 60])
def test_black_images_are_failures_with_a_reason_and_no_errors(tmp_path, read_noise_e):
    scene = SCENE + f"detector: {{exposure_s: 1.0e-9, read_noise_e: {read_noise_e}}}\n"
    file, out = write_campaign(tmp_path, scene=scene), tmp_path / "run"
    assert run(file, out, "--trials", TRIALS, "--worst", 0) == 0, "a failure is a result, not a fault"
    rows = RunFolder(out).table("rows")
    found = rows[rows["estimator"] == "landmark-harris"]
    assert set(found["status"]) == {"failed"}
    assert (found["reason"] != "").all()
    assert found["reason"].str.contains("the image is black").mean() > 0.5
    assert found["position_error_m"].isna().all()
    assert (rows[rows["estimator"] == "prior"]["status"] == "ok").all()
    assert not (out / "tracebacks").exists()
    assert len(pd.read_csv(out / "report" / "failures.csv")) == TRIALS

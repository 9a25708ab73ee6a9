"""Methods of third parties, found by their entry points: whatever they do ends in rows and stops no command."""

from __future__ import annotations

import functools
import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from page_blocks import blocks_of
from third_party import install, install_answers
from tiny_campaign import RESULTS, SCENE, boresight, compute, files, run, write_campaign
from undrawn import undrawn

from boresight.campaign.cli import main
from boresight.campaign.pool import workers
from boresight.campaign.store import RunFolder
from boresight.estimators.registry import estimator_class
from boresight.reports.run.data import read_run
from boresight.scenarios.errors import BoresightError

TRIALS = 12
PAGE = Path(__file__).parents[2] / "docs" / "howto" / "estimator-of-sequences.md"
# name: (what an estimator of images returns, what its traceback says). test_faulty_methods has all that is refused;
# here is what may do harm on its way to a row.
IMAGES = {
    "matrix": ('Estimate("ok", pose=np.eye(4))', "a ndarray is no Pose"),
    "falls": ('Estimate("ok", pose=prior, stages=Falls())', "stages are a Falls, not a tuple"),
    "endless": ('Estimate("failed", "on and on", stages=endless(prior))', "stages are a generator, not a tuple"),
    "objects": (
        'Estimate("ok", pose=prior, details={"mine": {"a": np.array([object()])}})',
        "mine: a is no array of numbers or texts",
    ),
    "quits": ("quits()", "SystemExit: 0"),
    "changes": ("observation.frame.image.fill(0)", "read-only"),
}
# Those that keep the contract; nothing can be drawn at poses behind the body or in it.
SOUND = {
    "good": (
        'Estimate("ok", pose=prior.perturbed(np.zeros(3), rng.normal(size=3)), diagnostics={"luck": rng.random()})'
    ),
    "raises": 'Estimate("ok", pose=prior) if rng.random() < 0.5 else 1 / 0',
    "behind": 'Estimate("ok", pose=Pose(R, -t), details={"landmarks": LANDMARKS})',
    "inside": 'Estimate("ok", pose=Pose(R, np.zeros(3)), details={"landmarks": LANDMARKS})',
}
IMAGE_METHODS = """
import numpy as np
from boresight.estimators.contract import Estimate, Stage
from boresight.scenarios.geometry import Pose

class Falls:
    def __len__(self):
        return 1
    def __iter__(self):
        raise SystemExit("fell")

def endless(prior):
    while True:
        yield Stage("again", prior)

def quits():
    raise SystemExit(0)

NAMES = "u_px v_px x_m y_m z_m sxx_m2 sxy_m2 sxz_m2 syy_m2 syz_m2 szz_m2".split()
LANDMARKS = {"landmark": np.arange(2), **{name: np.full(2, float(name[1:3] in ("xx", "yy", "zz"))) for name in NAMES}}

class Method(Base):
    def estimate(self, observation, *, rng):
        prior = observation.frame.prior_T_cam_body
        return ANSWERS[self.name](observation, rng, prior, prior.rotation, prior.translation_m)

ANSWERS = {
"""
# What an estimator of sequences of n frames returns.
SEQUENCES = {
    "matrix": "ok(n, np.eye(4))",
    "generator": 'SequenceEstimate("failed", (frame for frame in ok(n).frames), "late")',
    "objects": 'SequenceEstimate("ok", (object(),) * n)',
}
SEQUENCE_METHODS = """
import numpy as np
from boresight.estimators.slam.contract import FrameEstimate, SequenceEstimate

NONE = np.zeros(0, np.int64), np.zeros((0, 3)), 0.1

def ok(n, position=np.ones(3)):
    return SequenceEstimate("ok", (FrameEstimate(position, None, *NONE),) * n)

class Method(Base):
    def follow(self, sequence):
        return ANSWERS[self.name](len(sequence.frames))

ANSWERS = {
"""
ORBITING = "extends: apophis-sphere-sequence\nsequence: {orbit: {revolutions: 0.05}}\n"


def lambdas(arguments: str, answers: dict[str, str]) -> str:
    return "".join(f'    "{name}": lambda {arguments}: {answer},\n' for name, answer in answers.items()) + "}\n"


IMAGE_METHODS += lambdas("observation, rng, prior, R, t", {n: a for n, (a, _) in IMAGES.items()} | SOUND)
SEQUENCE_METHODS += lambdas("n", SEQUENCES)


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    install_answers(folder, "estimators", IMAGE_METHODS)
    install_answers(folder, "sequence_estimators", SEQUENCE_METHODS)
    return folder


@pytest.fixture
def installed(package: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(package))


def campaign(folder: Path, *estimators: str, trials: int = TRIALS) -> Path:
    text = f"scenarios: [scene]\nestimators: [prior, {', '.join(estimators)}]\ntrials: {trials}\nseed: 5\n"
    return write_campaign(folder, text)


def test_an_estimator_that_raises_costs_its_own_rows_alone_and_is_as_reproducible_as_any(installed, tmp_path):
    file, out = campaign(tmp_path, "good", "raises"), tmp_path / "run"
    assert run(file, out) == 3
    rows = pd.read_parquet(out / "rows")
    assert len(rows) == 3 * TRIALS
    errors = rows[rows["status"] == "error"]
    assert set(errors["estimator"]) == {"raises"}
    assert 0 < len(errors) < TRIALS
    assert set(errors["reason"]) == {"the estimator raised ZeroDivisionError: division by zero"}
    assert errors["position_error_m"].isna().all()
    assert errors["prior_position_error_m"].notna().all()
    traces = pd.read_parquet(out / "tracebacks")
    assert read_run(out).table("tracebacks")["traceback"].tolist() == traces["traceback"].tolist()
    with pytest.raises(BoresightError, match=r"no table is called 'nonsense'; there are: rows, "):
        read_run(out).table("nonsense")
    pd.testing.assert_frame_equal(
        traces[["trial", "estimator"]], errors[["trial", "estimator"]].reset_index(drop=True), check_dtype=False
    )
    assert traces["traceback"].str.contains(r"(?s)in estimate\n.*else 1 / 0.*ZeroDivisionError", regex=True).all()
    luck = pd.read_parquet(out / "diagnostics")["value"]
    assert len(set(luck)) == TRIALS, "each trial has its own random numbers"
    compute(file, tmp_path / "second", TRIALS)
    assert files(tmp_path / "second", *RESULTS, "tracebacks") == files(out, *RESULTS, "tracebacks")
    assert run(file, out) == 3, "also where all is stored"


@pytest.mark.long
def test_workers_store_the_same_of_an_estimator_that_raises(package, installed, tmp_path):
    file, out = campaign(tmp_path, "good", "raises"), tmp_path / "run"
    done = boresight("run", file, "--jobs", 2, "--out", out, PYTHONPATH=f"{package}:{os.environ.get('PYTHONPATH', '')}")
    assert done.returncode == 3, done.stderr
    compute(file, tmp_path / "second", TRIALS)
    assert files(tmp_path / "second", *RESULTS, "tracebacks") == files(out, *RESULTS, "tracebacks")


def test_wrong_answers_are_errors_with_a_reason_and_the_others_go_on(installed, tmp_path):
    out = tmp_path / "run"
    assert run(campaign(tmp_path, "good", *IMAGES, trials=2), out) == 3
    rows, traces = (pd.read_parquet(out / name) for name in ("rows", "tracebacks"))
    assert (rows["estimator"].value_counts() == 2).all()
    statuses = rows.groupby("estimator")["status"].unique().map(list).to_dict()
    assert statuses == {"prior": ["ok"], "good": ["ok"], **{name: ["error"] for name in IMAGES}}
    for name, (_, message) in IMAGES.items():
        said = traces[traces["estimator"] == name]["traceback"]
        assert len(said) == 2
        assert said.str.contains(message, regex=False).all(), f"{name}: {said.iloc[0]}"
        what = "raised " if name in ("quits", "changes") else "returned an invalid result: "
        reasons = rows[rows["estimator"] == name]["reason"]
        assert reasons.str.match(f"the estimator {what}.*[a-z]").all(), reasons.iloc[0]
    numbers = rows.select_dtypes("number")
    assert not np.isinf(numbers).any(axis=None)
    doubtful = [column for column in numbers if column.endswith(("_sigma_m", "_sigma_deg", "_bound_m", "_bound_deg"))]
    given = numbers.drop(columns=["nees", "sight_nees", "database", *doubtful])
    # An estimator may have no covariance and no data base.
    assert given[rows["status"] == "ok"].notna().all(axis=None)
    assert not {"stages", "landmarks"} & {path.name for path in out.iterdir()}, "of a refused estimate"


def of_sequences(folder: Path, *estimators: str) -> Path:
    text = (
        f"title: R\nexperiment: sequence\nscenarios: [scene]\nestimators: [dead-reckoning, {', '.join(estimators)}]\n"
    )
    return write_campaign(folder, f"{text}trials: 1\nseed: 5\n", ORBITING)


def test_so_are_those_of_methods_for_sequences(installed, tmp_path):
    assert run(of_sequences(tmp_path, *SEQUENCES), tmp_path / "run") == 3
    rows = pd.read_parquet(tmp_path / "run" / "rows").set_index("estimator")
    assert rows.loc[list(SEQUENCES), "status"].eq("error").all()
    assert rows.loc[list(SEQUENCES), "reason"].str.startswith("the estimator returned an invalid result: ").all()
    assert rows.loc["dead-reckoning", "status"] == "ok"


@pytest.mark.parametrize("worst", [0, pytest.param(1, marks=pytest.mark.long)])
@pytest.mark.parametrize(
    "write", [lambda *names: campaign(*names, trials=1), of_sequences], ids=["images", "sequences"]
)
def test_every_command_reads_a_run_of_wrong_answers(installed, tmp_path, capsys, write, worst):
    """They are rows alone by now, so two are enough; one of them cannot even be looked at without harm."""
    harmful = "generator" if write is of_sequences else "falls"
    out = str(tmp_path / "run")
    assert run(write(tmp_path, "matrix", harmful), out, "--worst", worst) == 3
    for name in ("matrix", harmful):
        assert main(["inspect", out, "--trial", "0", "--estimator", name]) == 0
    assert not list(Path(out, "inspect").glob("*/estimate.json")), "nothing of it is kept as an estimate"
    assert main(["inspect", out, "--look", "--estimator", "matrix"]) in (0, 2)
    for command in ("compare", "export --to csv", "export --to latex", "export --to tum", "export --to colmap"):
        words = command.split()
        assert main([words[0], out, *words[1:], "--out", str(tmp_path / words[-1])]) in (0, 2)
    assert main(["status", out]) == 0
    said = capsys.readouterr()
    assert "Traceback" not in said.out + said.err
    assert len(said.err.splitlines()) <= 8, "at most a line for each command"


def test_what_keeps_the_contract_and_is_absurd_is_drawn_as_far_as_it_can_be(installed, tmp_path):
    names, out = ("behind", "inside"), tmp_path / "run"
    assert run(campaign(tmp_path, *names, trials=1), out) == 0
    assert main(["inspect", str(out), "--trial", "0"]) == 0
    drawn = {name: {path.stem for path in (out / "inspect" / f"scene_{name}_0000000").glob("*.png")} for name in names}
    assert drawn == {"behind": {"poses"}, "inside": {"poses"}}, "landmarks behind the camera have no place in an image"
    page = (out / "inspect" / "scene_inside_0000000" / "index.html").read_text()
    assert "Nothing can be rendered at the estimate" in page


def test_a_third_party_is_in_the_list(installed, capsys):
    assert main(["list", "--all"]) == 0
    said = capsys.readouterr().out
    assert all(name in said for name in ("landmark-harris", "prior", "good", "raises"))


def test_a_version_of_a_third_party_is_part_of_the_run(installed, tmp_path, monkeypatch, capsys):
    file, out = campaign(tmp_path, "good"), tmp_path / "run"
    compute(file, out, 1)
    monkeypatch.setattr(estimator_class("good"), "version", 2)
    assert run(file, out) == 2
    assert "holds another run" in capsys.readouterr().err


def test_the_estimator_of_the_page_runs_next_to_ours_by_file_and_by_entry_point(cache, tmp_path, monkeypatch, capsys):
    blocks = {block.file: block.body for block in blocks_of(PAGE.read_text(encoding="utf-8")) if block.file}
    install(tmp_path, "sequence_estimators", "my_slam", blocks["my_slam.py"], {"drift": "Drift"}, monkeypatch)
    text = blocks["my_orbits.yaml"].replace("my_slam.py:Drift", "my_slam.py:Drift, drift")
    (tmp_path / "my_orbits.yaml").write_text(text, encoding="utf-8")
    assert main(["list", "--all"]) == 0
    assert "drift" in capsys.readouterr().out
    out = tmp_path / "out"
    short = ["--set", "sequence.orbit.revolutions=0.2", "--trials", "2", "--jobs", "1", "--worst", "0"]
    assert main(["run", str(tmp_path / "my_orbits.yaml"), *short, "--out", str(out)]) == 0
    rows = pd.read_parquet(out / "rows")
    assert rows.groupby("estimator").size().to_dict() == {"Drift": 2, "drift": 2, "fixed-lag": 2}
    by_file, by_name = (rows[rows["estimator"] == name] for name in ("Drift", "drift"))
    assert (by_file["status"] == "ok").all()
    assert by_file["position_error_m"].gt(10.0).all()
    assert by_file["position_error_m"].tolist() == by_name["position_error_m"].tolist()


MOVES = """
import os
from boresight.estimators.contract import Estimate

class Moves:
    name, version = "moves", 1
    @classmethod
    def from_options(cls, options, assets):
        os.chdir("/")
        return cls()
    def estimate(self, observation, *, rng):
        os.chdir("/proc")
        return Estimate("ok", pose=observation.frame.prior_T_cam_body)
"""


@pytest.mark.parametrize(("jobs", "out"), [(1, "here"), pytest.param(2, "runs/here", marks=pytest.mark.long)])
def test_a_method_that_changes_the_directory_moves_no_file(tmp_path, monkeypatch, capsys, jobs, out):
    site, here = tmp_path / "site", tmp_path / "campaign"
    install(site, "estimators", "moving", MOVES, {"moves": "Moves"}, monkeypatch)
    write_campaign(here, "scenarios: [scene]\nestimators: [moves, prior]\ntrials: 12\nseed: 5\n", SCENE)
    # Workers of its own find the package by the variable.
    monkeypatch.setattr(workers, "_idle_workers", functools.cache(workers._IdleWorkers))
    monkeypatch.setenv("PYTHONPATH", f"{site}:{os.environ.get('PYTHONPATH', '')}")
    monkeypatch.setenv("BORESIGHT_CACHE", "cache")
    monkeypatch.chdir(here)
    with undrawn("png", "pdf"):
        assert main(["run", "tiny.yaml", "--jobs", str(jobs), "--worst", "1", "--out", out]) == 0
    said = capsys.readouterr().out
    monkeypatch.undo()
    named = next(line.removeprefix("report: ") for line in said.splitlines() if line.startswith("report: "))
    assert (here / named).is_file(), named
    assert {"manifest.json", "rows", "checksums", "report"} <= {path.name for path in (here / out).iterdir()}
    assert list((here / "cache" / "images").glob("*")), "nor what is written to a cache in a relative folder"


@pytest.mark.parametrize("read_noise_e", [pytest.param(0, marks=pytest.mark.long), 60])
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

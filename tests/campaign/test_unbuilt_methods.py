"""A method that cannot be built costs its own rows alone; wrong options are refused before anything is built."""

from __future__ import annotations

import re

import pandas as pd
import pytest
from orbit_worlds import orbit_world
from test_crater_detection import SCENE as CRATERS
from third_party import install_answers
from tiny_campaign import RESULTS, SCENE, assert_same_results, boresight, files, run, write_campaign
from tiny_pairs import PAIRS
from tiny_sequences import SCENE as SEQUENCE

from boresight.campaign.cli import main
from boresight.campaign.kinds.orbit_determination import OrbitTrials
from boresight.campaign.trial.runner import Unbuilt
from boresight.scenarios.errors import BoresightError

MODULE = """
import asyncio
from boresight.scenarios.errors import BoresightError

def late(assets):
    assets.shape()
    raise BoresightError("the shape is not to my liking")

def refused(assets):
    raise BoresightError("estimator refused: colour: there is no such option")

ANSWERS = {
    "value": ValueError("no such mode"),
    "memory": MemoryError(),
    "closes": GeneratorExit(),
    "cancelled": asyncio.CancelledError(),
    "quits": SystemExit(0),
    "late": late,
    "refused": refused,
}

class Method(Base):
    @classmethod
    def from_options(cls, options, assets=None):
        answer = ANSWERS[cls.name]
        if isinstance(answer, BaseException):
            raise answer
        return answer(assets)
    def estimate(self, observation, *, rng): ...
    def follow(self, sequence): ...
    def detect(self, frame, camera): ...
    def match(self, first, second, known): ...
"""
RAISED = {
    "value": "ValueError: no such mode",
    "memory": "MemoryError",
    "closes": "GeneratorExit",
    "cancelled": "asyncio.exceptions.CancelledError",
    "quits": "SystemExit: 0",
    "late": "the shape is not to my liking",
}
KINDS = {
    "sequence_estimators": ("sequence", SEQUENCE, "dead-reckoning", "estimator"),
    "crater_detectors": ("crater-detection", CRATERS, "crater-classic", "detector"),
    "crater_matchers": ("crater-matching", PAIRS.replace("name: tiny-pairs", "name: scene"), "vote", "matcher"),
}


def write(folder, estimators, scene=SCENE, kind=""):
    text = f"title: T\n{kind}scenarios: [scene]\nestimators: [{estimators}]\ntrials: 2\nseed: 5\n"
    return write_campaign(folder / "campaign", text, scene)


def test_an_estimator_that_cannot_be_built_costs_its_own_rows_alone(cache, tmp_path, monkeypatch, capsys):
    install_answers(tmp_path, "estimators", MODULE, monkeypatch)
    file, out = write(tmp_path, f"prior, value: {{mode: 7}}, {', '.join(list(RAISED)[1:])}"), tmp_path / "run"
    assert run(file, out) == 3
    rows = pd.read_parquet(out / "rows").set_index("estimator")
    assert rows.loc["prior", "status"].eq("ok").all()
    traces = pd.read_parquet(out / "tracebacks").set_index("estimator")["traceback"]
    said = capsys.readouterr()
    for name, why in RAISED.items():
        options = 'its options are {"mode": 7}' if name == "value" else "its options are the defaults"
        reason = f"{name} cannot be built for scene: {why}; {options}"
        assert list(rows.loc[name, "reason"]) == [f"the estimator cannot work: {reason}"] * 2
        assert f"all trials of {name} in scene are errors: {reason}" in said.out
        assert traces[name].str.contains(f"in from_options\n(?s:.*){why}", regex=True).all()
    assert "Traceback" not in said.out + said.err
    assert main(["inspect", str(out), "--estimator", "late", "--trial", "1"]) == 0


@pytest.mark.long
def test_workers_store_the_same_of_what_cannot_be_built(cache, tmp_path, monkeypatch):
    install_answers(tmp_path, "estimators", MODULE, monkeypatch)
    file, out = write(tmp_path, f"prior, value: {{mode: 7}}, {', '.join(list(RAISED)[1:])}"), tmp_path / "run"
    assert run(file, out) == 3
    done = boresight("run", file, "--jobs", 2, "--out", tmp_path / "two", PYTHONPATH=str(tmp_path))
    assert done.returncode == 3, done.stderr
    assert_same_results(out, tmp_path / "two")


@pytest.mark.parametrize("group", KINDS)
def test_so_does_a_method_of_another_kind(group, cache, tmp_path, monkeypatch):
    experiment, scene, control, called = KINDS[group]
    install_answers(tmp_path, group, MODULE, monkeypatch)
    file, out = write(tmp_path, f"value, closes, {control}", scene, f"experiment: {experiment}\n"), tmp_path / "run"
    assert run(file, out) == 3
    rows = pd.read_parquet(out / "rows").set_index("estimator")
    assert not rows.loc[control, "status"].eq("error").any()
    for name in ("value", "closes"):
        reason = (
            f"the {called} cannot work: {name} cannot be built for scene: {RAISED[name]}; its options are the defaults"
        )
        assert list(rows.loc[name, "reason"]) == [reason] * 2
    file = write(tmp_path, f"{control}, refused", scene, f"experiment: {experiment}\n")
    assert run(file, tmp_path / "refused") == 2


def test_so_does_an_estimator_of_orbits():
    trials = OrbitTrials(
        scenario="scene", methods={"mine": Unbuilt("there is none", "why")}, seed=5, world=orbit_world()
    )
    (row,) = trials.trial(0)["rows"]
    assert row["reason"] == "the estimator cannot work: there is none"


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ("lmaps: {maplets: {spacing: 1}}", "lmaps.maplets.spacing: unknown key; did you mean spacing_m?"),
        ("lmaps: {maplets: {side: wide}}", "lmaps.maplets.side: 'wide' is not a whole number"),
        (
            "landmark-altimeter: {options: {images: 3}}",
            "landmark-altimeter.options.images: unknown key",
        ),
        ("refused", "estimator refused: colour: there is no such option"),
    ],
)
def test_wrong_options_of_the_last_estimator_are_refused_before_anything_is_built(
    wrong, said, cache, tmp_path, monkeypatch, capsys
):
    install_answers(tmp_path, "estimators", MODULE, monkeypatch)
    scene = SCENE + "sensors: {altimeter: {sigma_m: 5}}\n"
    assert run(write(tmp_path, f"value, lmaps: {{label: first}}, {wrong}", scene), tmp_path / "run") == 2
    told = capsys.readouterr()
    (line,) = told.err.splitlines()
    assert re.match(rf"boresight: {re.escape(str(tmp_path))}/\S+\.yaml:\d+: {re.escape(said)}", line), line
    assert "building" not in told.out
    assert not (tmp_path / "run" / "products").exists()


def test_a_shape_without_maplets_or_craters_is_named_with_the_option(cache, tmp_path, capsys):
    out = tmp_path / "run"
    assert run(write(tmp_path, "prior, lmaps: {maplets: {spacing_m: 200}}, crater-pose"), out) == 3
    rows = pd.read_parquet(out / "rows").set_index("estimator")
    assert rows.loc["prior", "status"].eq("ok").all()
    (of_maplets,), (of_craters,) = (set(rows.loc[name, "reason"]) for name in ("lmaps", "crater-pose"))
    assert of_maplets.startswith(
        "the estimator cannot work: the maplets of scene cannot be made: the shape is too small"
    )
    assert "spacing_m (200)" in of_maplets
    assert of_craters.startswith("the estimator cannot work: the crater database of scene cannot be made: ")
    assert "section craters" in of_craters


@pytest.mark.parametrize(
    "error",
    [
        ValueError("on the way"),
        BoresightError("on the way"),
        pytest.param(MemoryError("on the way"), marks=pytest.mark.long),
    ],
)
def test_a_product_that_cannot_be_made_costs_one_run_the_rows_of_those_who_ask(error, cache, tmp_path, monkeypatch):
    def fall(*arguments):
        raise error

    monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path / "cache"))
    file, out = write(tmp_path, "prior, lmaps: {maplets: {spacing_m: 40, side: 15}}"), tmp_path / "run"
    with monkeypatch.context() as patch:
        patch.setattr("boresight.campaign.products.landmark_database.build_maplets", fall)
        assert run(file, out) == 3
    rows = pd.read_parquet(out / "rows").set_index("estimator")
    (reason,) = set(rows.loc["lmaps", "reason"])
    why = "on the way" if isinstance(error, BoresightError) else f"{type(error).__name__}: on the way"
    assert f"the maplets of scene cannot be made: {why}; its options are {{" in reason
    assert '"spacing_m":40.0' in reason
    traces = pd.read_parquet(out / "tracebacks")["traceback"]
    assert traces.str.contains(r"in fall\n *raise error").all()
    before = files(out, *RESULTS)
    assert run(file, out) == 3
    assert files(out, *RESULTS) == before
    assert run(file, tmp_path / "again") == 0, "another run tries again: nothing of it is in the cache"


def test_a_full_disk_ends_the_run_so_that_the_same_command_can_go_on(cache, tmp_path, monkeypatch, capsys):
    def fall(*arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path / "cache"))
    file, out = write(tmp_path, "prior, lmaps: {maplets: {spacing_m: 40, side: 15}}"), tmp_path / "run"
    with monkeypatch.context() as patch:
        patch.setattr("boresight.campaign.products.landmark_database.build_maplets", fall)
        assert run(file, out) == 2
    assert "cannot write (No space left on device)" in capsys.readouterr().err
    assert run(file, out) == 0

"""What the list says of a campaign: how long it takes here, and what data it needs."""

from __future__ import annotations

from importlib.util import find_spec

import pytest
from tiny_campaign import run
from tiny_sequences import write_sequences

from boresight.campaign.runs.read import CATALOG, Need, campaign_names, core_seconds, in_words, needs, remember
from boresight.scenarios.load import load_campaign


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path / "cache"))


@pytest.mark.parametrize(
    ("core_s", "trials", "cores", "said"),
    [(0.001, 10, 2, "1 s"), (0.5, 100, 2, "25 s"), (2.0, 200, 2, "3.3 min"), (36.0, 1000, 2, "5 h")],
)
def test_a_rate_is_said_in_a_unit_that_one_can_read(core_s, trials, cores, said):
    assert in_words(core_s * trials / cores) == said


def test_the_last_run_counts_and_one_trial_tells_nothing():
    assert core_seconds("mine") is None
    remember("mine", trials=100, seconds=50.0, jobs=2)
    remember("mine", trials=1, seconds=50.0, jobs=2)
    assert core_seconds("mine") == 1.0
    remember("mine", trials=10, seconds=20.0, jobs=1)
    assert core_seconds("mine") == 2.0


def test_a_run_leaves_its_rate_but_not_one_of_a_changed_world_or_of_nothing_new(tmp_path):
    file, out = write_sequences(tmp_path, 10), tmp_path / "run"
    name = load_campaign(str(file), CATALOG).spec.name
    assert run(file, tmp_path / "changed", "--trials", 10, "--set", "camera.fov_deg=12") == 0
    assert core_seconds(name) is None
    assert run(file, out, "--trials", 10) == 0
    first = core_seconds(name)
    assert first is not None
    assert 0.0 < first < 60.0
    assert run(file, out, "--trials", 10) == 0
    assert core_seconds(name) == first


def test_data_that_are_not_there_are_named_as_missing(tmp_path, monkeypatch):
    monkeypatch.setenv("BORESIGHT_DATA", str(tmp_path))
    found = {name: needs(load_campaign(name, CATALOG)) for name in campaign_names()}
    assert found["quickstart"] == ()
    (extra,) = found["trade-slam-gtsam"]
    assert extra.found == (find_spec("gtsam") is not None)
    assert extra.word == "gtsam"
    assert found["navcam67p-real"] == (
        Need("67p-16k.obj", found=False, kind="shapes"),
        Need("rosetta_navcam_67p", found=False, kind="images"),
    )
    assert [need.word for need in found["navcam67p-real"]] == ["data", "images"]
    assert {need.name for need in found["delpech2015-sensitivity"]} == {
        "apophis_lightcurve.obj",
        "itokawa_gaskell_q64.ply",
        "itokawa_radar.obj",
    }
    (tmp_path / "shapes").mkdir()
    (tmp_path / "shapes" / "67p-16k.obj").write_text("")
    assert needs(load_campaign("navcam67p-real", CATALOG))[0].found

"""Orbit determination as a campaign: scores by hand, records, a report, and what is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from orbit_worlds import orbit_world

from boresight.campaign.kinds.orbit_determination import (
    OrbitTrials,
    check_orbit,
    drawable,
    orbit_errors,
    orbit_summary,
    wrong_sightings,
)
from boresight.campaign.runs.check import check_campaign
from boresight.campaign.runs.resolve import resolve
from boresight.campaign.trial.kind import PerDatabase
from boresight.estimators.orbit.batch_filter import BatchFilter
from boresight.estimators.orbit.contract import Orbit, OrbitEstimate
from boresight.reports.schema.tables import TABLES
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import load_scenario
from boresight.scenarios.orbits.draw import draw_orbit


@pytest.fixture(scope="module")
def world():
    return orbit_world(sightings={"wrong_share": 0.05, "merged_share": 0.1})


@pytest.fixture(scope="module")
def drawn(world):
    return draw_orbit(world, 5, 0)


def _orbit(truth, data, offset):
    """Return the true orbit, shifted."""
    n, k = len(data.wanted_s), len(data.pictures.image)
    return Orbit(
        state=truth.states[0] + np.r_[offset, 0.0, 0.0, 0.0],
        covariance=np.diag([4.0, 4.0, 4.0, 1e-6, 1e-6, 1e-6]),
        positions_m=truth.states[:, :3] + offset,
        velocities_m_s=truth.states[:, 3:],
        position_covariances_m2=np.tile(4.0 * np.eye(3), (n, 1, 1)),
        numbers=np.unique(data.pictures.landmark),
        points_body_m=np.zeros((len(np.unique(data.pictures.landmark)), 3)),
        residuals_px=np.full((k, 2), 0.5),
        used=np.ones(k, dtype=bool),
    )


def test_errors_are_those_of_a_shift_that_is_known(drawn):
    truth, data = drawn
    offset = np.array([2.0, -3.0, 6.0])
    orbit = _orbit(truth, data, offset)
    summary = orbit_summary(OrbitEstimate("ok", orbit), orbit, truth, data)
    for name in ("epoch_error_m", "arc_median_m", "arc_rms_m", "arc_p90_m", "predicted_error_m"):
        assert summary[name] == pytest.approx(7.0)
    assert summary["epoch_nees"] == pytest.approx(49.0 / 4.0 / 6.0)
    assert summary["arc_nees"] == pytest.approx(49.0 / 4.0 / 3.0)
    assert summary["residual_rms_px"] == pytest.approx(0.5)
    known = data.knowledge.field.harmonics.gm_m3_s2
    exact = orbit_summary(OrbitEstimate("ok", orbit, diagnostics={"gm_ratio": 5.0 / known}), orbit, truth, data)
    assert exact["gm_error"] == pytest.approx(0.0, abs=1e-12)
    assert summary["gm_error"] == pytest.approx(known / 5.0 - 1.0, abs=1e-12)
    lines = orbit_errors(orbit, truth, data)
    for line in lines:
        assert np.hypot(np.hypot(line["radial_m"], line["along_m"]), line["cross_m"]) == pytest.approx(7.0)
    # The same error a step of a tenth of a second ahead of the spacecraft is along its motion, above it is radial.
    ahead = replace(orbit, positions_m=truth.states[:, :3] + 0.1 * truth.states[:, 3:])
    above = replace(orbit, positions_m=1.001 * truth.states[:, :3])
    for early, high, state in zip(
        *(orbit_errors(one, truth, data) for one in (ahead, above)), truth.states, strict=True
    ):
        assert early["along_m"] == pytest.approx(0.1 * np.linalg.norm(state[3:]), rel=0.05)
        assert abs(early["cross_m"]) < 1e-9
        assert high["radial_m"] == pytest.approx(1e-3 * np.linalg.norm(state[:3]))
    end = data.pictures.times_s[-1] / 86_400.0
    assert [line["predicted"] for line in lines] == [line["time_days"] > end + 1e-3 for line in lines]


def test_a_number_that_was_split_may_stand_for_two_craters(drawn):
    truth, data = drawn
    orbit = _orbit(truth, data, np.zeros(3))
    number = next(
        n for n in orbit.numbers if len(np.unique(truth.crater[(data.pictures.landmark == n) & ~truth.wrong])) == 2
    )
    rows = (data.pictures.landmark == number) & ~truth.wrong
    # Two sightings of one crater and one of another: the number stands for the first, and the second is wrong.
    same, other = (np.flatnonzero(rows & (truth.crater == crater)) for crater in np.unique(truth.crater[rows]))
    few, many = sorted((same, other), key=len)
    if len(few) < len(many):
        assert wrong_sightings(orbit, truth, data)[few].all()
        assert not wrong_sightings(orbit, truth, data)[many].any()
    assert wrong_sightings(orbit, truth, data)[rows].any()
    split = replace(orbit, numbers=np.r_[orbit.numbers, number])
    counts = np.unique(truth.crater[data.pictures.landmark == number], return_counts=True)[1]
    if (counts >= 2).sum() == 2:
        assert not wrong_sightings(split, truth, data)[rows].any()


def test_rubbish_of_an_estimator_is_refused(drawn):
    truth, data = drawn
    orbit = _orbit(truth, data, np.zeros(3))
    check_orbit(OrbitEstimate("ok", orbit), data)
    for estimate in (
        OrbitEstimate("fine", orbit),
        OrbitEstimate("failed", None),
        OrbitEstimate("ok", None),
        OrbitEstimate("ok", replace(orbit, state=np.full(6, np.nan))),
        OrbitEstimate("ok", replace(orbit, points_body_m=np.full_like(orbit.points_body_m, np.nan))),
        OrbitEstimate("ok", replace(orbit, covariance=-orbit.covariance)),
        OrbitEstimate("ok", replace(orbit, covariance=np.triu(np.ones((6, 6))))),
        OrbitEstimate("ok", replace(orbit, position_covariances_m2=np.triu(orbit.position_covariances_m2 + 1.0))),
        OrbitEstimate("ok", orbit, "solved"),
        OrbitEstimate("ok", replace(orbit, positions_m=orbit.positions_m[:2])),
        OrbitEstimate("ok", orbit, diagnostics={"x": float("inf")}),
    ):
        with pytest.raises(ValueError, match=r"is|gives|has|not"):
            check_orbit(estimate, data)


def test_the_orbit_of_a_failure_is_drawn_where_it_is_one(drawn):
    truth, data = drawn
    sound = OrbitEstimate("failed", _orbit(truth, data, np.zeros(3)), "too far off")
    assert drawable(sound, data) is sound
    for orbit in (np.eye(4), replace(sound.orbit, state=np.full(6, np.nan))):
        assert drawable(replace(sound, orbit=orbit), data).orbit is None


class _Raises:
    name, version = "raises", 1

    def determine(self, data):
        raise RuntimeError("on purpose")


def test_trials_give_records_of_the_documented_columns_whatever_an_estimator_does(world):
    trials = OrbitTrials(scenario="small", methods={"filter": BatchFilter(), "raises": _Raises()}, seed=5, world=world)
    records = trials.trial(0)
    for table, lines in records.items():
        wanted = {column.name for column in TABLES[table]}
        assert all(set(line) <= wanted for line in lines), table
    status = {row["estimator"]: row["status"] for row in records["rows"]}
    assert status == {"filter": "ok", "raises": "error"}
    assert "on purpose" in records["tracebacks"][0]["traceback"]
    assert len(records["orbits"]) == 1
    assert records["orbits"][0]["arc_rms_m"] < 20.0
    assert len(records["orbit_errors"]) > 5
    assert {line["used"] for line in records["residuals"]} == {True, False}
    assert trials.trial(0)["orbits"] == records["orbits"]


def test_draws_of_the_craters_take_turns_and_the_first_is_that_of_a_campaign_with_one(tmp_path):
    """One body and one a priori shape: nothing else differs between the draws."""
    alone, several = (
        PerDatabase.open(campaign, campaign.scenarios[0], None)
        for campaign in (_resolved(tmp_path, SMALL), _resolved(tmp_path, SMALL, databases=3))
    )
    worlds = [several.of(trial).world for trial in range(4)]
    assert [several.of(trial).database["batch-filter"] for trial in range(4)] == [0, 1, 2, 0]
    assert [len(alone.parts), alone.of(1).database] == [1, {}]
    assert len({world.asteroid.points_m.tobytes() for world in worlds}) == 3
    assert len({world.asteroid.prominence.tobytes() for world in worlds}) == 3
    assert all(world.onboard is alone.of(0).world.onboard for world in worlds)
    assert all(world.asteroid.harmonics is alone.of(0).world.asteroid.harmonics for world in worlds)
    first = [trials.of(0).trial(0) for trials in (alone, several)]
    assert [records["rows"][0].pop("database") for records in first] == [None, 0]
    assert first[0]["rows"] == first[1]["rows"]
    assert first[0]["orbits"] == first[1]["orbits"]


SCENARIO = """
body: {shape: contact-binary}
camera: {width_px: 512, height_px: 400, fov_deg: 5}
orbit:
  arc: {semi_major_axis_m: 200}
"""
SMALL = SCENARIO.replace("200}", "6000, days: 0.5}") + (
    "  asteroid: {gm_m3_s2: 50}\n  sightings: {images: 40, craters: 200}\n"
    "  knowledge: {position_m: 10, shape_degree: 4}\n"
)
CAMPAIGN = """
name: c
experiment: orbit-determination
scenarios: [s.yaml]
estimators: [{ESTIMATOR}]
trials: 1
seed: 1
databases: {DATABASES}
"""


def _resolved(folder: Path, scenario: str, estimator: str = "batch-filter", databases: int = 1):
    (folder / "s.yaml").write_text(scenario)
    (folder / "c.yaml").write_text(CAMPAIGN.replace("{ESTIMATOR}", estimator).replace("{DATABASES}", str(databases)))
    return resolve(str(folder / "c.yaml"))


def test_an_orbit_in_the_body_a_missing_section_and_wrong_options_are_refused(tmp_path):
    campaign = _resolved(tmp_path, SCENARIO)
    with pytest.raises(BoresightError, match="pericentre"):
        check_campaign(campaign, 1)
    campaign = _resolved(tmp_path, SCENARIO, "{batch-filter: {edit_sigma: 0}}")
    with pytest.raises(BoresightError, match="edit_sigma"):
        check_campaign(campaign, 1)
    without = SCENARIO.split("orbit:", maxsplit=1)[0] + "viewpoint: {range_m: 2000}\n"
    campaign = _resolved(tmp_path, without)
    with pytest.raises(BoresightError, match="orbit: missing"):
        check_campaign(campaign, 1)
    with pytest.raises(BoresightError, match="unknown"):
        _resolved(tmp_path, SCENARIO, "no-such-filter")


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("orbit.arc.eccentricity", "1.5"),
        ("orbit.sightings.wrong_share", "1"),
        ("orbit.light.sun_dir", "[0, 0, 0]"),
        ("orbit.knowledge.shape_degree", "40"),
        ("orbit.arc.radius", "5"),
    ],
)
def test_wrong_keys_of_the_section_are_refused_by_name(tmp_path, key, value):
    (tmp_path / "s.yaml").write_text(SCENARIO)
    with pytest.raises(BoresightError, match=key.split(".")[-1]):
        load_scenario(str(tmp_path / "s.yaml"), (f"{key}={value}",))

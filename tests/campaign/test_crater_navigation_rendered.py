"""The chain on rendered images at full size: a day's part of the campaign that closes the loop."""

from dataclasses import replace

import numpy as np
import pytest

from campaign.experiments.crater_navigation import CraterNavigationTrials
from campaign.experiments.orbit_determination import DeterminedOrbit
from campaign.experiments.registry import Bench
from campaign.resolve import resolve
from estimators.craters.navigation.rounds import CraterNavigation
from estimators.craters.navigation.trajectory import Trajectory
from renderers.mitsuba3 import choose_variant

pytestmark = pytest.mark.long

ARC_DAYS = 0.577
SHORT = (f"orbit.arc.days={ARC_DAYS}", "orbit.arc.predicted_days=1", "orbit.imaging.epochs=24")

# As the campaign's chain without radiometric data, but pairs of images with a single match are believed too.
EVERY_PAIR = {"matcher": "vote", "agreeing": 1, "most_detections": 12, "orbit": {"radiometry": "ignored"}}


def test_two_dozen_rendered_images_come_to_an_orbit(tmp_path):
    campaign = resolve("cheng2003-endtoend", SHORT, variant=choose_variant().name)
    trials = CraterNavigationTrials.open(campaign, campaign.scenarios[0], Bench(tmp_path, 1, keep_images=False))
    seen = []
    every = CraterNavigation.from_options(EVERY_PAIR)
    chains = {**trials.navigators, "every-pair-optical-alone": every}
    records = replace(trials, navigators=chains, witness=seen.append).run(range(1))
    assert [row["status"] for row in records["rows"]] == ["ok"] * 4
    for chain in records["navigation"]:
        assert chain["n_images"] == 24
        assert chain["n_false"] < 0.05 * chain["n_detections"]
        assert chain["n_wrong"] < 0.05 * chain["n_correct"]
    hybrid, vote, optical, every_pair = records["orbits"]
    # Images alone know a day's orbit to 0.7 km: of three matches at the least it comes to 588 m here, of one to 458 m.
    assert max(hybrid["arc_rms_m"], vote["arc_rms_m"], every_pair["arc_rms_m"]) < 500.0
    assert vote["arc_rms_m"] < optical["arc_rms_m"] < 0.7 * _a_priori_rms_m(seen[-1])
    for orbit in (hybrid, vote, optical, every_pair):
        assert max(orbit["epoch_nees"], orbit["arc_nees"]) < 4.0
    assert len(list(tmp_path.glob("chain/*/*/detections-*/*.txt"))) == 24


def _a_priori_rms_m(determined: DeterminedOrbit) -> float:
    """RMS over the arc of the error of the orbit that was known before: 1,098 m."""
    times = determined.data.wanted_s
    before = Trajectory.known_before(determined.data.knowledge, times)
    errors = np.linalg.norm(before.positions_m - determined.truth.states[:, :3], axis=1)
    return float(np.sqrt(np.mean(errors[times <= ARC_DAYS * 86400.0] ** 2)))

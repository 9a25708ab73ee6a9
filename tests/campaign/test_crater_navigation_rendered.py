"""The chain on rendered images at full size: a day's part of the campaign that closes the loop."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from boresight.campaign.kinds.crater_navigation import CraterNavigationTrials
from boresight.campaign.kinds.orbit_determination import DeterminedOrbit
from boresight.campaign.runs.resolve import resolve
from boresight.campaign.trial.kind import WorkerContext
from boresight.estimators.craters.navigation.rounds import CraterNavigation
from boresight.estimators.craters.navigation.trajectory import Trajectory
from boresight.renderers.mitsuba3 import choose_variant

pytestmark = pytest.mark.long

ARC_DAYS = 0.577
DAYS = 5
SHORT = (f"orbit.arc.days={ARC_DAYS}", "orbit.arc.predicted_days=1", "orbit.imaging.epochs=24")

# As the campaign's chain without radiometric data, but pairs of images with a single match are believed too.
EVERY_PAIR = {"matcher": "vote", "agreeing": 1, "most_detections": 12, "orbit": {"radiometry": "ignored"}}


SEED = 7
"""Of the five days: taken before any of them was run, and not the campaign's."""


def test_two_dozen_rendered_images_a_day_come_to_orbits(tmp_path):
    """Medians of five days, for one day decides nothing: images alone come to between 0.27 and 0.79 of what was known.

    Seen with this seed: 569 m (hybrid) and 300 m (vote) with radiometric data, 666 m by images alone, 683 m where every
    pair of images is believed: 0.47, 0.29, 0.58 and 0.58 of what was known before.
    """
    campaign = resolve("cheng2003-endtoend", SHORT, seed=SEED, variant=choose_variant().name)
    trials = CraterNavigationTrials.open(campaign, campaign.scenarios[0], WorkerContext(tmp_path, 1, keep_images=False))
    seen = []
    every = CraterNavigation.from_options(EVERY_PAIR)
    chains = {**trials.methods, "every-pair-optical-alone": every}
    records = replace(trials, methods=chains, inspector=seen.append).run(range(DAYS))
    assert [row["status"] for row in records["rows"]] == ["ok"] * 4 * DAYS
    navigation, orbits = pd.DataFrame(records["navigation"]), pd.DataFrame(records["orbits"])
    assert (navigation["n_images"] == 24).all()
    assert (navigation["n_false"] < 0.05 * navigation["n_detections"]).all()
    matches = navigation.groupby("estimator")[["n_wrong", "n_correct"]].sum()
    assert (matches["n_wrong"] < 0.05 * matches["n_correct"]).all()
    orbits["known_before_m"] = [_a_priori_rms_m(one) for one in seen]
    orbits["gain"] = orbits["arc_rms_m"] / orbits["known_before_m"]
    median = orbits.groupby("estimator")["gain"].median()
    assert (median < 0.7).all(), orbits.to_string()
    assert median["vote"] < median["vote-optical-alone"], orbits.to_string()
    nees = orbits.groupby("estimator")[["epoch_nees", "arc_nees"]].mean()
    assert (nees < 4.0).all(axis=None), orbits.to_string()
    assert len(list(tmp_path.glob("chain/*/*/detections-*/*.txt"))) == 24 * DAYS


def _a_priori_rms_m(determined: DeterminedOrbit) -> float:
    """RMS over the arc of the error of the orbit that was known before: about 1 km."""
    times = determined.observation.wanted_s
    before = Trajectory.a_priori(determined.observation.knowledge, times)
    errors = np.linalg.norm(before.positions_m - determined.truth.states[:, :3], axis=1)
    return float(np.sqrt(np.mean(errors[times <= ARC_DAYS * 86400.0] ** 2)))

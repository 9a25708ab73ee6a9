"""The chain on rendered images at full size: a day's part of the campaign that closes the loop."""

import pytest

from campaign.experiments.crater_navigation import CraterNavigationTrials
from campaign.experiments.registry import Bench
from campaign.resolve import resolve
from renderers.mitsuba3 import choose_variant

pytestmark = pytest.mark.long

SHORT = ("orbit.arc.days=0.577", "orbit.arc.predicted_days=1", "orbit.imaging.epochs=24")


def test_two_dozen_rendered_images_come_to_an_orbit(tmp_path):
    campaign = resolve("cheng2003-endtoend", SHORT, variant=choose_variant().name)
    trials = CraterNavigationTrials.open(campaign, campaign.scenarios[0], Bench(tmp_path, 1, keep_images=False))
    records = trials.run(range(1))
    assert [row["status"] for row in records["rows"]] == ["ok", "ok", "ok"]
    for chain in records["navigation"]:
        assert chain["n_images"] == 24
        assert chain["n_false"] < 0.05 * chain["n_detections"]
        assert chain["n_wrong"] < 0.05 * chain["n_correct"]
    hybrid, vote, optical = records["orbits"]
    # The a priori orbit is 1 km off.
    assert max(hybrid["arc_rms_m"], vote["arc_rms_m"], optical["arc_rms_m"]) < 500.0
    assert max(hybrid["epoch_nees"], vote["epoch_nees"], optical["epoch_nees"]) < 4.0
    assert len(list(tmp_path.glob("chain/*/*/detections-*/*.txt"))) == 24

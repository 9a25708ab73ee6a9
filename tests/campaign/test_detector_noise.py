"""The detector's noise has a stream of its own: that of the truth would let an image foretell itself."""

from __future__ import annotations

import numpy as np
import pytest

from boresight.campaign.imaging.world import open_world
from boresight.renderers.detector import Detector
from boresight.renderers.mitsuba3 import choose_variant
from boresight.scenarios.draw import Stream, generator
from boresight.scenarios.load import load_scenario

SCENE = """
camera: {width_px: 48, height_px: 48, fov_deg: 18}
viewpoint: {range_m: 2000}
lighting: {phase_deg: {uniform: [0, 50]}}
"""
SEED, TRIAL = 7, 3


@pytest.fixture
def sources(tmp_path):
    """The same scenario without and with a detector."""
    (tmp_path / "scene.yaml").write_text(SCENE)
    found = []
    for more in ((), ("detector.read_noise_e=20",)):
        found.append(open_world(load_scenario(str(tmp_path / "scene.yaml"), more), choose_variant().name))
    return found


def test_an_image_is_exposed_with_the_noise_of_the_detectors_stream(sources):
    """The radiance of the scene without a detector, exposed here."""
    plain, exposed = (world.source.trial_image(SEED, TRIAL) for world in sources)
    np.testing.assert_array_equal(plain.view.T_cam_body.translation_m, exposed.view.T_cam_body.translation_m)
    detector = Detector(sources[1].scenario.spec.detector)
    by_stream = {
        stream: detector.expose(plain.image, generator(SEED, stream, TRIAL))
        for stream in (Stream.DETECTOR, Stream.TRUTH)
    }
    np.testing.assert_array_equal(exposed.image, by_stream[Stream.DETECTOR])
    assert not np.array_equal(exposed.image, by_stream[Stream.TRUTH])

"""What an estimator may see."""

import pytest

from scenarios.geometry import Camera
from scenarios.observation import Observation


def test_an_observation_without_frames_is_refused():
    with pytest.raises(ValueError, match="one frame at least"):
        Observation(Camera.from_fov(64, 64, 0.1), ())

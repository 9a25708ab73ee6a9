"""Extreme numbers in every key of a scenario give a valid value or a one-line error, without warnings."""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest

from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import load_scenario

SCENARIOS = ("quickstart", "itokawa-amica-real", "apophis-dynamics-sequence", "eros-like-orbit")
EXTREMES = (0.0, 1e-320, 1e-300, 1e200, 1e308, -1e308)


def numbers(value: object, key: str = "") -> Iterator[tuple[str, object]]:
    """Keys of numbers and of lists of numbers, with their values."""
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from numbers(inner, f"{key}.{name}" if key else name)
        return
    entries = value if isinstance(value, list) else [value]
    if entries and all(isinstance(entry, int | float) and not isinstance(entry, bool) for entry in entries):
        yield key, value


def replaced(value: object, extreme: float) -> Iterator[object]:
    """The number, or each number of a list and then all of them, replaced."""
    if not isinstance(value, list):
        yield extreme
        return
    for place in range(len(value)):
        yield [extreme if place == other else entry for other, entry in enumerate(value)]
    yield [extreme] * len(value)


@pytest.mark.parametrize("extreme", EXTREMES)
@pytest.mark.parametrize("name", SCENARIOS)
def test_an_extreme_number_gives_a_value_or_a_line(name, extreme):
    for key, value in numbers(load_scenario(name).spec.model_dump(mode="json")):
        for other in replaced(value, extreme):
            try:
                spec = load_scenario(name, [f"{key}={json.dumps(other)}"]).spec
            except BoresightError as error:
                assert key.partition(".")[0] in str(error)
            else:
                assert spec.camera.camera().matrix.shape == (3, 3)


def test_too_many_frames_are_refused():
    with pytest.raises(BoresightError, match="frames are more than 1000000"):
        load_scenario("apophis-sphere-sequence", ["sequence.orbit={step_deg: 0.01, revolutions: 1000}"])

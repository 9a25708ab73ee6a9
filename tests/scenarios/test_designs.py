"""Grids of scenarios: which combinations a design runs, and what a file may say."""

import itertools

import numpy as np
import pytest

from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import load_campaign
from boresight.scenarios.spec.campaign import GridSpec, grid_cells, two_level_runs

AXES = {
    "truth": {"levels": {"dull": {"brdf.albedo": 0.1}, "bright": {"brdf.albedo": 0.4}}},
    "focal": {"key": "onboard.focal_error", "values": [0, 0.001, 1e6, -0.5]},
}


def grid(design: str, axes=AXES) -> GridSpec:
    return GridSpec.model_validate({"design": design, "axes": axes})


def test_full_runs_every_combination():
    found = grid_cells(grid("full"))
    assert [cell.suffix for cell in found[:5]] == ["dull-0", "dull-0.001", "dull-1e06", "dull--0.5", "bright-0"]
    assert len({tuple(cell.levels.values()) for cell in found}) == 8
    assert found[5].levels == {"truth": "bright", "focal": "0.001"}
    assert found[5].overrides == ({"brdf.albedo": 0.4}, {"onboard.focal_error": 0.001})


def test_one_at_a_time_runs_the_reference_and_each_other_level_alone():
    found = grid_cells(grid("one-at-a-time"))
    assert [cell.suffix for cell in found] == ["", "truth-bright", "focal-0.001", "focal-1e06", "focal--0.5"]
    assert found[0].levels == {"truth": "dull", "focal": "0"}
    changed = [sum(cell.levels[axis] != found[0].levels[axis] for axis in cell.levels) for cell in found]
    assert changed == [0, 1, 1, 1, 1]


def test_two_level_takes_the_first_and_the_last_level():
    found = grid_cells(grid("two-level"))
    assert {cell.levels["focal"] for cell in found} == {"0", "-0.5"}
    assert found[0].levels == {"truth": "dull", "focal": "0"}
    assert found[0].suffix == "run01"


@pytest.mark.parametrize("factors", [1, 2, 3, 5, 8, 9, 16])
def test_two_level_runs_are_of_resolution_four(factors):
    """Each factor is as often high as low, at either level of every other factor and of every product of two."""
    signs = 1 - 2 * np.array(two_level_runs(factors), dtype=int)
    assert len(signs) < 4 * factors + 1
    assert len({tuple(row) for row in signs}) == len(signs)
    assert not signs.sum(axis=0).any()
    np.testing.assert_array_equal(signs.T @ signs, len(signs) * np.eye(factors, dtype=int))
    for a, b in itertools.combinations(range(factors), 2):
        assert not (signs.T @ (signs[:, a] * signs[:, b])).any()


FILE = "scenarios: [quickstart]\nestimators: [prior]\ntrials: 1\nseed: 1\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{axes: {}}", "grid.axes"),
        ("{design: random, axes: {a: {key: brdf.albedo, values: [0.1, 0.2]}}}", "grid.design: 'random'"),
        ("{axes: {a: {values: [1, 2]}}}", "values belong to a key"),
        ("{axes: {a: {key: brdf.albedo, values: [0.1]}}}", "grid.axes.a.values"),
        ("{axes: {a: {key: brdf.albedo, values: [0.1, 0.1]}}}", "values must differ"),
        ("{axes: {a: {levels: {X y: {}, z: {}}}}}", "the level 'X y'"),
        ("{axes: {A: {levels: {y: {}, z: {}}}}}", "the axis 'A'"),
        ("{axes: {a: {key: brdf.albedo, values: [1, 2], levels: {y: {}, z: {}}}}}", "not both"),
    ],
)
def test_wrong_grids_are_refused_in_a_line(tmp_path, text, said):
    file = tmp_path / "c.yaml"
    file.write_text(FILE + f"grid: {text}\n")
    with pytest.raises(BoresightError) as fault:
        load_campaign(str(file), tmp_path)
    assert said in str(fault.value)
    assert "c.yaml:5" in str(fault.value)
    assert "\n" not in str(fault.value)

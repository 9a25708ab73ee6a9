"""Views that keep the body clear of parts of the detector; the paper's real images are asked for by name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from boresight.campaign.cli.main import main
from boresight.campaign.imaging.world import open_world
from boresight.renderers.mitsuba3 import choose_variant
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import load_scenario

SCENE = """
camera: {width_px: 96, height_px: 96, fov_deg: 20}
viewpoint: {range_m: 2000}
lighting: {phase_deg: {uniform: [0, 10]}}
"""
TOP = (0, 0, 96, 25)


def sights(folder: Path, trials: int, rectangle: tuple[int, int, int, int] | None) -> list[np.ndarray]:
    text = SCENE if rectangle is None else SCENE.replace("2000}", f"2000, keep_clear_px: [{list(rectangle)}]}}")
    (folder / "scene.yaml").write_text(text)
    world = open_world(load_scenario(str(folder / "scene.yaml")), choose_variant().name)
    return [world.source.trial_image(5, trial).image for trial in range(trials)]


def test_the_body_stays_clear_and_clear_views_stay_as_they_were(tmp_path):
    left, top, right, bottom = TOP
    free, clear = sights(tmp_path, 12, None), sights(tmp_path, 12, TOP)
    reached = [bool(image[top:bottom, left:right].any()) for image in free]
    assert any(reached)
    assert not all(reached)
    assert not any(image[top:bottom, left:right].any() for image in clear)
    assert all(image.any() for image in clear)
    same = [np.array_equal(one, other) for one, other in zip(free, clear, strict=True)]
    assert any(same)
    assert not any(stayed and hit for stayed, hit in zip(same, reached, strict=True))


def test_a_part_that_cannot_stay_clear_is_refused(tmp_path):
    with pytest.raises(BoresightError, match=r"scene.yaml: viewpoint.keep_clear_px: .* make it smaller"):
        sights(tmp_path, 1, (0, 0, 96, 96))


def test_the_real_campaign_says_in_one_line_what_to_fetch(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("BORESIGHT_DATA", str(tmp_path))
    assert main(["run", "rowell2015-real", "--out", str(tmp_path / "run")]) == 2
    captured = capsys.readouterr()
    assert len(captured.err.splitlines()) == 1
    assert "hayabusa_amica_20051001" in captured.err.partition(" are missing, ")[0]
    assert "boresight fetch rowell2015 brings them, or says where to get" in captured.err

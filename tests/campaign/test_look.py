"""`boresight inspect --look`: what is counted by hand, and a page in a real browser."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest
import trimesh
from browser import needs_chromium, opened
from tiny_campaign import compute

from boresight.campaign.cli import main
from boresight.campaign.inspection.recompute import Choice, reopened
from boresight.campaign.inspection.show import camera_sets, coarsened, look_of
from boresight.campaign.kinds.single_image.show import landmark_marks
from boresight.campaign.store import RunFolder
from boresight.reports.run.data import read_run
from boresight.scenarios.geometry import TriangleMesh

# What plotly's script and a browser without a graphics card say of their own speed.
_SPEED = "willReadFrequently|GPU stall due to ReadPixels|software WebGL"


def test_a_coarse_mesh_is_small_and_keeps_its_shape():
    ball = trimesh.creation.icosphere(subdivisions=6, radius=200.0)
    mesh = TriangleMesh(ball.vertices, ball.faces)
    coarse = coarsened(mesh, 10_000)
    assert 2_000 < len(coarse.faces) <= 10_000
    assert coarse.volume_m3 == pytest.approx(4.0 / 3.0 * np.pi * 200.0**3, rel=0.02)
    assert coarsened(mesh, 10**6) is mesh


def test_landmarks_are_counted_and_cameras_divided():
    recognised = pd.DataFrame({"landmark": [0, 0, 2], "error_m": [1.0, 3.0, np.nan]})
    often, well = landmark_marks(np.eye(3), np.array([4.0, 2.0, 0.0]), recognised)
    np.testing.assert_array_equal(often.values, [50.0, 0.0, np.nan])
    np.testing.assert_array_equal(well.values, [2.0, np.nan, np.nan])
    rows = pd.DataFrame(
        {
            "trial": [0, 1, 2, 3],
            "status": ["ok", "failed", "ok", "ok"],
            "reason": ["", "dark", "", ""],
            "position_error_m": [1.0, np.nan, 5.0, 2.0],
        }
    )
    sets = camera_sets(
        rows, rows["position_error_m"].to_numpy(), "error {:g} m".format, lambda trial: np.full(3, float(trial))
    )
    found = {cameras.name: cameras.points_m[:, 0].tolist() for cameras in sets}
    assert found == {"good trials": [0.0, 3.0], "bad trials": [2.0], "no estimate": [1.0]}
    assert [cameras.texts[-1] for cameras in sets] == [
        "trial 3<br>error 2 m", "trial 2<br>error 5 m", "trial 1<br>failed: dark",
    ]  # fmt: skip


def test_a_look_has_the_recognitions_of_the_run(tiny_run):
    folder = RunFolder(tiny_run.folder)
    look = look_of(reopened(folder), folder, read_run(tiny_run.folder), Choice())
    assert look.title == "scene / landmark-harris"
    stored = pd.read_parquet(tiny_run.folder / "landmarks")
    told = sum(int(re.search(r"recognised in (\d+)", text)[1]) for text in look.marks[0].texts)
    assert told == len(stored) > 0
    assert np.nanmax(look.marks[0].values) <= 100.0
    assert sum(len(cameras.points_m) for cameras in look.cameras) == 24


@needs_chromium
def test_the_page_draws_in_a_browser_without_a_network(tiny_run, tmp_path):
    assert main(["inspect", str(tiny_run.folder), "--look", "--out", str(tmp_path)]) == 0
    page = tmp_path / "look_scene-landmark-harris.html"
    assert page.stat().st_size < 10e6
    with opened(page, _SPEED) as shown:
        shown.wait_for_selector(".gl-container canvas")
        names = shown.locator(".legendtext").all_text_contents()
        assert names[:3] == ["body", "recognised when in view", "median landmark error"]
        assert shown.title() == "scene / landmark-harris"


def test_a_look_at_sequences_and_what_has_none(cache, tmp_path):
    (tmp_path / "orbit.yaml").write_text(
        "extends: apophis-sphere-sequence\nsequence:\n  orbit: {revolutions: 0.2}\n", encoding="utf-8"
    )
    campaign = "title: S\nexperiment: sequence\nscenarios: [orbit.yaml]\nestimators: [fixed-lag]\ntrials: 3\nseed: 3\n"
    (tmp_path / "campaign.yaml").write_text(campaign, encoding="utf-8")
    compute(tmp_path / "campaign.yaml", tmp_path / "run", trials=3)
    folder = RunFolder(tmp_path / "run")
    look = look_of(reopened(folder), folder, read_run(folder.path), Choice())
    assert np.linalg.norm(look.vertices_m, axis=1) == pytest.approx(190.0)
    assert [cameras.name for cameras in look.cameras] == [
        "truth, middle trial", "estimate, middle trial", "truth, worst trial", "estimate, worst trial",
    ]  # fmt: skip
    epochs = pd.read_parquet(folder.path / "epochs")
    last = epochs.groupby("trial")["position_error_m"].last().sort_values()
    gaps = [np.linalg.norm(look.cameras[k + 1].points_m[-1] - look.cameras[k].points_m[-1]) for k in (0, 2)]
    np.testing.assert_allclose(gaps, [last.iloc[1], last.iloc[2]], atol=1e-6)

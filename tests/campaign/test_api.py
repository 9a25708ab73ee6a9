"""Campaigns from Python give what the command line stores."""

from __future__ import annotations

import shutil
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
from tiny_campaign import TRIALS, write_campaign
from tiny_campaign import run as run_command
from tiny_sequences import write_sequences

import boresight
from boresight.campaign.runs.resolve import resolve
from boresight.scenarios.errors import BoresightError


class Heard:
    def __init__(self):
        self.steps = []

    def message(self, text):
        self.steps.append(text)

    def started(self, done, total):
        self.steps.append((done, total))

    def block(self, records, trials):
        self.steps.append(trials)


def test_the_rows_are_those_of_the_command_and_a_run_goes_on(tmp_path):
    file = write_sequences(tmp_path, 20)
    assert run_command(file, tmp_path / "command", "--trials", 20) == 0
    heard = Heard()
    first = boresight.run(file, trials=10, jobs=1, out=tmp_path / "python")
    rows = boresight.run(file, trials=20, jobs=1, out=tmp_path / "python", listener=heard)
    stored = pd.read_parquet(tmp_path / "command" / "rows")
    pd.testing.assert_frame_equal(rows, stored)
    pd.testing.assert_frame_equal(first, stored[stored["trial"] < 10].reset_index(drop=True))
    assert (10, 20) in heard.steps, "ten were stored already"
    assert rows.attrs["folder"] == str(tmp_path / "python")
    again = boresight.run(file, trials=5, jobs=1, out=tmp_path / "python")
    assert set(again["trial"]) == set(range(5)), "as many as are asked for"


def test_statistics_are_those_of_the_rows(tiny_run):
    rows = boresight.read_run(tiny_run.folder).rows
    table = boresight.summary(tiny_run.folder)
    ours = table.query("estimator == 'prior' and stage == 'final' or estimator == 'prior' and stage == 'prior'")
    median = ours.query("measure == 'position_error_m' and statistic == 'median'")["value"].iloc[0]
    assert median == pytest.approx(rows.query("estimator == 'prior'")["position_error_m"].median())
    assert len(rows) == 2 * TRIALS


def test_a_comparison_is_that_of_the_rows(tiny_run):
    rows = boresight.read_run(tiny_run.folder).rows
    found = boresight.compare(tiny_run.folder)
    solved = rows[rows["status"] == "ok"].groupby("estimator")["position_error_m"].median()
    medians = found.subjects.query("trials == 'solved' and statistic == 'median'").set_index("estimator")["value"]
    np.testing.assert_allclose(medians[solved.index], solved)
    assert found.differences.empty, "the prior is no subject of a difference"
    weighed = found.consistency.set_index("estimator")["mean"]
    nees = rows[rows["status"] == "ok"].groupby("estimator")["nees"].mean()
    assert weighed["landmark-harris"] == pytest.approx(nees["landmark-harris"])


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"trials": 0}, "--trials 0: give 1 or more"),
        ({"jobs": -1}, "--jobs -1: give 1 or more"),
        ({"overrides": ["camera.fov=3"]}, "camera.fov"),
        ({"until": "now"}, "--until 'now'"),
    ],
)
def test_what_cannot_be_run_is_refused_in_one_line_and_leaves_nothing(tmp_path, asked, said):
    file = write_campaign(tmp_path)
    with pytest.raises(BoresightError, match=said) as refused:
        boresight.run(file, out=tmp_path / "run", **asked)
    assert "\n" not in str(refused.value)
    assert not (tmp_path / "run").exists()


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="walk"):
        boresight.walk  # noqa: B018  the look-up is what is tested


def test_every_name_can_be_imported_and_is_documented():
    assert 15 <= len(boresight.__all__) <= 40
    assert set(boresight.__all__) <= set(dir(boresight))
    for name in boresight.__all__:
        assert getattr(boresight, name).__doc__.strip(), name


def test_importing_it_loads_nothing():
    code = "import boresight, sys; print(sorted({'numpy', 'pandas', 'mitsuba', 'numba', 'cv2'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_a_trial_is_that_of_a_campaign(tiny_run):
    rows = boresight.read_run(tiny_run.folder).rows
    spec = boresight.load(tiny_run.file)
    entry = next(one for one in spec.loaded.spec.estimators if one.name != "prior")
    scenario, seed = spec.scenarios[0], spec.loaded.spec.seed
    alone = boresight.trial(scenario.path, entry.name, 2, seed=seed, options=entry.options)
    stored = rows.query("trial == 2 and estimator == @entry.label").iloc[0]
    assert alone.row["status"] == stored["status"] == "ok"
    assert alone.row["position_error_m"] == stored["position_error_m"], "bit for bit"
    again = boresight.inspect(tiny_run.folder, scenario.spec.name, entry.label, 2)
    assert again.row == alone.row
    np.testing.assert_array_equal(alone.image, boresight.render(scenario.path, 2, seed=seed).image)
    assert isinstance(alone.truth, boresight.View)
    assert isinstance(alone.observation, boresight.Observation)
    offset_m = alone.estimate.pose.camera_position_m - alone.truth.T_cam_body.camera_position_m
    assert np.linalg.norm(offset_m) == pytest.approx(stored["position_error_m"], rel=1e-9)
    assert len(alone.plot().axes) >= 2
    assert {"stages", "timings"} <= set(alone.tables)


def test_a_rendered_image_is_drawn_with_the_first_pixel_at_the_top_left(tmp_path):
    made = boresight.render(boresight.load(write_campaign(tmp_path)).scenarios[0].path)
    (axes,) = made.plot().axes
    height, width = made.image.shape
    assert axes.images[0].get_extent() == [0.0, width, height, 0.0]
    assert made.view.camera.width_px == width


ESTIMATOR = """
import numpy as np
from beside import STEP_M

from boresight import Estimate


class Ahead:
    name = "ahead"
    version = 1

    @classmethod
    def from_options(cls, options, assets):
        return cls()

    def estimate(self, observation, *, rng):
        return Estimate("ok", pose=observation.frame.prior_T_cam_body.perturbed(np.zeros(3), [0.0, 0.0, STEP_M]))
"""


def _with_own(folder, step_m):
    folder.mkdir(exist_ok=True)
    (folder / "beside.py").write_text(f"STEP_M = {step_m}\n")
    (folder / "mine.py").write_text(ESTIMATOR.replace("STEP_M\n\nfrom", f"STEP_M  # {step_m}\n\nfrom", 1))
    return write_campaign(folder, "scenarios: [scene]\nestimators: [prior, mine.py:Ahead]\ntrials: 2\nseed: 5\n")


def test_an_estimator_of_a_file_needs_no_package(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = _with_own(tmp_path / "mine", 7.0)
    rows = boresight.run(file, trials=2, jobs=2, out=tmp_path / "run")
    prior, own = (rows.query("estimator == @name").reset_index() for name in ("prior", "Ahead"))
    assert list(own["status"]) == ["ok", "ok"]
    translation = ["tx_m", "ty_m", "tz_m"]
    moved_m = own[translation].to_numpy() - prior[translation].to_numpy()
    np.testing.assert_allclose(moved_m, [[0.0, 0.0, 7.0]] * 2, atol=1e-9)
    # The same file elsewhere is the same run; one that was changed is another.
    shutil.copytree(tmp_path / "mine", tmp_path / "other")
    digests = [resolve(str(folder / file.name)).digest for folder in (tmp_path / "mine", tmp_path / "other")]
    assert digests[0] == digests[1]
    with (tmp_path / "other" / "mine.py").open("a") as changed:
        changed.write("# another\n")
    assert resolve(str(tmp_path / "other" / file.name)).digest != digests[0]


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ("none.py:Ahead", "No such file"),
        ("mine.py:Behind", "Behind"),
        ("numpy:array", "lacks name, version, from_options, estimate"),
        ("no_such_module:Ahead", "No module named 'no_such_module'"),
    ],
)
def test_a_class_that_is_not_there_is_refused_in_one_line(tmp_path, asked, said):
    file = _with_own(tmp_path, 1.0)
    file.write_text(file.read_text().replace("mine.py:Ahead", asked))
    with pytest.raises(BoresightError, match=said) as refused:
        boresight.run(file, out=tmp_path / "run")
    assert "\n" not in str(refused.value)
    assert not (tmp_path / "run").exists()

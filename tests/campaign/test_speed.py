"""The table of speeds: its history, what counts as slower, Blender's process, and bad input in one line."""

from __future__ import annotations

import json
import sys
import textwrap
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benchmarks import blender as blender_module
from benchmarks import door, images
from benchmarks.blender import cycles
from benchmarks.ratio import HISTORY, REGRESSION, Absent, Ratio, SpeedTable, checked, read_history, record
from benchmarks.scene import SIZE_PX, SUN_DIR_BODY, SpeedScene
from benchmarks.timing import Seconds, Settings, in_turn, timed

from boresight.campaign.cli.main import PEERS, main
from boresight.renderers.mitsuba3 import choose_variant
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, TriangleMesh, View, look_at

FAST = Ratio("image", "a peer", "cpu", 0.1, 0.8, aim=6.0, agreement="correlation 1")
BY_CLOCK = replace(FAST, clock="wall")
ELSEWHERE = replace(FAST, peer="a paper", same_run=False)


def table(*ratios: Ratio) -> SpeedTable:
    return SpeedTable(ratios, (), "abc123", "2026-01-01T00:00:00+00:00", {"processor": "a chip"}, {"numpy": "2"})


def test_works_are_done_in_turn_and_the_least_counts():
    order: list[str] = []
    times = {"a": iter([9.0, 3.0, 5.0]), "b": iter([9.0, 7.0, 4.0])}

    def work(name: str) -> Seconds:
        order.append(name)
        seconds = next(times[name])
        return Seconds(seconds, 10.0 - seconds)

    found = in_turn(2, lambda: work("a"), lambda: work("b"))
    assert order == ["a", "b"] * 3
    assert found == (Seconds(3.0, 5.0), Seconds(4.0, 3.0)), "the first turn warms up, and each clock has its own least"


def test_processor_time_is_not_clock_time():
    import time

    slept = timed(lambda: time.sleep(0.05))()
    assert slept.wall >= 0.05 > 5.0 * slept.cpu


def test_history_keeps_what_changed_and_the_newest_counts(tmp_path):
    file = tmp_path / "history.jsonl"
    assert read_history(file) == {}
    assert record(table(FAST, BY_CLOCK, ELSEWHERE), file) == 2, "another machine's time is no record"
    assert record(table(replace(FAST, peer_s=0.85), BY_CLOCK), file) == 0, "less than a tenth"
    assert record(replace(table(replace(FAST, peer_s=1.0), BY_CLOCK), commit="def456"), file) == 1
    first, second = (json.loads(line) for line in file.read_text().splitlines())
    assert first["ratios"] == {"image | a peer | cpu": 8.0, "image | a peer | wall": 8.0}
    assert (second["commit"], second["ratios"]) == ("def456", {FAST.key: 10.0})
    assert {key: kept.ratio for key, kept in read_history(file).items()} == {FAST.key: 10.0, BY_CLOCK.key: 8.0}


@pytest.mark.parametrize(("peer_s", "fallen"), [(0.8, False), (0.57, False), (0.55, True)])
def test_a_fall_by_more_than_30_percent_is_a_regression(tmp_path, peer_s, fallen):
    file = tmp_path / "history.jsonl"
    record(table(FAST, BY_CLOCK), file)
    slow = table(replace(FAST, peer_s=peer_s), replace(BY_CLOCK, peer_s=0.1), replace(FAST, work="another"))
    unrecorded, found = checked(slow, read_history(file))
    assert found == (["image | a peer | cpu: 5.5, 31% below the 8 of abc123"] if fallen else [])
    assert unrecorded == ["another | a peer | cpu"]


def test_the_command_prints_stores_records_and_checks(monkeypatch, tmp_path, capsys):
    found: list[Ratio | Absent] = [FAST, ELSEWHERE, Absent("rays", "embreex: cannot be imported")]
    monkeypatch.setattr(door, "WORKS", {"plain": lambda _: iter(found), "kernels": lambda _: iter(())})
    file = tmp_path / "history.jsonl"
    command = ["bench", "quick", "--history", str(file), "--json", str(tmp_path / "speed.json")]
    assert main([*command, "--record", "--check"]) == 0
    said = capsys.readouterr().out
    assert "8 (another machine)" in said
    assert "not compared: rays: embreex: cannot be imported" in said
    assert "1 ratio(s) recorded" in said
    stored = json.loads((tmp_path / "speed.json").read_text())
    assert stored["ratios"][0]["ratio"] == pytest.approx(8.0)
    assert {"processor", "cores", "load_before"} <= set(stored["machine"])
    assert stored["versions"]["numpy"] == np.__version__
    found[0] = replace(FAST, ours_s=0.2)
    assert main(command) == 0, "nothing is checked unless it is asked for"
    assert main([*command, "--record", "--check"]) == 1, "what is recorded is not checked against itself"
    assert "failed: image | a peer | cpu: 4, 50% below the 8" in capsys.readouterr().out


def test_a_ratio_is_held_against_records_of_the_same_processor(tmp_path):
    file, elsewhere = tmp_path / "history.jsonl", {"processor": "another chip"}
    record(table(FAST), file)
    slower = replace(table(replace(FAST, peer_s=0.4)), machine=elsewhere)
    assert checked(slower, read_history(file, "another chip")) == ([FAST.key], []), "no record of it yet"
    assert record(slower, file) == 1
    assert [read_history(file, name)[FAST.key].ratio for name in ("a chip", "another chip", None)] == [8.0, 4.0, 4.0]
    assert record(table(FAST), file) == 0, "the chip's own record counts"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("quick", "--blocks", "0"), "--blocks: works are done in turn at least 1 time, not 0"),
        (("quick", "--history", "bad.jsonl"), "bad.jsonl: line 2 is no record of ratios"),
        (("quickstart", "--check"), "'quickstart' has none"),
    ],
)
def test_bad_input_is_one_line(monkeypatch, tmp_path, capsys, arguments, said):
    monkeypatch.chdir(tmp_path)
    Path("bad.jsonl").write_text(
        '{"commit": "a", "ratios": {"b": 1}, "machine": {"processor": "p"}}\n{"commit": "a", "ratios": {"b": 1}}\n'
    )
    assert main(["bench", *arguments]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line


def test_what_comes_with_boresight_is_a_history_of_works_that_exist():
    kept = read_history(HISTORY)
    assert kept
    assert all(kept[key].ratio > 0.0 and len(key.split(" | ")) == 3 for key in kept)


FAKE_BLENDER = """
#!{python}
import json, sys
import numpy as np
stored = np.load(sys.argv[3] + "/scene.npz")
print(json.dumps({{"version": "5.0"}}), flush=True)
for line in sys.stdin:
    view, samples, *file = line.split()
    if samples == "9":
        sys.exit("no such view")
    if file:
        column, row, width, height = stored["windows"][int(view)]
        image = np.zeros((height, width), dtype=np.float32)
        image.flat[:16] = stored["T_body_camera"][int(view)].ravel()
        np.save(file[0], image)
    print(json.dumps({{"cpu": float(samples), "wall": len(stored["faces"])}}), flush=True)
"""


@pytest.fixture
def tetrahedron() -> SpeedScene:
    corners = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    mesh = TriangleMesh(corners, np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]))
    return SpeedScene(
        mesh, (View(Camera.from_fov(SIZE_PX, SIZE_PX, 0.3), look_at(np.array([9.0, 0, 0])), SUN_DIR_BODY),)
    )


def test_blender_answers_in_its_own_process(tetrahedron, tmp_path):
    python = tmp_path / "python"
    python.write_text(textwrap.dedent(FAKE_BLENDER).format(python=sys.executable).lstrip())
    python.chmod(0o755)
    with cycles(python, tetrahedron, 2) as blender:
        assert blender.version == "5.0"
        assert blender.render(0, 4) == Seconds(4.0, 4.0)
        image = blender.image(0, 4)
        rows, columns = tetrahedron.window(0).slices
        pose = image[rows, columns].flat[:16].reshape(4, 4)
        assert np.count_nonzero(image) == np.count_nonzero(pose), "the window alone is drawn"
        # Blender's camera looks along -z with y up: from (9, 0, 0) at the origin, z of the body up.
        np.testing.assert_allclose(pose, [[0, 0, 1, 9], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]], atol=1e-6)
        with pytest.raises(BoresightError, match="Blender: no such view; make a virtual"):
            blender.render(0, 9)


def test_a_blender_that_ignores_how_many_samples_are_asked_for_is_not_timed(tetrahedron, tmp_path, monkeypatch):
    """Cycles 5.0 keeps those that it began with: beside 64 samples of it we were eleven times too fast."""
    python = tmp_path / "python"
    renderer = tetrahedron.renderer(choose_variant(), 64)
    np.save(tmp_path / "same.npy", renderer.render(tetrahedron.views[0]))
    line = 'image.flat[:16] = stored["T_body_camera"][int(view)].ravel()'
    assert line in FAKE_BLENDER
    whole = f'np.load("{tmp_path}/same.npy")'
    same = FAKE_BLENDER.replace(line, f"image = {whole}[row : row + height, column : column + width]")
    python.write_text(textwrap.dedent(same).format(python=sys.executable).lstrip())
    python.chmod(0o755)
    monkeypatch.setattr(images, "speed_scene", lambda *_: tetrahedron)
    (absent,) = images.image_ratios(Settings(rounds=1, blender=python))
    assert isinstance(absent, Absent)
    assert "4 samples a pixel are the same image as 64" in absent.why


@pytest.mark.parametrize("python", [Path("/nowhere/python"), Path(sys.executable)])
def test_absent_blender_is_said_with_what_to_do(tetrahedron, python, monkeypatch):
    monkeypatch.setattr(blender_module, "_SCRIPT", Path("/nowhere/script.py"))
    with (
        pytest.raises(BoresightError, match=r"Blender: .*`pip install bpy` in it.*--blender PYTHON"),
        cycles(python, tetrahedron, 2),
    ):
        pass


def test_the_command_names_the_works_that_there_are():
    assert sorted(PEERS) == sorted({*door.GROUPS, *door.WORKS})
    assert REGRESSION == 0.30, "as the help of --check says"

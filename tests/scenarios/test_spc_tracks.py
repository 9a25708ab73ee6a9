"""Real tracks of folders of stereophotoclinometry: against the project's camera, and damaged files."""

from __future__ import annotations

import re
from datetime import datetime

import numpy as np
import pytest
from slam_sequences import CAMERA
from spc_folders import CENTRE, PLAIN, TURNED, lmk_text, name_of, sum_text, write_spc
from track_tables import make_world

from boresight.campaign.imaging.real_images import image_files, images_digest, open_tracks
from boresight.campaign.kinds.sequence import ground_of
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Pose
from boresight.scenarios.load import load_scenario
from boresight.scenarios.sequences import draw_real_sequence
from boresight.scenarios.spc import Sumfile, read_lmk, read_sum_landmarks, read_sumfile, spc_files, sumfile_text

WORLD = make_world()
AXES = WORLD.rotations[2]
SCOBJ_KM = -WORLD.positions_m[2] / 1e3
ROUNDING = 0.006 / CAMERA.fx_px  # of two decimals of a pixel, in a ray
SUM_LINES = 15  # up to the first landmark


def opened(scene, *overrides):
    return open_tracks(load_scenario(str(scene), overrides))


def text(**pixels):
    seen = pixels or {"FA0001": (531.25, 478.75), "GB0012": (12.0, 1001.5)}
    return sum_text("W1", datetime(2015, 4, 14, 16, 26, 27, 974000), SCOBJ_KM, AXES, seen, TURNED)


def refused(read, path, content, said):
    path.write_text(content)
    with pytest.raises(BoresightError, match=re.escape(f"{path}: ") + ".*" + re.escape(said)) as error:
        read(path)
    assert "\n" not in str(error.value)


def test_numbers_of_fortran_are_read_to_the_last_digit(tmp_path):
    vlm = np.array([1.9182736455e0, -5.432109876e-1, 7.123456789e-12])
    path = tmp_path / "FA0042.LMK"
    path.write_text(lmk_text("FA0042", vlm, {"N46300000000": (204.75, 13.0)}))
    assert "    0.1918273646D+01   -0.5432109876D+00    0.7123456789D-11  VLM" in path.read_text()
    np.testing.assert_array_equal(read_lmk(path), 1e3 * np.array([1.918273646, -0.5432109876, 7.123456789e-12]))
    (tmp_path / "W1.SUM").write_text(text())
    read = read_sum_landmarks(tmp_path / "W1.SUM")
    rounded = [[float(f"{value:.9e}") for value in row] for row in AXES]
    np.testing.assert_array_equal(read.T_cam_body.rotation, rounded)
    assert read.time_s == (datetime(2015, 4, 14, 16, 26, 27, 974000) - datetime(2000, 1, 1, 12)).total_seconds()


def test_landmarks_project_onto_their_samples_and_lines_with_the_camera_of_the_images(tmp_path):
    """The camera and pose of an image's SUM file, and what the same file says of landmarks: they must agree."""
    write_spc(WORLD, tmp_path / "spc")
    files = {path.stem: path for path in spc_files(tmp_path / "spc")}
    pictures = [path for path in files.values() if path.suffix == ".SUM"]
    assert len(pictures) == 9
    for path in pictures:
        image = read_sumfile(path)
        assert image.camera.fx_px == pytest.approx(CAMERA.fx_px, rel=1e-9)
        lines = path.read_text().split("LANDMARKS\n")[1].split("LIMB")[0].splitlines()
        assert len(lines) > 10
        for line in lines:
            name, *pixel = line.split()
            uv = image.camera.project(image.T_cam_body.transform(read_lmk(files[name])))
            np.testing.assert_allclose(uv + 0.5, np.array(pixel, dtype=float), atol=0.0051)


@pytest.mark.parametrize("matrix", [None, TURNED])
def test_a_folder_has_the_tracks_that_it_was_written_of(tmp_path, matrix):
    """Through any K: the lines of sight, poses in the order of time, and the landmarks of LMK files."""
    table = opened(write_spc(WORLD, tmp_path / "spc", *([] if matrix is None else [matrix])))
    frames = WORLD.sightings.sort_values(["track", "frame"])
    np.testing.assert_array_equal(table.tracks, np.unique(frames["track"], return_inverse=True)[1])
    np.testing.assert_array_equal(table.frames, frames["frame"])
    rays = (frames[["u_px", "v_px"]].to_numpy() - [CAMERA.cx_px, CAMERA.cy_px]) / [CAMERA.fx_px, CAMERA.fy_px]
    np.testing.assert_allclose(table.rays, rays, atol=ROUNDING)
    np.testing.assert_allclose(table.points_m, WORLD.points_m[np.unique(frames["track"])], atol=1e-6)
    np.testing.assert_allclose(table.states.position_m, WORLD.positions_m, atol=1e-6)
    assert np.diff(table.states.time_s) == pytest.approx(np.full(8, 60.0))


def test_landmarks_of_a_sum_file_that_we_write_are_read(tmp_path):
    content = Sumfile(0.0, CAMERA, Pose(AXES, 1e3 * AXES @ SCOBJ_KM), np.array([0.0, 0.0, 1.0]))
    (tmp_path / "a.SUM").write_text(sumfile_text("a", content, None, {7: np.array([100.5, 900.25])}))
    (ray,) = read_sum_landmarks(tmp_path / "a.SUM").rays.values()
    np.testing.assert_allclose(CAMERA.project(np.array([*ray, 1.0])), [100.5, 900.25], atol=1e-5)


def test_a_trial_follows_the_landmarks_and_marks_those_that_are_elsewhere(tmp_path):
    scene = write_spc(WORLD, tmp_path / "spc", TURNED)
    number = int(WORLD.sightings["track"].value_counts().idxmax())
    moved = lmk_text(name_of(number), (WORLD.points_m[number] + [0.0, 0.0, 30.0]) / 1e3, {})
    (tmp_path / "spc" / "LMKFILES" / f"{name_of(number)}.LMK").write_text(moved)
    loaded = load_scenario(str(scene), ("sequence.tracks.per_frame=60",))
    camera = loaded.spec.camera.camera().pinhole
    truth, sequence = draw_real_sequence(loaded.spec.sequence, open_tracks(loaded), camera, ground_of(loaded), (3, 0))
    assert len(sequence.frames) == 9
    wrong = {track for frame, no in zip(sequence.frames, truth.wrong, strict=True) for track in frame.tracks[no]}
    assert len(wrong) == 1
    np.testing.assert_allclose(truth.points_m[wrong.pop()], WORLD.points_m[number] + [0.0, 0.0, 30.0], atol=1e-6)


def test_a_landmark_without_file_is_triangulated(tmp_path):
    scene = write_spc(WORLD, tmp_path / "spc")
    wanted = opened(scene)
    for path in sorted((tmp_path / "spc" / "LMKFILES").iterdir())[::2]:
        path.unlink()
    found = opened(scene)
    np.testing.assert_array_equal(found.points_m[1::2], wanted.points_m[1::2])
    apart = np.linalg.norm(found.points_m - wanted.points_m, axis=1)
    assert 0.0 < apart.max() < 1.0, "600 m away, 0.005 px are 2 mm, over a base line of 5 deg a frame"


def test_what_no_other_image_has_is_left_out_and_marks_and_empty_images_too(tmp_path):
    scene = write_spc(WORLD, tmp_path / "spc")
    wanted = opened(scene)
    folder = tmp_path / "spc" / "SUMFILES"
    path = min(folder.iterdir())
    path.write_text(path.read_text().replace("LIMB FITS", "XX0001    100.00    200.00\n\nLIMB FITS"))
    marked = max(folder.iterdir())
    marked.write_text(re.sub(r"(?m)^(FA\d+ .*)$", r"\1 -", marked.read_text()))
    empty, alone = text().replace("2015", "2016"), text(YY0001=(1.0, 2.0)).replace("2015", "2017")
    (folder / "A.SUM").write_text(re.sub(r"LANDMARKS\n(?s:.*)LIMB", "LANDMARKS\nLIMB", empty).replace("FA", "ZA"))
    (folder / "B.SUM").write_text(alone)
    (folder / "notes.txt").write_text("not read")
    found = opened(scene)
    np.testing.assert_array_equal(found.rays, wanted.rays)
    assert found.states == wanted.states


def test_files_lie_in_the_folder_itself_if_it_has_no_folders_of_them(tmp_path):
    scene = write_spc(WORLD, tmp_path / "spc")
    wanted, folder = opened(scene), tmp_path / "spc"
    for path in sorted(folder.rglob("*.*")):
        path.rename(folder / f"{path.stem}{path.suffix.lower()}")
    for kind in ("SUMFILES", "LMKFILES"):
        (folder / kind).rmdir()
    np.testing.assert_array_equal(opened(scene).points_m, wanted.points_m)
    assert len(dict(image_files(load_scenario(str(scene))))) == len(list(folder.iterdir()))


def test_the_content_of_every_file_decides_about_the_digest(tmp_path):
    scene = write_spc(WORLD, tmp_path / "spc")
    loaded = load_scenario(str(scene))
    files, before = dict(image_files(loaded)), images_digest(loaded)
    assert "spc/LMKFILES/FA0001.LMK" in files
    (tmp_path / "spc").rename(tmp_path / "other")
    assert images_digest(load_scenario(str(scene), ("sequence.tracks.spc=other",))) == before
    path = max((tmp_path / "other" / "LMKFILES").iterdir())
    path.write_text(path.read_text().replace("0.1000000000D+01", "0.1000000001D+01"))
    assert images_digest(load_scenario(str(scene), ("sequence.tracks.spc=other",))) != before


SUMS = {
    "row": ("FA0001    531.25    478.75", "FA0001    531.25", "line 15: 'FA0001    531.25' is no landmark"),
    "more": ("478.75", "478.75 1", "line 15: 'FA0001    531.25    478.75 1' is no landmark, sample and line"),
    "number": ("478.75", "475.2x", "line 15: '475.2x' is not a number"),
    "nan": ("478.75", "nan", "line 15: 'nan' is not a number"),
    "twice": ("GB0012", "FA0001", "line 16: the landmark 'FA0001' appears twice"),
    "section": ("LANDMARKS", "LANDMARK", "LANDMARKS: missing"),
    "cut": ("LIMB FITS\nEND FILE\n", "", "without LIMB FITS or END FILE after them: cut short"),
    "distortion": ("0.00000D+00  DIST", "0.10000D-01  DIST", "DISTORTION: only zeros are read"),
    "third": ("0.0000000000  K-MATRIX", "0.0001000000  K-MATRIX", "MMFL, K-MATRIX: only (a, b, 0), (c, d, 0)"),
    "blind": ("0.5000000000D+02", "0.0000000000D+00", "MMFL, K-MATRIX: only (a, b, 0), (c, d, 0)"),
    "axes": ("  CX  ", "  CW  ", "CX: missing: no SUM file, or cut short"),
    "time": ("2015 APR 14", "2015-04-14", "line 2: '2015-04-14 16:26:27.974' is not a time"),
}


LMKS = {
    "name": ("FA0042 ", "FA0043 ", "line 1: 'FA0043   T      0.2500  0.0500' does not begin with the name FA0042"),
    "missing": ("  VLM", "  VLN", "VLM: missing: no LMK file, or cut short"),
    "short": ("0.2000000000D+01", "", "VLM: 2 numbers, not 3"),
    "number": ("0.2000000000D+01", "0.2000000000D+O1", "VLM: '0.2000000000D+O1' is not a number"),
    "twice": ("PICTURES", "0 0 1 VLM\nPICTURES", "VLM: appears twice"),
    "binary": ("\n", "\0", "no LMK file: it has 1 lines"),
    "end": ("END FILE", "END", "END FILE: missing: no LMK file, or cut short"),
}


LMK = lmk_text("FA0042", np.array([2.0, 0.5, -0.4]), {"W1": (1.0, 2.0)})
WRONG = [
    pytest.param(read, name, content, *change, id=f"{name}-{what}")
    for read, name, content, changes in (
        (read_sum_landmarks, "W1.SUM", text(), SUMS), (read_lmk, "FA0042.LMK", LMK, LMKS),
    )
    for what, change in changes.items()
]  # fmt: skip


@pytest.mark.parametrize(("read", "name", "content", "old", "new", "said"), WRONG)
def test_wrong_files_are_refused_with_line_or_keyword(tmp_path, read, name, content, old, new, said):
    assert old in content
    refused(read, tmp_path / name, content.replace(old, new), said)


def test_a_file_that_is_cut_short_anywhere_is_refused(tmp_path):
    for read, name, content, end in (
        (read_sum_landmarks, "W1.SUM", text(), "LIMB FITS"),
        (read_lmk, "FA0042.LMK", LMK, "END FILE"),
    ):
        path = tmp_path / name
        for length in range(content.rindex(end) + len(end)):
            path.write_text(content[:length])
            with pytest.raises(BoresightError):
                read(path)
        path.write_text(content[: content.rindex(end) + len(end)])
        read(path)


def test_folders_without_tracks_are_one_line(tmp_path):
    scene = write_spc(WORLD, tmp_path / "spc")
    folder = tmp_path / "spc" / "SUMFILES"
    one, *others = sorted(folder.iterdir())
    (folder / "copy.SUM").write_bytes(one.read_bytes())
    with pytest.raises(BoresightError, match=rf"scene.yaml: .*spc: {one.name} and copy.SUM have one epoch"):
        opened(scene)
    (folder / "copy.SUM").unlink()
    for path in others:
        path.unlink()
    with pytest.raises(BoresightError, match=r"spc: no landmark is in two of its 1 SUM files"):
        opened(scene)
    with pytest.raises(BoresightError, match=r"sequence.tracks.spc: gone was not found"):
        opened(scene, "sequence.tracks.spc=gone")
    with pytest.raises(BoresightError, match=r"10 frames from frame 0 on are more than the 9 of spc"):
        opened(write_spc(WORLD, tmp_path / "spc"), "sequence.tracks.frames=10")


@pytest.mark.parametrize("matrix", [0.5 * PLAIN, PLAIN @ np.diag([1.0, -1.0, 0.0])], ids=["half", "mirrored"])
def test_a_matrix_that_contradicts_the_landmarks_is_refused(tmp_path, matrix):
    scene = write_spc(WORLD, tmp_path / "spc")
    for path in (tmp_path / "spc" / "SUMFILES").iterdir():
        old, new = ("".join(f"{value:16.10f}" for value in one.ravel()) for one in (PLAIN, matrix))
        assert old in path.read_text()
        path.write_text(path.read_text().replace(old, new))
    with pytest.raises(BoresightError, match=r"spc: W\d+.SUM: half of its \d+ landmarks .* check MMFL, K-MATRIX"):
        opened(scene)


def test_landmarks_of_another_body_are_refused(tmp_path):
    scene = write_spc(WORLD, tmp_path / "spc")
    for number, point in enumerate(WORLD.points_m):
        path = tmp_path / "spc" / "LMKFILES" / f"{name_of(number)}.LMK"
        if path.is_file():
            path.write_text(lmk_text(name_of(number), (np.array([0.0, 0.0, 40.0]) + point) / 1e3, {}))
    with pytest.raises(BoresightError, match=r"SUM: half of its \d+ landmarks .* pose and VLM"):
        opened(scene)


def test_parallax_is_wanted_of_landmarks_without_file_alone(tmp_path):
    scene = write_spc(WORLD, tmp_path / "spc")
    folder = tmp_path / "spc"
    for path in sorted((folder / "SUMFILES").iterdir()):
        path.unlink()
    for hour in (16, 17):
        seen = {"FA0001": CENTRE}
        content = sum_text("W1", datetime(2015, 4, 14, hour), SCOBJ_KM, AXES, seen)
        (folder / "SUMFILES" / f"{hour}.SUM").write_text(content)
    np.testing.assert_allclose(opened(scene).points_m, WORLD.points_m[1:2], atol=1e-6)
    (folder / "LMKFILES" / "FA0001.LMK").unlink()
    with pytest.raises(BoresightError, match=r"spc: .*spc cannot be used: 1 tracks have no parallax, the first in"):
        opened(scene)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ("spc: spc, table: tracks.csv", "give either table or spc, not both"),
        ("spc: spc, poses: poses.csv", "give either poses or spc, not both"),
        ("per_frame: 12", "give either table or spc"),
        ("table: tracks.csv", "give either poses or spc"),
    ],
)
def test_a_folder_takes_the_place_of_both_tables(tmp_path, keys, said):
    scene = write_spc(WORLD, tmp_path / "spc")
    scene.write_text(scene.read_text().replace("spc: spc, per_frame: 12", keys))
    with pytest.raises(BoresightError, match=said):
        load_scenario(str(scene))

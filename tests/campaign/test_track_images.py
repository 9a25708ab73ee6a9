"""``boresight tracks``: tracks through images of known poses, their tables, and what is refused."""

from __future__ import annotations

import itertools

import cv2
import numpy as np
import pandas as pd
import pytest
from posed_spheres import FOCAL_PX, SIDE_PX, met, poses, write_posed

from boresight.campaign.cli import main
from boresight.estimators.slam.vision.image_tracks import _joined

# OpenCV has the centre of the first pixel at (0, 0).
K = np.array([[FOCAL_PX, 0.0, SIDE_PX / 2 - 0.5], [0.0, FOCAL_PX, SIDE_PX / 2 - 0.5], [0.0, 0.0, 1.0]])
SEQUENCE = """\
extends: my_images.yaml
images: null
sequence:
  tracks: {table: tracks/tracks.csv, poses: tracks/poses-ref.csv, per_frame: 40, sigma_px: 0.3}
  knowledge: {range_sigma_m: 0.5}
"""
CAMPAIGN = """\
title: Images followed
experiment: sequence
scenarios: [sequence.yaml]
estimators: [dead-reckoning, fixed-lag]
trials: 3
seed: 5
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("posed")
    write_posed(folder)
    assert main(["tracks", str(folder / "my_images.yaml"), "--out", str(folder / "tracks")]) == 0
    return folder


@pytest.fixture(scope="module")
def tracks(folder):
    return pd.read_csv(folder / "tracks" / "tracks.csv", comment="#")


def errors_px(tracks):
    """Errors of sightings in later images, of the surface points of the first, by OpenCV's projection."""
    positions_m, rotations = poses()
    uv = tracks[["u_px", "v_px"]].to_numpy() - 0.5
    first = tracks.groupby("track").cumcount().to_numpy() == 0
    points = np.empty((first.sum(), 3))
    for frame in tracks["frame"][first].unique():
        own = (tracks["frame"][first] == frame).to_numpy()
        rays = cv2.undistortPoints(uv[first][own][:, None], K, None)[:, 0]
        points[own] = met(positions_m[frame], np.c_[rays, np.ones(len(rays))] @ rotations[frame])
    found = []
    for number, frame, place in zip(tracks["track"][~first], tracks["frame"][~first], uv[~first], strict=True):
        turn, shift = cv2.Rodrigues(rotations[frame])[0], -rotations[frame] @ positions_m[frame]
        found.append(np.linalg.norm(cv2.projectPoints(points[number][None], turn, shift, K, None)[0][0, 0] - place))
    return np.array(found)


def test_tracks_are_where_the_surface_points_of_their_first_sightings_are(tracks):
    error = errors_px(tracks)
    assert np.median(error) < 0.3
    assert np.mean(error > 2.0) < 0.03
    assert tracks["track"].nunique() > 100
    assert (np.diff(np.unique(tracks["track"])) == 1).all()


def test_frames_are_in_the_order_of_time_and_places_come_back_after_a_gap(folder, tracks):
    table = pd.read_csv(folder / "tracks" / "poses-ref.csv", comment="#")
    assert table["time_s"].tolist() == [60.0 * k for k in range(7)]
    np.testing.assert_allclose(table[["x_m", "y_m", "z_m"]], poses()[0], atol=1e-6)
    back = set(tracks["track"][tracks["frame"] == 6]) & set(tracks["track"][tracks["frame"] == 0])
    assert len(back) > 20


def test_estimators_follow_the_images(folder):
    (folder / "sequence.yaml").write_text(SEQUENCE)
    (folder / "campaign.yaml").write_text(CAMPAIGN)
    out = folder / "out"
    assert main(["run", str(folder / "campaign.yaml"), "--jobs", "1", "--no-report", "--out", str(out)]) == 0
    rows = pd.read_parquet(out / "rows").set_index("estimator")
    assert (rows["status"] == "ok").all()
    # The last image is 27 deg from the one before: half of a displacement of 420 m is the error of its prediction.
    assert rows.loc["fixed-lag", "position_error_m"].max() < 15.0
    assert rows.loc["dead-reckoning", "position_error_m"].min() > 50.0


def test_positions_and_the_shape_play_no_part_in_the_matching(folder, tracks, tmp_path):
    table = pd.read_csv(folder / "pictures" / "poses.csv")
    for axis in ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m"):
        table[f"off_{axis}"] = table[f"ref_{axis}"]
    table["off_tx_m"] += 300.0 * np.arange(len(table))
    table.to_csv(folder / "pictures" / "more.csv", index=False)
    words = ["--set", "images.table=more.csv", "--set", "images.also_score=[off]", "--set", "body.shape=contact-binary"]
    words += ["--attitudes", "off", "--out", str(tmp_path)]
    assert main(["tracks", str(folder / "my_images.yaml"), *words]) == 0
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "tracks.csv", comment="#"), tracks)
    assert (tmp_path / "poses-off.csv").exists()


def test_images_are_matched_with_those_after_them_alone(folder, tmp_path):
    assert main(["tracks", str(folder / "my_images.yaml"), "--following", "1", "--out", str(tmp_path)]) == 0
    table = pd.read_csv(tmp_path / "tracks.csv", comment="#")
    gaps = table.groupby("track")["frame"].diff().dropna()
    assert (gaps == 1).all()


def test_the_other_side_matches_nothing_by_chance(tmp_path, capsys):
    write_posed(tmp_path, (0.0, 6.0, 180.0, 186.0))
    assert main(["tracks", str(tmp_path / "my_images.yaml"), "--angle", "180", "--out", str(tmp_path / "t")]) == 0
    said = capsys.readouterr().out
    # The Sun is over the first two: the others are dark but for a limb.
    assert "1 of 6 pairs of images match" in said
    assert "none goes on from 1.png to 2.png, 0.0167 h later" in said


@pytest.mark.parametrize(
    ("change", "words", "said"),
    [
        (None, ["quickstart"], "images: missing, so there is nothing to track"),
        (lambda t: t[:1], [], "a track needs two images, but 6.png is the only one"),
        (lambda t: t.assign(time_s=7.0), [], "6.png and 5.png have the same time, 7 s"),
        (lambda t: t.drop(columns="time_s"), [], "missing column time_s"),
        (None, ["--attitudes", "label"], "--attitudes label: is none of the poses of the images: ref"),
        (None, ["--features", "0"], "0 is below 1"),
        (None, ["--epipolar", "nan"], "nan is not above 0"),
        (None, ["--angle", "0"], "nothing is tracked: "),
    ],
)  # fmt: skip
def test_what_cannot_be_tracked_is_refused(folder, tmp_path, refused, change, words, said):
    name = str(folder / "my_images.yaml")
    if change is not None:
        change(pd.read_csv(folder / "pictures" / "poses.csv")).to_csv(folder / "pictures" / "changed.csv", index=False)
        words = [*words, "--set", "images.table=changed.csv"]
    words = words if words[:1] == ["quickstart"] else [name, *words]
    line = refused("tracks", *words, "--out", tmp_path)
    assert said in line
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("change", [lambda grey: 0 * grey, lambda grey: np.full_like(grey, 90)])
def test_images_without_features_are_refused(tmp_path, refused, change):
    name = write_posed(tmp_path, (0.0, 6.0))
    for file in (tmp_path / "pictures").glob("*.png"):
        cv2.imwrite(str(file), change(cv2.imread(str(file), cv2.IMREAD_UNCHANGED)))
    assert "nothing is tracked: 0 to 0 features in an image" in refused("tracks", name, "--out", tmp_path / "t")


def test_images_from_one_place_have_no_parallax(tmp_path, refused):
    name = write_posed(tmp_path, (0.0, 1e-5))
    assert "1 of 1 pairs of images match, but no track has a parallax" in refused("tracks", name, "--out", tmp_path)


def test_a_track_at_two_places_of_an_image_is_left_out():
    # Places: two in image 0, two in image 1, two in image 2; 0-2-4 is a track, 1-3, 3-5 and 5-0 would join both.
    image = np.array([0, 0, 1, 1, 2, 2])
    angles = np.radians([0.0, 0.0, 5.0, 5.0, 10.0, 10.0])
    rays = np.stack([np.cos(angles), np.sin(angles), np.zeros(6)], axis=1)
    rows, tracks = _joined(np.array([[1, 3], [3, 5], [0, 2], [2, 4]]), image, rays, 1e-3)
    assert rows.tolist() == [0, 2, 4, 1, 3, 5]
    assert tracks.tolist() == [0, 0, 0, 1, 1, 1]
    assert not len(_joined(np.array([[0, 2], [2, 4], [4, 1]]), image, rays, 1e-3)[0])
    # Lines of sight that differ by 5 deg.
    pair = np.array([[0, 2]])
    assert len(_joined(pair, image, rays, np.radians(4.99))[0]) == 2
    assert not len(_joined(pair, image, rays, np.radians(5.01))[0])


def test_numbers_of_tracks_follow_their_first_images(tracks):
    begins = tracks.groupby("track")["frame"].first()
    assert all(a <= b for a, b in itertools.pairwise(begins))


def test_without_the_tables_the_campaign_names_the_command(tmp_path, refused, monkeypatch):
    monkeypatch.setenv("BORESIGHT_DATA", str(tmp_path))
    said = refused("run", "navcam67p-slam", "--out", tmp_path / "out")
    assert "boresight fetch navcam67p-slam brings them" in said
    assert "to make them: boresight tracks navcam67p-views --attitudes label" in said

"""The landmark data base: round trips, refusals, and building it from candidates."""

import json

import numpy as np
import pandas as pd
import pytest
import trimesh
from pydantic import ValidationError

from boresight.estimators.landmark.database import (
    DatabaseOptions,
    LandmarkDatabase,
    database_from_candidates,
    extract_candidates,
)
from boresight.scenarios.errors import BoresightError

OCTAHEDRON = 100.0 * np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)], dtype=float)
ABOVE_M = np.tile([0.0, 0.0, 1000.0], (40, 1))
FACETS = [(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4), (2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5)]


def octahedron(**changes):
    rng = np.random.default_rng(1)
    spread = rng.normal(size=(6, 3, 5))
    values = {
        "means_m": OCTAHEDRON + rng.normal(size=(6, 3)) / 3.0,
        "covariances_m2": spread @ np.swapaxes(spread, 1, 2) / 7.0,
        "n_observations": np.arange(24, 30),
        "facets": np.array(FACETS),
        "provenance": {"method": "by hand", "options": {"images": 6}},
    }
    return LandmarkDatabase(**(values | changes))


def test_a_saved_data_base_comes_back_bit_for_bit(tmp_path):
    database = octahedron()
    database.save(tmp_path / "db")
    again = LandmarkDatabase.load(tmp_path / "db")
    assert np.array_equal(again.means_m, database.means_m)
    assert np.array_equal(again.n_observations, database.n_observations)
    assert np.array_equal(again.facets, database.facets)
    upper = np.triu_indices(3)
    assert np.array_equal(again.covariances_m2[:, *upper], database.covariances_m2[:, *upper])
    assert again.provenance == database.provenance


def test_the_files_can_be_read_without_boresight(tmp_path):
    octahedron().save(tmp_path)
    landmarks = pd.read_csv(tmp_path / "landmarks.csv")
    facets = pd.read_csv(tmp_path / "facets.csv")
    assert list(landmarks.columns[:3]) == ["x_m", "y_m", "z_m"]
    assert len(landmarks.columns) == 10
    mesh = trimesh.Trimesh(landmarks[["x_m", "y_m", "z_m"]].to_numpy(), facets.to_numpy(), process=False)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(octahedron().mesh().volume_m3)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"means_m": OCTAHEDRON * np.nan}, "NaN or infinite"),
        ({"means_m": OCTAHEDRON[:5]}, "landmarks need"),
        ({"covariances_m2": np.tile(np.diag([1.0, 1.0, -1.0]), (6, 1, 1))}, "landmark 0 is not positive definite"),
        ({"covariances_m2": np.tile(np.eye(3) + np.eye(3, k=1), (6, 1, 1))}, "not positive definite"),
        ({"facets": np.array(FACETS[:-1])}, "no closed surface"),
        ({"facets": np.array([*FACETS[:-1], (0, 5, 3)])}, "no closed surface"),
        ({"facets": np.array([*FACETS[:-1], (0, 3, 6)])}, "names landmark 6"),
    ],
)
def test_wrong_content_is_refused(changes, message):
    with pytest.raises(BoresightError, match=message):
        octahedron(**changes)


def spoil(folder, file, old, new):
    path = folder / file
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("landmarks.csv", "x_m", "x_km", "columns must be"),
        ("landmarks.csv", ",24\n", ",nan\n", r"landmarks.csv:2: n_observations is no finite number"),
        ("landmarks.csv", ",24\n", ",24.5\n", "n_observations must be whole"),
        ("landmarks.csv", ",24\n", ",24,3\n", "landmarks.csv"),
        ("facets.csv", "0,2,4", "0,2,x", "facets.csv:2: k is no finite number"),
        ("facets.csv", "0,2,4", "0,2,9", "names landmark 9"),
        ("facets.csv", "0,2,4\n", "", "no closed surface"),
        ("database.json", "boresight-landmarks", "something", "is not format"),
        ("database.json", '"version": 1', '"version": 2', "version 1"),
        ("database.json", "{", "[", "cannot be read"),
    ],
)
def test_a_spoilt_file_is_refused_with_its_name(tmp_path, file, old, new, message):
    octahedron().save(tmp_path)
    spoil(tmp_path, file, old, new)
    with pytest.raises(BoresightError, match=message) as caught:
        LandmarkDatabase.load(tmp_path)
    assert str(tmp_path) in str(caught.value)


@pytest.mark.parametrize("file", ["landmarks.csv", "facets.csv", "database.json"])
def test_a_missing_or_empty_file_is_refused(tmp_path, file):
    octahedron().save(tmp_path)
    (tmp_path / file).write_text("")
    with pytest.raises(BoresightError, match=file):
        LandmarkDatabase.load(tmp_path)
    (tmp_path / file).unlink()
    with pytest.raises(BoresightError, match=file):
        LandmarkDatabase.load(tmp_path)


def test_a_data_base_is_frozen():
    database = octahedron()
    with pytest.raises(ValueError, match="read-only"):
        database.means_m[0, 0] = 1.0
    with pytest.raises(AttributeError):
        database.facets = np.zeros((0, 3))


def candidates(images=40, seed=3, members=1):
    """Corners of ``images`` images around the six corners of an octahedron, and strays."""
    rng = np.random.default_rng(seed)
    clouds = []
    for _ in range(images):
        seen = OCTAHEDRON + rng.normal(0.0, 0.3, (members, 6, 3))
        stray = rng.normal(size=(5, 3))
        clouds.append(np.concatenate([seen.reshape(-1, 3), 60.0 * stray]))
    return clouds


def test_candidates_become_landmarks_and_a_mesh():
    database = database_from_candidates(candidates(), ABOVE_M[:40], DatabaseOptions())
    order = np.linalg.norm(database.means_m[:, None] - OCTAHEDRON[None], axis=2).argmin(axis=0)
    assert sorted(order) == list(range(6))
    assert np.abs(database.means_m[order] - OCTAHEDRON).max() < 0.3
    assert (database.n_observations == 40).all()
    assert len(database.facets) == 8
    sigma = np.sqrt(np.einsum("nii->n", database.covariances_m2) / 3.0)
    np.testing.assert_allclose(sigma, np.hypot(0.3, 0.1), rtol=0.15)
    assert json.loads(json.dumps(database.provenance))["candidates"] == 40 * 11


def test_rays_meet_at_the_corner_where_they_end_before_it():
    """Of corners hidden by what stands before them the means lie towards the cameras, and the rays still meet there."""
    rng = np.random.default_rng(5)
    # Cameras of the octahedron's upper half, as its corners there are seen from outside alone.
    cameras = 1000.0 * normalised(rng.normal(size=(60, 3)) + np.array([0.0, 0.0, 1.5]))
    top = OCTAHEDRON[OCTAHEDRON[:, 2] >= 0.0]
    to_camera = normalised(cameras[:, None] - top)
    ends = top + rng.exponential(1.0, (60, len(top), 1)) * to_camera + rng.normal(0.0, 0.05, to_camera.shape)
    clouds = [np.concatenate([seen, OCTAHEDRON[OCTAHEDRON[:, 2] < 0.0]]) for seen in ends]
    off_m = {}
    for position in ("mean", "rays"):
        options = DatabaseOptions(position=position, clusters={"seed_radius_m": 4.0})
        means = database_from_candidates(clouds, cameras, options).means_m
        off_m[position] = [np.linalg.norm(means - corner, axis=1).min() for corner in top]
    assert min(off_m["mean"]) > 0.4
    assert max(off_m["rays"]) < 0.1


def normalised(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def test_an_image_counts_once_for_a_landmark():
    # Three corners in each of ten images are thirty corners, but only ten observations.
    with pytest.raises(BoresightError, match="0 landmarks came out"):
        database_from_candidates(candidates(10, members=3), ABOVE_M[:10], DatabaseOptions(min_observations=11))
    database = database_from_candidates(candidates(10, members=3), ABOVE_M[:10], DatabaseOptions(min_observations=10))
    assert (database.n_observations == 10).all()


def test_no_candidates_are_refused_in_one_line():
    with pytest.raises(BoresightError, match="0 landmarks came out of 0 corners in 2 images") as caught:
        database_from_candidates([np.empty((0, 3))] * 2, ABOVE_M[:2], DatabaseOptions())
    assert "\n" not in str(caught.value)


def test_corners_that_see_the_sky_are_left_out():
    image = np.zeros((128, 128), dtype=np.float32)
    image[40:70, 50:90] = 1.0
    options = DatabaseOptions(corners={"self_similarity_max": 1.0, "min_relative_strength": 0.01})

    def left_half_is_sky(uv_px):
        points = np.column_stack([uv_px, np.full(len(uv_px), 7.0)])
        points[uv_px[:, 0] < 64.0] = np.nan
        return points

    points = extract_candidates(image, left_half_is_sky, options)
    assert len(points) == 2
    assert np.abs(points[:, 0] - 90.0).max() < 2.0
    assert extract_candidates(np.zeros_like(image), left_half_is_sky, options).shape == (0, 3)


def test_wrong_options_are_refused():
    for wrong in ({"images": 0}, {"phase_deg_max": 200.0}, {"seed_radius": 2.0}, {"clusters": {"seed_radius_m": 0.0}}):
        with pytest.raises(ValidationError):
            DatabaseOptions(**wrong)

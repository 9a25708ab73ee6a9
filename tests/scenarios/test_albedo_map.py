"""Albedo by a map, against analytic maps."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import trimesh

from boresight.scenarios.bodies import body_digest, load_body
from boresight.scenarios.bodies.albedo import with_albedo_map
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import TriangleMesh
from boresight.scenarios.known import known_on_board
from boresight.scenarios.load import load_scenario
from boresight.scenarios.onboard import onboard_spec
from boresight.scenarios.spec.body import AlbedoMapSpec, AlbedoSpec, BodySpec, DetailSpec

HEIGHT = 90  # rows of 2 deg


def centres(left_deg=-180.0, height=HEIGHT):
    """East longitude and latitude of the pixels' centres, rad, (H, 2 H) each."""
    longitude = left_deg + (np.arange(2 * height) + 0.5) * 180.0 / height
    latitude = 90.0 - (np.arange(height) + 0.5) * 180.0 / height
    return np.radians(np.meshgrid(longitude, latitude))


def write(path, values, kind=np.uint16):
    cv2.imwrite(str(path), np.round(values).astype(kind))
    return path


def ball():
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=100.0)
    return TriangleMesh(np.array(mesh.vertices), np.array(mesh.faces))


def smooth(directions):
    """Depend on the direction with no singularity at the poles: its mean over the sphere is 1."""
    x, y, z = directions.T
    return 1.0 + 0.3 * x - 0.2 * y + 0.25 * z + 0.2 * x * y


@pytest.mark.parametrize("left_deg", [-180.0, 0.0, 30.0])
@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_a_smooth_map_is_interpolated_to_second_order_everywhere(tmp_path, left_deg, suffix):
    longitude, latitude = centres(left_deg)
    directions = np.stack(
        [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)]
    )
    path = write(tmp_path / f"map{suffix}", 30000.0 * smooth(directions.reshape(3, -1).T).reshape(longitude.shape))
    mesh = ball()
    spec = AlbedoMapSpec(file="map", left_deg=left_deg)
    found = with_albedo_map(mesh, spec, path).albedo
    # Bilinear: an eighth of the squared step times the second derivatives, at most 1 here in each direction.
    step_rad = np.pi / HEIGHT
    bound = 2.0 * step_rad**2 / 8.0 + 1.0 / 30000.0 + 1e-3 * step_rad**2
    error = found - smooth(np.asarray(mesh.vertices_m) / 100.0)
    assert np.abs(error).max() < bound
    near_pole = np.abs(mesh.vertices_m[:, 2]) > 100.0 * np.cos(step_rad)
    assert near_pole.sum() >= 2
    np.testing.assert_allclose(error[near_pole], 0.0, atol=bound)


def test_cosine_of_longitude_across_the_seam(tmp_path):
    longitude, _ = centres()
    path = write(tmp_path / "map.png", 20000.0 + 10000.0 * np.cos(longitude))
    degrees = np.array([-180.0, -179.9, 179.0, 179.5, 180.0, -90.0, 0.0, 63.7])
    around = np.radians(degrees)
    points = 50.0 * np.stack([np.cos(around), np.sin(around), 0.0 * around], axis=1)
    mesh = TriangleMesh(points, np.array([[0, 1, 2]]))
    found = with_albedo_map(mesh, AlbedoMapSpec(file="map", unity=20000.0), path).albedo
    np.testing.assert_allclose(found, 1.0 + 0.5 * np.cos(around), atol=0.5 * (np.pi / HEIGHT) ** 2 / 8.0 + 1e-4)
    assert found[0] == pytest.approx(found[4], abs=1e-12)


def test_at_the_pole_the_rows_on_both_sides_are_averaged(tmp_path):
    values = np.full((4, 8), 100.0)
    values[0] = [10, 20, 30, 40, 50, 60, 70, 80]
    path = write(tmp_path / "map.png", values, np.uint8)
    # Longitude of the first pixel's centre, from just beside the pole: half of it and half of the pixel opposite.
    longitude = np.radians(-180.0 + 22.5)
    beside = [1e-9 * np.cos(longitude), 1e-9 * np.sin(longitude), 1.0]
    mesh = TriangleMesh(np.array([beside, [1.0, 0, 0], [0, 1.0, 0]]), np.array([[0, 1, 2]]))
    found = with_albedo_map(mesh, AlbedoMapSpec(file="map", unity=1.0), path).albedo
    assert found[0] == pytest.approx(0.5 * (10 + 50), rel=1e-6)


def test_the_mean_is_that_over_the_sphere(tmp_path):
    _, latitude = centres()
    # Bright caps beyond 60 deg: 2 (1 - sin 60 deg) / 2 of the sphere.
    path = write(tmp_path / "map.png", np.where(np.abs(latitude) > np.radians(60.0), 200.0, 100.0), np.uint8)
    share = 1.0 - np.sin(np.radians(60.0))
    found = with_albedo_map(ball(), AlbedoMapSpec(file="map"), path).albedo
    assert found.min() == pytest.approx(1.0 / (1.0 + share), rel=1e-3)
    assert found.max() == pytest.approx(2.0 / (1.0 + share), rel=1e-3)


def test_the_map_multiplies_the_drawn_albedo(tmp_path):
    longitude, _ = centres()
    write(tmp_path / "map.png", 100.0 + 50.0 * np.sin(longitude), np.uint8)
    drawn = BodySpec(shape="sphere", detail=DetailSpec(facets=5000, albedo=AlbedoSpec(sigma=0.2)))
    chart = AlbedoMapSpec(file="map.png")
    both = load_body(drawn.model_copy(update={"albedo_map": chart}), [tmp_path])
    alone = load_body(BodySpec(shape="sphere", detail=DetailSpec(facets=5000), albedo_map=chart), [tmp_path])
    np.testing.assert_allclose(both.mesh.albedo, alone.mesh.albedo * load_body(drawn).mesh.albedo)
    np.testing.assert_array_equal(both.mesh.vertices_m, load_body(drawn).mesh.vertices_m)


@pytest.mark.parametrize(
    ("name", "values", "words"),
    [
        ("wide.png", np.ones((4, 9)), "twice as wide as high, not 9 x 4; resample it"),
        ("colour.png", np.arange(1, 97).reshape(4, 8, 3), "grey image .* not 8 x 4 x 3"),
        ("holes.png", np.pad(np.ones((3, 8)), ((0, 1), (0, 0))), "8 pixels .* above 0, the first in row 3, column 0"),
    ],
)  # fmt: skip
def test_a_map_that_is_none_is_refused(tmp_path, name, values, words):
    write(tmp_path / name, values, np.uint8)
    with pytest.raises(BoresightError, match=rf"{name}: .*{words}"):
        load_body(BodySpec(shape="sphere", albedo_map=AlbedoMapSpec(file=name)), [tmp_path])


def test_a_file_that_is_missing_or_no_image_is_refused(tmp_path):
    (tmp_path / "text.png").write_text("no image")
    for name, words in (("nowhere.png", r"body\.albedo_map\.file: nowhere\.png was not found"), ("text.png", "not a")):
        with pytest.raises(BoresightError, match=words):
            load_body(BodySpec(shape="sphere", albedo_map=AlbedoMapSpec(file=name)), [tmp_path])


def test_the_digest_has_the_map_if_there_is_one(tmp_path):
    write(tmp_path / "map.png", np.full((4, 8), 9.0), np.uint8)
    plain = BodySpec(shape="sphere")
    assert "albedo_map" not in plain.model_dump()
    specs = [AlbedoMapSpec(file="map.png"), AlbedoMapSpec(file="map.png", left_deg=0.0)]
    specs.append(AlbedoMapSpec(file="map.png", unity=9.0))
    digests = {body_digest(plain.model_copy(update={"albedo_map": one}), [tmp_path]) for one in specs}
    write(tmp_path / "map.png", np.full((4, 8), 10.0), np.uint8)
    digests |= {body_digest(plain), body_digest(plain.model_copy(update={"albedo_map": specs[0]}), [tmp_path])}
    assert len(digests) == 5


def test_on_board_the_map_is_known_or_taken_as_uniform():
    given = ["body.albedo_map={file: map.png}"]
    spec = load_scenario("quickstart", given).spec
    assert onboard_spec(spec).body.albedo_map == spec.body.albedo_map
    assert "albedo variation" in known_on_board(spec).line().split("Imperfect")[0]
    uniform = load_scenario("quickstart", [*given, "onboard.albedo=uniform"]).spec
    assert onboard_spec(uniform).body.albedo_map is None
    assert "albedo variation (taken as uniform)" in known_on_board(uniform).line().split("Imperfect")[1]


def test_craters_have_no_albedo():
    with pytest.raises(BoresightError, match=r"leave out body\.albedo_map"):
        load_scenario("eros-like-crater-images", ["body.albedo_map={file: map.png}"])

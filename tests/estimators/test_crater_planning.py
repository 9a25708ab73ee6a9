"""Image planning: hand-computed geometry on an ellipsoid, and the plan file."""

from __future__ import annotations

import numpy as np
import pytest
from crater_looks import CAMERA, ellipsoid
from scipy.spatial.transform import Rotation

from boresight.estimators.craters.planning import Ephemeris, plan_images, read_plan, with_telemetry, write_plan
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Pose

RANGE_M = 200e3
AXES_M = np.array([17e3, 8.5e3, 6e3])


@pytest.fixture(scope="module")
def ground():
    return ellipsoid(4)


def _ephemeris(count: int, sun: tuple[float, float, float] = (1.0, 0.0, 0.0)) -> Ephemeris:
    time = 600.0 * np.arange(count)
    angle = 2.0 * np.pi * np.arange(count) / count
    orbit = RANGE_M * np.column_stack([np.cos(angle), np.zeros(count), np.sin(angle)])
    spin = Rotation.from_rotvec(np.outer(3.3e-4 * time, [0.0, 0.0, -1.0])).as_matrix()
    return Ephemeris(time, orbit, spin, np.tile(np.array(sun) / np.linalg.norm(sun), (count, 1)))


def test_boresights_meet_lit_ground_of_the_kind_they_are_planned_for(ground) -> None:
    ephemeris = _ephemeris(90, (1.0, 0.5, 0.2))
    images = plan_images(ephemeris, ground)
    assert {image.kind for image in images} == {"nadir", "limb", "terminator"}
    assert [image.number for image in images] == list(range(len(images)))
    for image in images:
        epoch = int(np.searchsorted(ephemeris.time_s, image.time_s))
        attitude = ephemeris.R_body_inertial[epoch]
        position, sun = attitude @ ephemeris.position_inertial_m[epoch], attitude @ ephemeris.sun_dir_inertial[epoch]
        rotation = image.planned_R_cam_inertial @ attitude.T
        uv = CAMERA.project(Pose(rotation, -rotation @ position).transform(image.target_body_m))
        np.testing.assert_allclose(uv, [CAMERA.cx_px, CAMERA.cy_px], atol=1e-6)
        normal = image.target_body_m / AXES_M**2  # of the ellipsoid that the facets stand for
        normal /= np.linalg.norm(normal)
        towards = (position - image.target_body_m) / np.linalg.norm(position - image.target_body_m)
        emission, incidence = np.degrees(np.arccos([normal @ towards, normal @ sun]))
        assert incidence < 83.0
        if image.kind == "nadir":
            assert np.linalg.norm(np.cross(image.target_body_m, position)) < 1e-6 * np.linalg.norm(position) * 2e4
        elif image.kind == "limb":
            assert 47.0 < emission < 73.0
        else:
            assert 52.0 < incidence < 78.0
        # Relative to the nadir: the third component is minus the cosine of the phase angle at the body's centre.
        assert image.sun_dir_nadir[2] == pytest.approx(-position @ sun / np.linalg.norm(position))


def test_the_dark_side_has_no_nadir_and_an_orbit_behind_the_body_no_image(ground) -> None:
    count = 8
    ephemeris = _ephemeris(count)
    behind = Ephemeris(
        ephemeris.time_s,
        np.tile([-RANGE_M, 0.0, 0.0], (count, 1)),
        np.broadcast_to(np.eye(3), (count, 3, 3)),
        ephemeris.sun_dir_inertial,
    )
    assert plan_images(behind, ground) == ()
    assert with_telemetry((), np.zeros((0, 3))) == ()
    with pytest.raises(BoresightError, match="epochs need"):
        Ephemeris(
            ephemeris.time_s, ephemeris.position_inertial_m[:3], behind.R_body_inertial, ephemeris.sun_dir_inertial
        )


def test_a_plan_with_its_telemetry_is_read_back_exactly(ground, tmp_path) -> None:
    planned = plan_images(_ephemeris(40, (0.6, 0.3, 0.4)), ground)
    turned = np.random.default_rng(1).normal(0.0, 1e-4, (len(planned), 3))
    images = with_telemetry(planned, turned)
    for image, turn in zip(images, turned, strict=True):
        error = Rotation.from_matrix(image.actual_R_cam_inertial @ image.planned_R_cam_inertial.T).as_rotvec()
        np.testing.assert_allclose(error, turn, atol=1e-12)
    write_plan(tmp_path / "plan.txt", images)
    for one, other in zip(read_plan(tmp_path / "plan.txt"), images, strict=True):
        assert (one.number, one.time_s, one.kind) == (other.number, other.time_s, other.kind)
        for name in ("target_body_m", "planned_R_cam_inertial", "actual_R_cam_inertial", "sun_dir_nadir"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    lines = (tmp_path / "plan.txt").read_text().splitlines()
    for wrong, said in (
        ([*lines, lines[1]], "image 0 is listed twice"),
        ([lines[0], lines[1].replace(images[0].kind, "zenith")], r"plan.txt:2: 'zenith' is no kind of image"),
        ([lines[0], "image 1 2 nadir"], "an? image has 27 fields"),
    ):
        (tmp_path / "wrong.txt").write_text("\n".join(wrong) + "\n")
        with pytest.raises(BoresightError, match=said.replace("plan.txt", "wrong.txt")):
            read_plan(tmp_path / "wrong.txt")

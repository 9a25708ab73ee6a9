"""Maplets from the image to the pose, on images of a body that is finer than the shape on board."""

from copy import copy

import numpy as np
import pytest
from boulder_worlds import BoulderWorld, boulder_mesh, errors

from boresight.estimators.maplets.build import build_maplets
from boresight.estimators.maplets.database import MapletDatabase
from boresight.estimators.maplets.matching import body_mask, visible_windows
from boresight.estimators.maplets.recognizer import PRODUCT, MapletNavigator, MapletsOptions
from boresight.renderers.mitsuba3 import MitsubaRenderer
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera
from boresight.scenarios.observation import Frame, Observation
from boresight.scenarios.spec.body import RoughnessSpec
from boresight.scenarios.spec.brdf import LambertSpec

CAMERA = Camera.from_fov(256, 256, np.radians(18.3))
OPTIONS = {"maplets": {"spacing_m": 4.0, "side": 21}}
TRIALS = 8


class World(BoulderWorld):
    """Lends maplets of a shape with a quarter of the facets of the body."""

    def __init__(self):
        rough = RoughnessSpec(rms_m=0.7, max_wavelength_m=60.0)
        super().__init__(CAMERA, boulder_mesh(190_000, rough), [0.02] * 3 + [29.0] * 2 + [3.0])
        self.onboard = boulder_mesh(48_000, rough)
        self.database = build_maplets(self.onboard, MapletsOptions.model_validate(OPTIONS).maplets)


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("BORESIGHT_CACHE", str(tmp_path_factory.mktemp("cache")))
        return World()


@pytest.fixture(scope="module")
def navigator(world):
    return MapletNavigator.from_options(OPTIONS, world)


def estimate(estimator, frame):
    return estimator.estimate(Observation(CAMERA, frame), rng=np.random.default_rng(0))


@pytest.mark.parametrize(
    "noise_dn", [pytest.param(0.0, id="clean"), pytest.param(15.0, id="noisy", marks=pytest.mark.long)]
)
def test_the_pose_is_found_to_a_tenth_of_a_pixel_turn(world, navigator, noise_dn):
    """At 2.5 m a pixel and 150 m from the middle to the limb, a tenth of a pixel of parallax is a tenth of a degree."""
    found = []
    for trial in range(TRIALS):
        view, frame = world.frame(trial, noise_dn)
        result = estimate(navigator, frame)
        assert result.status == "ok", result.reason
        found.append(errors(view, result.pose))
        assert errors(view, result.pose)[1] < errors(view, frame.prior_T_cam_body)[1]
    attitude_deg, position_m = np.median(found, axis=0)
    assert attitude_deg < 0.15
    assert position_m < 6.0


def test_the_maplets_lie_where_they_are_seen(world, navigator):
    view, frame = world.frame(2)
    table = estimate(navigator, frame).details["landmarks"]
    met = world.renderer.surface(view, np.column_stack([table["u_px"], table["v_px"]])).points_body_m
    offset = met - np.column_stack([table[name] for name in ("x_m", "y_m", "z_m")])
    assert np.nanmedian(np.linalg.norm(offset, axis=1)) < 2.0
    covariance = np.empty((len(offset), 3, 3))
    names = ("sxx_m2", "sxy_m2", "sxz_m2", "syy_m2", "syz_m2", "szz_m2")
    for name, (i, j) in zip(names, zip(*np.triu_indices(3), strict=True), strict=True):
        covariance[:, i, j] = covariance[:, j, i] = table[name]
    assert np.linalg.eigvalsh(covariance).min() > 0.0
    assert (
        0.1 < np.nanmedian(np.einsum("ni,ni->n", offset, np.linalg.solve(covariance, offset[..., None])[..., 0])) < 12
    )


def test_an_estimate_holds_what_the_contract_says(world, navigator):
    _, frame = world.frame(1)
    result = estimate(navigator, frame)
    assert [stage.name for stage in result.stages] == ["alignment", "correlation", "recognition"]
    assert result.stages[-1].T_cam_body is result.pose
    for matrix in (result.covariance, result.bound):
        np.testing.assert_allclose(matrix, matrix.T, rtol=1e-6, atol=1e-18)
        assert np.linalg.eigvalsh(matrix).min() > 0.0
    assert {len(column) for column in result.details["landmarks"].values()} == {result.diagnostics["n_landmarks"]}
    assert set(result.timings_s) == {"centroid", "mesh_rendering", "correlation", "recognition"}


def test_the_depth_is_no_worse_than_the_prior_where_the_prior_is_good(world, navigator):
    """The range from the size in the image is accurate to some metres; it must not degrade a prior of 0.1 m."""
    view, frame = world.frame(3)
    sure = view.T_cam_body.perturbed(np.zeros(3), np.array([20.0, -10.0, 0.0]))
    covariance = np.diag([0.02] * 3 + [29.0] * 2 + [0.1]) ** 2
    result = estimate(navigator, Frame(frame.image, frame.sun_dir_cam, sure, covariance))
    assert abs(result.pose.translation_m[2] - view.T_cam_body.translation_m[2]) < 0.3


def test_hidden_and_averted_maplets_have_no_window(world):
    view, _ = world.frame(5)
    mesh = world.database.mesh()
    windows = visible_windows(world.database, CAMERA, view.T_cam_body, mesh.vertices_m, (8, 32))
    anchors = world.database.anchors_m
    renderer = MitsubaRenderer(mesh, LambertSpec())
    beside_px = CAMERA.project(view.T_cam_body.transform(anchors)) + 0.1  # a ray through a vertex may slip by
    met = renderer.surface(view, beside_px).points_body_m
    seen = np.linalg.norm(met - anchors, axis=1) < 10.0
    assert seen[windows.maplet].mean() > 0.95
    steep = np.einsum("ni,i->n", world.database.axes[:, 2], view.T_cam_body.camera_position_m / 2000.0) < 0.3
    assert np.isin(np.flatnonzero(seen & ~steep), windows.maplet).mean() > 0.9
    for index in range(len(windows)):
        rows, columns = windows.slices(index)
        u, v = windows.uv_px[index]
        assert columns.start <= u < columns.stop
        assert rows.start <= v < rows.stop


def test_the_mask_is_the_outline_of_the_body(world):
    view, _ = world.frame(6)
    mesh = world.database.mesh()
    towards_camera = view.T_cam_body.camera_position_m / 2000.0
    full = MitsubaRenderer(mesh, LambertSpec(), 1).render(type(view)(CAMERA, view.T_cam_body, towards_camera)) > 0.0
    outline = body_mask(mesh.vertices_m, CAMERA, view.T_cam_body, world.database.spacing_m, 0)
    assert (outline != full).sum() < 0.05 * full.sum()
    inner = body_mask(mesh.vertices_m, CAMERA, view.T_cam_body, world.database.spacing_m, 3)
    assert (inner & ~full).sum() < 0.01 * full.sum()
    assert (full & ~inner).sum() > (full & ~outline).sum() + 300


def test_the_data_base_is_asked_for_by_its_options(world):
    world.asked.clear()
    MapletNavigator.from_options(OPTIONS, world)
    ((kind, options),) = world.asked
    assert kind == PRODUCT
    assert options == {"spacing_m": 4.0, "side": 21, "separation": 0.6, "seed": None}


def test_an_image_without_the_body_fails_with_a_reason(world, navigator):
    _, frame = world.frame(1)
    noise = np.random.default_rng(1).normal(100.0, 5.0, frame.image.shape).astype(np.float32)
    noise[40:60, 180:200] += 500.0
    result = estimate(navigator, Frame(noise, frame.sun_dir_cam, frame.prior_T_cam_body, frame.prior_covariance))
    assert result.status == "failed"
    assert "maplets found" in result.reason


def test_wrong_input_is_refused(world, navigator):
    _, frame = world.frame(1)
    with pytest.raises(BoresightError, match="the image has shape"):
        estimate(navigator, Frame(frame.image[:100], frame.sun_dir_cam, frame.prior_T_cam_body, frame.prior_covariance))
    spoilt = frame.image.copy()
    spoilt[3, 3] = np.nan
    result = estimate(navigator, Frame(spoilt, frame.sun_dir_cam, frame.prior_T_cam_body, frame.prior_covariance))
    assert "NaN" in result.reason
    with pytest.raises(BoresightError, match=r"estimator lmaps: matching: .*window_px must be two ascending"):
        MapletNavigator.from_options({"matching": {"window_px": [30, 8]}}, world)
    world_of_dict = type("Wrong", (), {"camera": CAMERA, "product": lambda self, kind, options: {}})()
    with pytest.raises(BoresightError, match="is a dict"):
        MapletNavigator.from_options({}, world_of_dict)


def test_a_stored_data_base_gives_the_same_pose(world, navigator, tmp_path):
    world.database.save(tmp_path)

    stored = copy(world)
    stored.database = MapletDatabase.load(tmp_path)
    _, frame = world.frame(1)
    first, second = (estimate(e, frame).pose for e in (navigator, MapletNavigator.from_options(OPTIONS, stored)))
    assert np.degrees(first.angle_to(second)) < 0.03

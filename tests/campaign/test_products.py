"""The landmark data base as a product: its key, its cache, and that it does not depend on who built it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from threadpoolctl import threadpool_info, threadpool_limits
from tiny_campaign import DATABASE, RESULTS, SCENE, assert_same_results, compute, files, write_campaign

from boresight.campaign.kinds.single_image import KIND as KIND_OF_TRIALS
from boresight.campaign.products import BuiltAssets, landmark_database, product_key
from boresight.campaign.products.crater_database import _searched
from boresight.campaign.products.landmark_database import landmark_candidates
from boresight.campaign.threads import use_threads
from boresight.estimators.craters.contract import CraterDetections
from boresight.estimators.landmark.database import DatabaseOptions, LandmarkDatabase
from boresight.estimators.maplets.build import MapletOptions, build_maplets
from boresight.renderers.mitsuba3 import MitsubaRenderer, choose_variant
from boresight.scenarios.bodies import load_body
from boresight.scenarios.cache import default_cache
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, View, look_at
from boresight.scenarios.load import LoadedScenario, load_scenario
from boresight.scenarios.onboard import onboard_spec
from boresight.scenarios.spec.brdf import LambertSpec, LommelSeeligerSpec

KIND = landmark_database.KIND
OPTIONS = DatabaseOptions.model_validate(DATABASE)
SMALL_DATABASE = {**DATABASE, "images": 20, "min_observations": 4}
CAMERA_20 = {"width_px": 128, "height_px": 128, "fov_deg": 20.0}
CONTENT = ("landmarks.csv", "facets.csv", "database.json")


def scene(folder: Path, *overrides: str) -> LoadedScenario:
    write_campaign(folder)
    return load_scenario(str(folder / "scene.yaml"), overrides)


def key(loaded: LoadedScenario, options: DatabaseOptions = OPTIONS, variant: str = "llvm_ad_mono") -> str:
    return product_key(loaded, KIND, options, variant)


@pytest.mark.parametrize(
    "change",
    [
        "body.detail.seed=4", "body.detail.facets=30000", "body.shading=smooth", "camera.fov_deg=19",
        "camera.width_px=130", "brdf.albedo=0.2", "brdf.kind=oren-nayar", "rendering.samples_per_pixel=1",
        "viewpoint.range_m=1900", "viewpoint.altitude_m=1700",
    ],
)  # fmt: skip
def test_what_would_change_the_landmarks_changes_the_key(tmp_path, change):
    assert key(scene(tmp_path, change)) != key(scene(tmp_path))


@pytest.mark.parametrize(
    "change",
    [
        "viewpoint.roll_deg.uniform=[0, 10]", "viewpoint.latitude_deg.uniform=[-9, 9]",
        "name=other", "description=another", "lighting.phase_deg.uniform=[0, 10]", "detector.bits=10",
        "pose_error.position_cam_m.uniform=[[-5, 5], [-5, 5], [-5, 5]]",
    ],
)  # fmt: skip
def test_what_only_trials_see_leaves_the_key_alone(tmp_path, change):
    assert key(scene(tmp_path, change)) == key(scene(tmp_path))


@pytest.mark.parametrize(
    "change",
    [
        {"images": 41}, {"seed": 1}, {"phase_deg_max": 50.0}, {"min_observations": 7},
        {"clusters": {"seed_radius_m": 14.0}}, {"corners": {"k": 0.05}}, {"range_m": 1500.0},
        {"camera": {"fov_deg": 20.0}},
    ],
    ids=lambda change: next(iter(change)),
)  # fmt: skip
def test_every_option_of_the_data_base_changes_the_key(tmp_path, change):
    changed = DatabaseOptions.model_validate({**DATABASE, **change})
    assert key(scene(tmp_path), changed) != key(scene(tmp_path))


@pytest.mark.parametrize(
    ("option", "override"),
    [({"range_m": 1500.0}, "viewpoint.range_m=1500"), ({"camera": CAMERA_20}, "camera.fov_deg=20")],
    ids=["range", "camera"],
)
def test_range_and_camera_of_the_data_base_stand_for_those_of_the_scenario(tmp_path, option, override):
    """The corners found are those of a scenario with that range or camera."""
    variant = choose_variant().name
    few = {**DATABASE, "images": 2}

    def candidates(loaded, options):
        options = DatabaseOptions.model_validate(options)
        return landmark_candidates(loaded, options, None, variant).by_image

    ours = candidates(scene(tmp_path), {**few, **option})
    theirs = candidates(scene(tmp_path, override), few)
    plain = candidates(scene(tmp_path), few)
    for one, other, before in zip(ours, theirs, plain, strict=True):
        np.testing.assert_array_equal(one, other)
        assert len(one) != len(before) or not np.array_equal(one, before)


def test_the_variant_and_the_shape_file_change_the_key(tmp_path):
    loaded = scene(tmp_path)
    assert key(loaded, variant="scalar_rgb") != key(loaded, variant="llvm_ad_mono")
    (tmp_path / "scene.yaml").write_text(SCENE.replace("body:\n", "body:\n  shape: ball.obj\n"))
    keys = set()
    for radius in (200.0, 210.0):
        trimesh.creation.icosphere(subdivisions=2, radius=radius).export(tmp_path / "ball.obj")
        keys.add(key(load_scenario(str(tmp_path / "scene.yaml"))))
    assert len(keys) == 2


def test_the_range_of_real_images_changes_the_key_and_their_pixels_do_not(tmp_path):
    (tmp_path / "set").mkdir()
    (tmp_path / "scene.yaml").write_text(
        "body: {shape: sphere}\ncamera: {width_px: 48, height_px: 40, fov_deg: 18.3}\nimages: {folder: set}\n"
    )
    poses = "file,time_s,{0}_qw,{0}_qx,{0}_qy,{0}_qz,{0}_tx_m,{0}_ty_m,{0}_tz_m,sun_body_x,sun_body_y,sun_body_z\n"
    keys = []
    for grey, range_m in ((7, 2000), (8, 2000), (8, 2500)):
        cv2.imwrite(str(tmp_path / "set" / "a.png"), np.full((40, 48), grey, dtype=np.uint8))
        row = f"a.png,0,1,0,0,0,0,0,{range_m},0,0,-1\n"
        (tmp_path / "set" / "poses.csv").write_text(poses.format("ref") + row)
        keys.append(key(load_scenario(str(tmp_path / "scene.yaml"))))
    assert keys[0] == keys[1] != keys[2]


def scenario_assets(loaded: LoadedScenario, folder: Path, jobs: int, said: list[str] | None = None) -> BuiltAssets:
    return BuiltAssets(loaded, folder, jobs, choose_variant().name, (said if said is not None else []).append)


def test_a_data_base_does_not_depend_on_workers_or_cache(tmp_path, monkeypatch):
    loaded = scene(tmp_path)
    built = {}
    for name, jobs in (("one", 1), ("two", 2), ("kept", 1)):
        # "kept" takes what "two" left in the cache; the others build.
        monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path / ("cache-two" if name == "kept" else f"cache-{name}")))
        said: list[str] = []
        database = scenario_assets(loaded, tmp_path / name, jobs, said).product(KIND, SMALL_DATABASE)
        assert isinstance(database, LandmarkDatabase)
        assert bool(said) == (name != "kept")
        (folder,) = (tmp_path / name).iterdir()
        built[name] = {file: (folder / file).read_bytes() for file in CONTENT}
    assert built["one"] == built["two"] == built["kept"]


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_data_base_is_made_with_one_blas_thread_and_leaves_the_threads_as_they_were(tmp_path, monkeypatch, jobs):
    """Sums of long vectors differ in their last bits by the number of threads, which jobs and cache must not decide."""
    made = landmark_database.database_from_candidates
    during = []

    def watched(*arguments):
        during.append(blas_threads())
        return made(*arguments)

    monkeypatch.setattr(landmark_database, "database_from_candidates", watched)
    monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path / "cache"))
    with threadpool_limits(2, user_api="blas"):
        scenario_assets(scene(tmp_path), tmp_path / "run", jobs).product(KIND, SMALL_DATABASE)
        after = blas_threads()
        use_threads(1)
        at_trials = blas_threads()
    assert (during, after, at_trials) == ([{1}], {2}, {1})


def blas_threads() -> set[int]:
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


def test_landmarks_lie_on_the_body(tiny_run, tmp_path):
    (folder,) = (tiny_run.folder / "products").iterdir()
    database = LandmarkDatabase.load(folder)
    mesh = load_body(load_scenario(str(tiny_run.file.parent / "scene.yaml")).spec.body).mesh
    nearest = np.array([np.linalg.norm(mesh.vertices_m - mean, axis=1).min() for mean in database.means_m])
    # Clusters of corners seen from many sides, with pixels of 5 m and facets of 8 m.
    assert np.median(nearest) < 10.0
    assert nearest.max() < 60.0
    assert (database.n_observations >= DATABASE["min_observations"]).all()


def test_a_worker_builds_nothing(tmp_path):
    with pytest.raises(BoresightError, match="the product is missing from the run folder: run the campaign again"):
        scenario_assets(scene(tmp_path), tmp_path / "run", jobs=None).product(KIND, DATABASE)
    assert not (tmp_path / "run").exists()


def test_an_unknown_kind_of_product_is_refused(tmp_path):
    with pytest.raises(BoresightError, match=r"no product is called 'crater-map'; there are: .*landmark-database"):
        scenario_assets(scene(tmp_path), tmp_path / "run", jobs=1).product("crater-map", {})


def test_two_estimators_of_the_same_options_share_a_product(tmp_path):
    text = """\
scenarios: [scene]
estimators:
  - landmark-harris:
      label: plain
      database: &base {images: 40, min_observations: 6, clusters: {seed_radius_m: 15, sigma_floor_m: 0.1}}
  - landmark-harris:
      {label: aligned, alignment: image, database: *base}
trials: 2
seed: 5
"""
    file = write_campaign(tmp_path, text)
    compute(file, tmp_path / "run", 2)
    manifest = json.loads((tmp_path / "run" / "manifest.json").read_text())
    assert [product["estimator"] for product in manifest["products"]] == ["plain", "aligned"]
    assert len({product["folder"] for product in manifest["products"]}) == 1
    assert len(list((tmp_path / "run" / "products").iterdir())) == 1


def test_a_run_stands_alone_without_the_cache(tiny_run, tmp_path, monkeypatch):
    compute(tiny_run.file, tmp_path / "run", 10)
    before = files(tmp_path / "run", "products")
    monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path / "empty"))
    compute(tiny_run.file, tmp_path / "run")
    assert files(tmp_path / "run", "products") == before
    assert_same_results(tiny_run.folder, tmp_path / "run")
    assert KIND not in {entry.kind for entry in default_cache().entries()}, "the data base was not built again"


@pytest.mark.parametrize("place", [pytest.param("/proc/boresight", marks=pytest.mark.long), "file"])
def test_a_cache_that_cannot_be_written_does_not_break_a_run(tiny_run, tmp_path, monkeypatch, caplog, place):
    (tmp_path / "file").write_text("mine")
    monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path / place))
    compute(tiny_run.file, tmp_path / "run", KIND_OF_TRIALS.block_trials)
    assert "working without the cache" in caplog.text
    found = files(tmp_path / "run", *RESULTS)
    assert found
    assert found.items() <= files(tiny_run.folder, *RESULTS).items(), "one block of the same"


def test_all_that_is_lent_is_made_of_what_the_spacecraft_believes(tmp_path):
    """Another camera and shape on board: nothing that an estimator borrows is as in truth."""
    (tmp_path / "scene.yaml").write_text(
        SCENE + "onboard: {height_error: {rms_m: 3, min_wavelength_m: 20}, focal_error: 0.01}\n"
    )
    loaded = load_scenario(str(tmp_path / "scene.yaml"))
    known = replace(loaded, spec=onboard_spec(loaded.spec))
    lends = scenario_assets(loaded, tmp_path / "run", 1)
    shapes = [load_body(one.spec.body, one.search_dirs).mesh for one in (loaded, known)]
    options = {"spacing_m": 30.0, "side": 7}
    of_truth, of_belief = (build_maplets(mesh, MapletOptions(**options)) for mesh in shapes)
    lent = lends.product("maplets", options)
    np.testing.assert_array_equal(lends.shape().vertices_m, shapes[1].vertices_m)
    assert not np.array_equal(lends.shape().vertices_m, shapes[0].vertices_m)
    np.testing.assert_allclose(lent.centres_m, of_belief.centres_m, atol=0.01)
    same = len(lent) == len(of_truth) and np.allclose(lent.centres_m, of_truth.centres_m, atol=0.01)
    assert not same
    assert lends.camera.fx_px == pytest.approx(1.01 * loaded.spec.camera.camera().fx_px)
    believed_key = product_key(known, "maplets", MapletOptions(**options), choose_variant().name)
    assert [one.folder for one in lends.products_of("lmaps")] == [f"maplets-{believed_key}"]


def test_rendering_on_board_is_in_the_reflectance_that_is_believed(tmp_path):
    """Lambert's law is proportional to its albedo."""
    images = []
    for albedo in (0.1, 0.2):
        (tmp_path / "scene.yaml").write_text(SCENE + f"onboard: {{brdf: {{kind: lambert, albedo: {albedo}}}}}\n")
        lends = scenario_assets(load_scenario(str(tmp_path / "scene.yaml")), tmp_path / "run", 1)
        view = View(lends.camera, look_at(np.array([2000.0, 0.0, 0.0]), 0.0), np.array([1.0, 0.0, 0.0]))
        images.append(lends.mesh_renderer(lends.shape()).render(view))
    np.testing.assert_allclose(images[1], 2.0 * images[0], rtol=1e-5)
    assert images[0].any()


@pytest.mark.parametrize(
    ("believed", "other"),
    [
        ("{kind: oren-nayar}", LommelSeeligerSpec(kind="lommel-seeliger")),
        ("{kind: hapke}", LambertSpec()),
    ],
)
def test_the_other_law_darkens_the_limb_differently(tmp_path, believed, other):
    (tmp_path / "scene.yaml").write_text(SCENE + f"onboard: {{brdf: {believed}}}\n")
    assets = scenario_assets(load_scenario(str(tmp_path / "scene.yaml")), tmp_path / "run", 1).for_estimator()
    view = View(assets.camera, look_at(np.array([2000.0, 0.0, 0.0]), 0.0), np.array([0.8, 0.6, 0.0]))
    image = assets.mesh_renderer(assets.shape(), other_law=True).render(view)
    by_law = MitsubaRenderer(assets.shape(), other, 1, variant=choose_variant()).render(view)
    np.testing.assert_allclose(image, by_law, rtol=1e-5)
    assert image.any()


def test_a_detector_is_told_the_sun_in_camera_axes():
    class Finder:
        def detect(self, frame, camera):
            self.frame = frame
            return CraterDetections.none()

    view = View(
        Camera.from_fov(32, 24, 0.2), look_at(np.array([900.0, -1500.0, 700.0]), 0.4), np.array([0.6, 0.0, 0.8])
    )
    finder = Finder()
    _searched(3, SimpleNamespace(view=view, pixels=np.zeros((24, 32), dtype=np.float32)), finder, 5)
    turn = Rotation.from_matrix(view.T_cam_body.rotation)
    np.testing.assert_allclose(finder.frame.sun_dir_cam, turn.apply([0.6, 0.0, 0.8]), atol=1e-12)

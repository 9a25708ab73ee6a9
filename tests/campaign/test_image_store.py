"""The store of rendered images: every bit comes back, and what decides a pixel decides what is found."""

import json
import re

import numpy as np
import pandas as pd
import pytest
from tiny_campaign import (
    SCENE,
    SMALL,
    TRIALS,
    assert_same_results,
    boresight,
    compute,
    run,
    started,
    stop,
    wait_for_blocks,
    write_campaign,
)

from boresight.campaign.cli import main
from boresight.campaign.imaging.image_store import (
    ImageStore,
    StoredImage,
    image_set_key,
    read_images,
    store_switched,
    write_images,
)
from boresight.campaign.store import RunFolder
from boresight.renderers.mitsuba3 import choose_variant
from boresight.scenarios.cache import default_cache
from boresight.scenarios.draw import Stream
from boresight.scenarios.geometry import Camera, View, look_at
from boresight.scenarios.load import load_scenario

FEW = 12
CAMERA = Camera(64, 48, 100.0, 100.0, 32.0, 24.0)


def view(distance_m=1000.0):
    return View(CAMERA, look_at(np.array([0.0, 0.0, distance_m]), 0.3), np.array([0.0, 0.6, 0.8]))


@pytest.fixture
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path / "cache"))
    return default_cache()


class Counting:
    """Renders noise, and counts how often."""

    def __init__(self):
        self.calls = 0

    def __call__(self, view):
        self.calls += 1
        return np.random.default_rng(self.calls).random((CAMERA.height_px, CAMERA.width_px), dtype=np.float32)


def test_every_bit_comes_back(tmp_path):
    rng = np.random.default_rng(1)
    strange = np.frombuffer(rng.bytes(4 * 33 * 57), np.float32).reshape(33, 57).copy()
    strange[0, :6] = [-0.0, 0.0, np.nan, np.inf, np.finfo(np.float32).smallest_subnormal, -1.5]
    images = {7: strange, 3: np.zeros((4, 5), np.float32), 5: np.ones((1, 9), np.float32)}
    write_images(tmp_path / "a.parquet", {i: StoredImage(image, bytes([i])) for i, image in images.items()})
    found = read_images(tmp_path / "a.parquet")
    assert {i: kept.view for i, kept in found.items()} == {7: b"\7", 3: b"\3", 5: b"\5"}
    for i, image in images.items():
        np.testing.assert_array_equal(found[i].image.view(np.uint32), image.view(np.uint32))
    table = pd.read_parquet(tmp_path / "a.parquet").set_index("index")  # and pandas reads it too
    np.testing.assert_array_equal(table.loc[5, "values"], np.ones(9))


def test_an_image_is_rendered_once(own_cache):
    render = Counting()
    store = ImageStore("key", 10)
    first = [store.image(1, index, view(), render) for index in range(12)]
    store.flush()
    again = [ImageStore("key", 10).image(1, index, view(), render) for index in range(12)]
    assert [kept for _, kept in first] == [False] * 12
    assert [kept for _, kept in again] == [True] * 12
    assert render.calls == 12
    for (a, _), (b, _) in zip(first, again, strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_part_of_a_chunk_is_kept_and_filled_up_later(own_cache):
    render = Counting()
    for asked in (range(3), range(6), range(10)):
        store = ImageStore("key", 10)
        origins = [store.image(1, index, view(), render)[1] for index in asked]
        store.flush()
        assert origins.count(False) == {3: 3, 6: 3, 10: 4}[len(asked)]
    assert len(own_cache.entries()) == 1


@pytest.mark.parametrize("other", ["seed", "key", "view"])
def test_what_differs_is_rendered(own_cache, other):
    render = Counting()
    store = ImageStore("key", 10)
    store.image(1, 0, view(), render)
    store.flush()
    found = ImageStore("other" if other == "key" else "key", 10).image(
        2 if other == "seed" else 1, 0, view(1000.0 + 1e-9 * (other == "view")), render
    )
    assert found[1] is False
    assert render.calls == 2


def test_a_damaged_image_is_rendered_again(own_cache):
    render = Counting()
    for damage in (False, True):
        store = ImageStore("key", 10)
        assert store.image(1, 0, view(), render)[1] is False
        store.flush()
        (entry,) = own_cache.entries()
        if not damage:
            file = entry.path / "images.parquet"
            content = bytearray(file.read_bytes())
            content[len(content) // 2] ^= 1
            file.write_bytes(content)
    assert ImageStore("key", 10).image(1, 0, view(), render)[1] is True


def test_without_the_store_nothing_is_kept_or_taken(own_cache):
    render, store = Counting(), ImageStore("key", 10)
    store.image(1, 0, view(), render)
    store.flush()
    with store_switched(on=False):
        assert store.image(1, 0, view(), render)[1] is False
        store.image(1, 1, view(), render)
        store.flush()
    assert [store.image(1, index, view(), render)[1] for index in (0, 1)] == [True, False]


def test_a_cache_that_cannot_be_written_costs_nothing_but_time(tmp_path, monkeypatch, caplog):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path / "file"))
    render, store = Counting(), ImageStore("key", 10)
    for index in range(30):
        store.image(1, index, view(), render)
    store.flush()
    assert render.calls == 30
    assert len(caplog.records) == 1


def in_a_process(file, out, trials, jobs):
    """Run with workers that know this test's cache: those of this process keep that of the test that started them."""
    return boresight("run", file, "--out", out, "--trials", trials, "--jobs", jobs).stdout


@pytest.mark.parametrize("first_jobs", [1, pytest.param(2, marks=pytest.mark.long)])
def test_rows_are_the_same_from_the_store(own_cache, tmp_path, first_jobs):
    noisy = write_campaign(tmp_path / "noisy", SMALL, SCENE + "detector: {psf_sigma_px: 0.6}\n")
    for out, jobs, rendered, stored in (
        ("fresh", 1, FEW, 0), ("first", first_jobs, FEW, 0), ("second", 1, 0, FEW),
    ):  # fmt: skip
        with store_switched(on=out != "fresh"):
            said = compute(noisy, tmp_path / out, FEW) if jobs == 1 else in_a_process(noisy, tmp_path / out, FEW, jobs)
        assert f"images: {rendered} rendered or read, {stored} from the store" in said
        assert_same_results(tmp_path / "fresh", tmp_path / out)
    stages = RunFolder(tmp_path / "second").table("timings").groupby("stage").size()
    assert stages["stored_image"] == 2 * FEW
    assert "image" not in stages


def test_another_threshold_or_detector_renders_nothing(own_cache, tmp_path):
    compute(write_campaign(tmp_path / "first", SMALL), tmp_path / "a", FEW)
    other = SMALL.replace("database:", "pose: {match_d2_max: 25}\n      database:")
    noisy = SCENE + "detector: {psf_sigma_px: 0.6}\n"
    for name, campaign, scene in (("threshold", other, SCENE), ("detector", SMALL, noisy)):
        said = compute(write_campaign(tmp_path / name, campaign, scene), tmp_path / f"run-{name}", FEW)
        assert f"images: 0 rendered or read, {FEW} from the store" in said


def test_another_kernel_of_the_data_base_renders_nothing(own_cache, tmp_path):
    """The same data base comes out, and other corners are looked for in the images that are there."""

    def made(name, campaign=SMALL):
        return compute(write_campaign(tmp_path / f"files-{name}", campaign), tmp_path / name, trials=1)

    assert "images: 20; images from store: 0" in made("a")
    kernel = SMALL.replace("images: 20,", "images: 20, corners: {patch_px: 9},")
    assert "images: 20; images from store: 20" in made("b", kernel)
    assert "images: 25; images from store: 20" in made("c", SMALL.replace("images: 20,", "images: 25,"))
    for kind in ("landmark-database", "landmark-candidates"):
        assert main(["cache", "--clear", kind]) == 0
    assert "images: 20; images from store: 20" in made("d")
    for name in ("landmarks.csv", "facets.csv"):
        first, again = (next(tmp_path.glob(f"{out}/products/*/{name}")).read_bytes() for out in "ad")
        assert first == again


def test_other_clusters_read_no_image_and_find_no_corner(own_cache, tmp_path, monkeypatch):
    compute(write_campaign(tmp_path / "first", SMALL), tmp_path / "a", trials=1)
    assert main(["cache", "--clear", "images"]) == 0
    monkeypatch.setattr("boresight.campaign.products.landmark_database.extract_candidates", None)
    clusters = SMALL.replace("seed_radius_m: 15", "seed_radius_m: 16")
    said = compute(write_campaign(tmp_path / "other", clusters), tmp_path / "b", trials=1)
    count = int(re.search(r"images: 20; candidates from cache: (\d+)", said)[1])
    heads = [json.loads(next(tmp_path.glob(f"{out}/products/*/database.json")).read_text()) for out in "ab"]
    assert [head["provenance"]["candidates"] for head in heads] == [count, count]
    monkeypatch.undo()
    monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path / "empty"))
    compute(write_campaign(tmp_path / "fresh", clusters), tmp_path / "c", trials=1)
    for name in ("landmarks.csv", "facets.csv"):
        kept, fresh = (next(tmp_path.glob(f"{out}/products/*/{name}")).read_bytes() for out in "bc")
        assert kept == fresh


@pytest.mark.long
def test_a_killed_run_leaves_a_sound_store(own_cache, tmp_path):
    file = write_campaign(tmp_path / "campaign", SMALL.replace(f"trials: {TRIALS}", "trials: 400"))
    arguments = ("run", file, "--jobs", 2, "--out", tmp_path / "killed", "--trials", 400)
    with started(*arguments) as process:
        wait_for_blocks(process, tmp_path / "killed", 3)
        stop(process)
    kept = [entry for entry in own_cache.entries() if entry.kind == "images"]
    assert kept
    for entry in kept:
        assert own_cache.find(entry.kind, entry.key) == entry.path
        assert len(read_images(entry.path / "images.parquet")) == 10
    compute(file, tmp_path / "after", 30)
    run(file, tmp_path / "fresh", "--trials", 30, "--no-store")
    assert_same_results(tmp_path / "fresh", tmp_path / "after")


def test_cache_lists_images_by_kind_and_clears_them_alone(own_cache, tmp_path, capsys):
    def said(*words):
        assert main(["cache", *words]) == 0
        return capsys.readouterr().out

    compute(write_campaign(tmp_path, SMALL), tmp_path / "run")
    assert "images: 5 entries" in said()  # three blocks of trials, two of the data base
    assert "5 entries removed" in said("--clear", "images")
    left = said()
    assert "images:" not in left
    assert "landmark-database: 1 entries" in left
    assert main(["cache", "--clear", "imagse"]) == 2
    held = re.search(r"imagse: the cache holds ([a-z, -]+)", capsys.readouterr().err)
    assert held is not None
    assert set(held[1].split(", ")) - {"kernels"} == {"bodies", "landmark-candidates", "landmark-database", "rates"}


def test_large_images_have_small_chunks(tmp_path):
    file = write_campaign(tmp_path).parent / "scene.yaml"
    variant = choose_variant().name
    sides = {128: 10, 2048: 8, 8192: 1}
    for side, images in sides.items():
        overrides = [f"camera.width_px={side}", f"camera.height_px={side}"]
        assert ImageStore.open(load_scenario(str(file), overrides), variant, Stream.TRUTH).chunk_images == images


@pytest.mark.parametrize(
    ("change", "same"),
    [
        ("description=another", True), ("detector.psf_sigma_px=0.7", True),
        ("pose_error.position_cam_m.normal=[1,1,1]", True),
        ("camera.fov_deg=18.4", False), ("brdf.albedo=0.2", False), ("rendering.samples_per_pixel=9", False),
        ("body.shading=smooth", False), ("body.detail.seed=4", False), ("viewpoint.range_m=2100", False),
    ],
)  # fmt: skip
def test_the_key_is_what_decides_a_pixel(tmp_path, change, same):
    file, variant = str(write_campaign(tmp_path).parent / "scene.yaml"), choose_variant().name
    keys = []
    for overrides in ([], [change]):
        scenario = load_scenario(file, overrides)
        keys.append(image_set_key(scenario, variant, Stream.TRUTH, (scenario.spec.viewpoint, scenario.spec.lighting)))
    assert (keys[0] == keys[1]) is same
    assert keys[0] != image_set_key(load_scenario(file), "scalar_rgb", Stream.TRUTH, ())

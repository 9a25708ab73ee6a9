"""The learned detector: its templates, patches, network and training, each against an independent calculation."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from crater_scenes import CAMERA, SHAPE, Bowl, crests, frame_of, image_of, scattered
from scipy.signal import correlate2d
from training.lessons import displaced, lessons_of
from training.network_training import Lessons, Schedule, fresh_network, loss, train, windows

from boresight.estimators.craters.detection.classic import ClassicOptions
from boresight.estimators.craters.detection.preparation import noise_level, prepare_image
from boresight.estimators.craters.detection.refinement import side_merits
from boresight.estimators.craters.learned.detector import blend_with_gradient, read_network
from boresight.estimators.craters.learned.network import (
    SHAPES,
    SIDE,
    Network,
    PatchSource,
    cut_patches,
    ellipses_of,
    rims_from_outputs,
    shape_of,
    target_outputs,
)
from boresight.estimators.craters.learned.proposals import halved, propose, ring_templates, template_scores
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Ellipses

AZIMUTH, INCIDENCE = np.radians(200.0), np.radians(55.0)
SUN = np.array([np.cos(AZIMUTH), np.sin(AZIMUTH)])


def drawn(n=20, seed=1):
    rng = np.random.default_rng(seed)
    longer = rng.uniform(6, 60, n)
    axes = np.stack([longer, longer * rng.uniform(0.4, 0.98, n)], 1)
    return Ellipses(rng.uniform(80, 300, (n, 2)), axes, rng.uniform(0, np.pi, n))


def some_lessons(n=12, seed=2):
    rng = np.random.default_rng(seed)
    crater = (rng.random(n) < 0.5).astype(np.float64)
    return Lessons(
        rng.normal(size=(n, SIDE, SIDE, 1)), rng.normal(size=(n, 5)), crater, rng.random(n),
        rng.normal(0, 0.2, (n, 5)), crater * rng.random(n),
    )  # fmt: skip


def test_a_halved_image_is_opencvs_by_areas():
    image = np.random.default_rng(1).normal(size=(60, 80)).astype(np.float32)
    np.testing.assert_allclose(halved(image), cv2.resize(image, (40, 30), interpolation=cv2.INTER_AREA), atol=1e-6)


def test_a_templates_correlation_is_the_merit_of_its_ring():
    """Against the interpolated merit of the classic detector, on a smooth field of gradients."""
    rng = np.random.default_rng(3)
    field = np.stack([cv2.GaussianBlur(rng.normal(size=(61, 61)), (0, 0), 3.0) for _ in range(2)], axis=-1)
    templates = ring_templates(SUN)
    for m in (0, 7, 19):
        kernel = templates.kernels[m]
        ours = [sum(correlate2d(field[..., i], side[..., i], "same")[30, 30] for i in (0, 1)) for side in kernel]
        ellipse = Ellipses(np.array([[30.5, 30.5]]), templates.shape[m : m + 1, :2], templates.shape[m : m + 1, 2])
        theirs = side_merits(ellipse, field, SUN, 0.3, 720)[0][0]
        np.testing.assert_allclose(ours, theirs, atol=0.05 * np.abs(field).max())


def test_the_best_template_is_that_of_scipys_correlations():
    """On ground in a corner of a field that is no multiple of the kernel's block, up to its border."""
    templates, least = ring_templates(SUN), 0.3
    v, u = np.mgrid[:70, :150] + 0.5
    field = np.zeros((70, 150, 2), dtype=np.float32)
    for middle, radius in (((40.0, 30.0), 5.3), ((56.0, 42.0), 6.7), ((70.0, 66.0), 4.2)):
        away = np.stack([u - middle[0], v - middle[1]], axis=-1)
        r = np.linalg.norm(away, axis=-1)
        field += (np.exp(-0.5 * (r - radius) ** 2) * np.sign(away @ SUN) / r)[..., None] * away
    field[:, 76:] = 0.0
    sides = np.array(
        [
            [sum(correlate2d(field[..., i], side[..., i], "same") for i in (0, 1)) for side in k]
            for k in templates.kernels
        ]
    )
    merits = sides.min(axis=1)
    best, which = template_scores(field, templates, least)
    high = merits.max(axis=0) >= least
    assert 20 < high.sum() < 2000
    np.testing.assert_allclose(best[high], merits.max(axis=0)[high], atol=1e-6)
    rows, columns = np.nonzero(high)
    np.testing.assert_allclose(merits[which[high], rows, columns], best[high], atol=1e-6)
    assert (best[~high] < least).all()


def test_templates_propose_every_bowl():
    bowls = scattered(np.random.default_rng(3), 20)
    frame = frame_of(image_of(bowls, AZIMUTH, INCIDENCE, noise=0.02), AZIMUTH, INCIDENCE)
    found = propose(prepare_image(frame, CAMERA, 20.0), 5, 0.3, 400)
    truth = crests(bowls)
    apart = np.linalg.norm(truth.centre_px[:, None] - found.ellipses.centre_px, axis=2) / truth.radius_px[:, None]
    ratio = np.abs(np.log(truth.radius_px[:, None] / found.ellipses.radius_px))
    assert np.all(np.any((apart < 0.3) & (ratio < 0.36), axis=1))
    assert np.all(np.diff(found.merit) <= 0.0)


@pytest.mark.parametrize("radius", [6.0, 13.0, 40.0])
def test_patches_show_a_rim_at_their_middle_and_the_sun_at_the_right(radius):
    """The brightness is a function of the place; each sample is its value there."""
    v, u = np.indices(SHAPE) + 0.5
    place = np.array([210.3, 190.8])
    along, across = (u - place[0]) * SUN[0] + (v - place[1]) * SUN[1], (v - place[1]) * SUN[0] - (u - place[0]) * SUN[1]
    image = (1000.0 + 2.0 * along + 0.7 * across).astype(np.float32)
    frame = frame_of(image, AZIMUTH, INCIDENCE)
    source = PatchSource.of(image, prepare_image(frame, CAMERA, 20.0), frame.sun_dir_cam, 1.0)
    patch = cut_patches(source, Ellipses(place[None], np.full((1, 2), radius), np.zeros(1)))[0][0, ..., 0]
    steps = (np.arange(SIDE) + 0.5) * (4.0 / SIDE) - 2.0
    expected = 2.0 * steps[None] + 0.7 * steps[:, None]
    np.testing.assert_allclose(patch, expected / expected.std(), atol=0.02)


def test_places_and_shapes_come_back():
    truth, seen = drawn(), displaced(drawn(), SUN, 0.1, np.random.default_rng(4))
    back = rims_from_outputs(seen, target_outputs(seen, truth, SUN), SUN)
    np.testing.assert_allclose(back.centre_px, truth.centre_px, atol=1e-9)
    np.testing.assert_allclose(back.semi_axes_px, truth.semi_axes_px, rtol=1e-9)
    np.testing.assert_allclose(np.sin(back.angle_rad - truth.angle_rad), 0.0, atol=1e-7)
    again = ellipses_of(truth.centre_px, shape_of(truth, SUN), SUN)
    np.testing.assert_allclose(again.conics(), truth.conics(), rtol=1e-6, atol=1e-12)


def test_a_convolution_is_scipys():
    rng = np.random.default_rng(5)
    x, kernel = rng.normal(size=(2, 16, 16, 3)), rng.normal(size=(5, 5, 3, 4))
    ours = windows(x, 5) @ kernel.reshape(-1, 4)
    for n in range(2):
        for c in range(4):
            full = sum(correlate2d(x[n, ..., i], kernel[..., i, c], "same") for i in range(3))
            np.testing.assert_allclose(ours[n, ..., c], full[::2, ::2], atol=1e-10)


def test_the_network_is_matrix_products_of_windows_and_weights():
    """Of more patches than are evaluated at once, one of them mirrored."""
    rng = np.random.default_rng(8)
    network = fresh_network(rng)
    w = {
        name: weight + rng.normal(0.0, 0.05, weight.shape).astype(np.float32)
        for name, weight in network.weights.items()
    }
    pixels, scalars = rng.normal(size=(2 * 64 + 5, SIDE, SIDE, 1)), rng.normal(size=(2 * 64 + 5, 5))
    pixels, scalars = pixels.astype(np.float32)[:, ::-1], scalars.astype(np.float32)
    x = pixels
    for i, size in ((1, 5), (2, 3), (3, 3)):
        x = np.maximum(windows(x, size) @ w[f"conv{i}"] + w[f"bias{i}"], 0.0)
    hidden = np.maximum(np.hstack([x.reshape(len(x), -1), scalars]) @ w["dense1"] + w["bias4"], 0.0)
    expected = hidden @ w["dense2"] + w["bias5"]
    assert np.ptp(expected) > 1.0
    np.testing.assert_allclose(Network(w).forward(pixels, scalars), expected, atol=1e-4)


@pytest.mark.parametrize("name", list(SHAPES))
def test_weights_of_another_shape_are_refused(tmp_path, name):
    """The kernel does not check them."""
    weights = {n: np.zeros(shape, np.float16) for n, shape in SHAPES.items()}
    np.savez(tmp_path / "weights.npz", **(weights | {name: weights[name][:-1]}))
    with pytest.raises(BoresightError, match=r"weights.npz: the network's weights .* install boresight again"):
        read_network(tmp_path / "weights.npz")


def test_the_losss_derivatives_are_central_differences():
    rng = np.random.default_rng(6)
    network = Network({k: v.astype(np.float64) for k, v in fresh_network(rng).weights.items()})
    lessons = some_lessons()
    _, by = loss(network, lessons, 30.0)
    for name, weight in network.weights.items():
        for index in rng.integers(0, weight.size, 4):
            values = []
            for sign in (1.0, -1.0):
                moved = weight.copy()
                moved.flat[index] += sign * 1e-6
                values.append(loss(Network({**network.weights, name: moved}), lessons, 30.0)[0])
            numeric = (values[0] - values[1]) / 2e-6
            assert by[name].flat[index] == pytest.approx(numeric, rel=1e-4, abs=1e-7)


def test_training_learns_what_forward_then_says():
    """Bright blobs on one side are craters: a rule that an untrained network does not follow."""
    rng = np.random.default_rng(7)
    n = 400
    pixels = rng.normal(size=(n, SIDE, SIDE, 1)).astype(np.float32)
    crater = (rng.random(n) < 0.5).astype(np.float32)
    pixels[crater > 0, 8:24, 4:12] += 1.5
    one, zero = np.ones(n, np.float32), np.zeros((n, 5), np.float32)
    lessons = Lessons(pixels, zero, crater, one, zero, crater)
    network = train(fresh_network(rng), lessons, Schedule(epochs=20, batch=64, emphasis=0.0), rng, lambda *_: None)
    fresh = rng.normal(size=(200, SIDE, SIDE, 1)).astype(np.float32)
    fresh[:100, 8:24, 4:12] += 1.5
    odds = network.forward(fresh, zero[:200])[:, 0]
    assert np.mean(odds[:100] > 0.0) > 0.95
    assert np.mean(odds[100:] < 0.0) > 0.95


def test_lessons_tell_rims_from_what_lies_beside_them():
    bowls = [Bowl(150.0, 200.0, 20.0), Bowl(350.0, 180.0, 30.0)]
    frame = frame_of(image_of(bowls, AZIMUTH, INCIDENCE), AZIMUTH, INCIDENCE)
    picture = prepare_image(frame, CAMERA, 20.0)
    source = PatchSource.of(frame.image, picture, frame.sun_dir_cam, noise_level(frame.image, picture.ground))
    seen = Ellipses(np.array([[152.0, 200], [150, 209], [150, 218], [250, 100]]), np.full((4, 2), 20.0), np.zeros(4))
    lessons = lessons_of(source, seen, crests(bowls), np.ones(2))
    assert lessons.crater.tolist() == [1, 0, 0, 0]
    assert lessons.weight.tolist() == [1, 0, 1, 1]
    assert (lessons.placed > 0).tolist() == [True, True, False, False]
    np.testing.assert_allclose(np.hypot(*lessons.target[:2, :2].T), [0.1, 0.45], atol=1e-6)


def test_a_mirrored_lesson_is_that_of_the_mirrored_ground():
    bowls = [Bowl(200.0, 200.0, 20.0), Bowl(240.0, 215.0, 9.0)]
    mirrored = [Bowl(b.u, 400.0 - b.v, b.radius) for b in bowls]
    seen = Ellipses(np.array([[203.0, 195.0]]), np.array([[22.0, 19.0]]), np.array([0.3]))
    other = Ellipses(np.array([[203.0, 205.0]]), seen.semi_axes_px, np.array([np.pi - 0.3]))
    found = []
    for scene, rim in ((bowls, seen), (mirrored, other)):
        frame = frame_of(image_of(scene, 0.0, INCIDENCE, noise=0.0), 0.0, INCIDENCE)
        source = PatchSource.of(frame.image, prepare_image(frame, CAMERA, 20.0), frame.sun_dir_cam, 1.0)
        found.append(lessons_of(source, rim, crests(scene), np.ones(2)))
    flipped = found[0].mirrored(np.array([True]))
    np.testing.assert_allclose(flipped.pixels, found[1].pixels, atol=0.02)
    np.testing.assert_allclose(flipped.target, found[1].target, atol=1e-6)


def test_a_rim_on_the_limb_lies_half_on_the_ground():
    image = image_of([], AZIMUTH, INCIDENCE)
    image[:, 300:] = 0.0
    picture = prepare_image(frame_of(image, AZIMUTH, INCIDENCE), CAMERA, 20.0)
    rims = Ellipses(np.array([[150.0, 200], [296, 200], [400, 200], [5, 200]]), np.full((4, 2), 20.0), np.zeros(4))
    share = picture.on_ground(rims)
    assert share[0] == 1.0
    assert 0.4 < share[1] < 0.6
    assert share[2] == 0.0
    assert 0.5 < share[3] < 0.7  # the rest lies out of the image


def test_larger_rims_are_drawn_halfway_to_the_gradient_and_small_or_lost_ones_stay():
    azimuth, incidence = np.radians([200.0, 60.0])
    bowls = [Bowl(120.3, 110.6, 25.0), Bowl(330.8, 250.2, 14.0), Bowl(440.0, 90.0, 7.0)]
    truth = crests(bowls)
    picture = prepare_image(frame_of(image_of(bowls, azimuth, incidence), azimuth, incidence), CAMERA, 20.0)
    off = Ellipses(truth.centre_px + np.array([1.2, -0.9]), truth.semi_axes_px, truth.angle_rad)
    lost = Ellipses(np.array([[260.0, 60.0]]), np.array([[20.0, 20.0]]), np.zeros(1))
    moved = blend_with_gradient(Ellipses.joined([off, lost]), picture, 8.0, ClassicOptions())
    before = np.linalg.norm(off.centre_px - truth.centre_px, axis=1)
    after = np.linalg.norm(moved.centre_px[:3] - truth.centre_px, axis=1)
    assert np.all(after[:2] < 0.7 * before[:2])
    assert np.all(after[:2] > 0.3 * before[:2])
    assert np.array_equal(moved.centre_px[2:], [*off.centre_px[2:], *lost.centre_px])
    assert np.array_equal(moved.semi_axes_px[2:], [[7.0, 7.0], [20.0, 20.0]])

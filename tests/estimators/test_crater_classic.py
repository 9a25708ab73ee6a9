"""The detector of Cheng et al. (2003) on shaded bowls of a height field that is not the renderer's."""

from __future__ import annotations

import numpy as np
import pytest
from crater_scenes import CAMERA, SHAPE, Bowl, crests, frame_of, image_of, scattered

from estimators.craters.detection.classic import CraterClassic
from estimators.craters.detection.edges import canny, gradient_of
from estimators.craters.detection.picture import prepare
from scenarios.errors import BoresightError
from scenarios.geometry import Camera

AZIMUTH, INCIDENCE = np.radians(200.0), np.radians(55.0)


@pytest.fixture(scope="module")
def detector():
    return CraterClassic.from_options({})


def found_near(detections, truth):
    """Distances from each true crater to the nearest detection, and that one's row."""
    apart = np.linalg.norm(truth.centre_px[:, None] - detections.ellipses.centre_px[None], axis=2)
    return apart.min(axis=1), apart.argmin(axis=1)


def test_an_ideal_bowl_is_found_to_half_a_pixel(detector):
    for place in ([250.4, 200.7], [251.0, 200.0]):
        bowl = Bowl(*place, 16.0)
        detections = detector.detect(frame_of(image_of([bowl], AZIMUTH, INCIDENCE), AZIMUTH, INCIDENCE), CAMERA)
        assert len(detections.ellipses) == 1
        assert np.linalg.norm(detections.ellipses.centre_px[0] - place) < 0.45


@pytest.mark.parametrize("incidence_deg", [35.0, 55.0, 70.0])
@pytest.mark.parametrize("azimuth_deg", [20.0, 250.0])
def test_all_bowls_of_a_plain_are_found_and_nothing_else(detector, azimuth_deg, incidence_deg):
    azimuth, incidence = np.radians([azimuth_deg, incidence_deg])
    bowls = scattered(np.random.default_rng(3), 20)
    detections = detector.detect(frame_of(image_of(bowls, azimuth, incidence), azimuth, incidence), CAMERA)
    apart, rows = found_near(detections, crests(bowls))
    assert len(detections.ellipses) == 20
    assert len(set(rows)) == 20
    assert apart.max() < 1.0
    ratio = detections.ellipses.radius_px[rows] / crests(bowls).radius_px
    assert np.abs(np.log(ratio)).max() < 0.15


def test_light_from_the_other_side_makes_mounds_of_craters(detector):
    """A detector that ignored the Sun would find the bowls as well."""
    bowls = scattered(np.random.default_rng(3), 20)
    image = image_of(bowls, AZIMUTH, INCIDENCE)
    wrong = detector.detect(frame_of(image, AZIMUTH + np.pi, INCIDENCE), CAMERA)
    apart, rows = found_near(wrong, crests(bowls))
    alike = np.abs(np.log(wrong.ellipses.radius_px[rows] / crests(bowls).radius_px)) < 0.36
    assert not np.any((apart < 0.3 * crests(bowls).radius_px) & alike)


def test_an_image_without_a_crater_gives_none(detector):
    assert len(detector.detect(frame_of(image_of([], AZIMUTH, INCIDENCE), AZIMUTH, INCIDENCE), CAMERA).ellipses) == 0


def test_confidence_falls_and_the_same_image_gives_the_same_bits(detector):
    bowls = scattered(np.random.default_rng(5), 12)
    frame = frame_of(image_of(bowls, AZIMUTH, INCIDENCE, noise=0.05), AZIMUTH, INCIDENCE)
    one, other = detector.detect(frame, CAMERA), detector.detect(frame, CAMERA)
    assert np.all(np.diff(one.confidence) <= 0.0)
    assert one.confidence.max() <= 1.0
    np.testing.assert_array_equal(one.ellipses.centre_px, other.ellipses.centre_px)
    np.testing.assert_array_equal(one.confidence, other.confidence)


def test_the_scale_of_the_brightness_does_not_matter(detector):
    bowls = scattered(np.random.default_rng(5), 12)
    image = image_of(bowls, AZIMUTH, INCIDENCE)
    one = detector.detect(frame_of(image, AZIMUTH, INCIDENCE), CAMERA)
    other = detector.detect(frame_of(image / np.float32(4096.0), AZIMUTH, INCIDENCE), CAMERA)
    np.testing.assert_allclose(one.ellipses.centre_px, other.ellipses.centre_px, atol=1e-2)


@pytest.mark.parametrize(
    ("image", "said"),
    [
        (np.zeros(SHAPE, np.float32), "is black"),
        (np.full(SHAPE, 7.0, np.float32), "is 7 all over"),
        (np.full(SHAPE, np.nan, np.float32), "221244 pixels that are not finite"),
        (np.minimum(image_of([Bowl(9, 9, 8.0)], AZIMUTH, INCIDENCE), 300.0), r"\d+ % of the image is saturated at 300"),
        (np.zeros((10, 20), np.float32), r"the image is \(20, 10\) pixels, the camera 537 x 412"),
    ],
)  # fmt: skip
def test_an_image_that_shows_nothing_is_refused(detector, image, said):
    with pytest.raises(BoresightError, match=said):
        detector.detect(frame_of(image, AZIMUTH, INCIDENCE), CAMERA)


def test_the_sun_behind_the_camera_is_refused(detector):
    frame = frame_of(image_of([], AZIMUTH, INCIDENCE), AZIMUTH, 0.0)
    with pytest.raises(BoresightError, match="the Sun stands along the boresight"):
        detector.detect(frame, CAMERA)


def test_stages_show_both_sides_of_each_rim(detector):
    bowls = [Bowl(150.0, 200.0, 20.0), Bowl(350.0, 180.0, 30.0)]
    stages = detector.stages(frame_of(image_of(bowls, AZIMUTH, INCIDENCE), AZIMUTH, INCIDENCE), CAMERA)
    sun = stages.picture.sun_px
    for bowl in bowls:
        for arcs, sign in ((stages.shaded, 1.0), (stages.lit, -1.0)):
            offsets = [arc.uv_px.mean(axis=0) - [bowl.u, bowl.v] for arc in arcs]
            assert any(np.linalg.norm(o) < bowl.radius and sign * (o @ sun) > 0.5 * bowl.radius for o in offsets)
    assert all(edges.mask.any() for edges in stages.edges)


def test_gradients_of_a_ramp_are_its_slope():
    v, u = np.mgrid[:40, :50].astype(np.float32)
    for kernel in (3, 5, 9, 17):
        gradient = gradient_of(0.3 * u - 0.2 * v, kernel)
        np.testing.assert_allclose(gradient.along_u[12:-12, 12:-12], 0.3, rtol=1e-4)
        np.testing.assert_allclose(gradient.along_v[12:-12, 12:-12], -0.2, rtol=1e-4)


def test_edges_lie_where_a_blurred_step_is_steepest():
    u = np.arange(80) + 0.5
    row = 100.0 + 50.0 / (1.0 + np.exp(-(u - 41.3) / 1.5))
    image = np.tile(row, (60, 1)).astype(np.float32)
    camera = Camera.from_fov(80, 60, 0.01)
    picture = prepare(frame_of(image, 0.0, 1.0), camera, 20.0)
    edges = canny(picture, 3, 0.1, 0.5)
    assert np.abs(np.median(edges.uv_px[:, 0]) - 41.3) < 0.15

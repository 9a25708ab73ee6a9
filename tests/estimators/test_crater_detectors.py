"""Properties of every crater detector, on shaded bowls of a height field independent of renderers and training."""

from __future__ import annotations

import numpy as np
import pytest
from crater_scenes import CAMERA, SHAPE, Bowl, crests, frame_of, image_of, scattered

from boresight.estimators.registry import FILE_OPTIONS, crater_detector_class, crater_detector_names
from boresight.scenarios.errors import BoresightError

AZIMUTH, INCIDENCE = np.radians(200.0), np.radians(55.0)


# What a network of a user finds is not ours to test (test_crater_onnx.py tests how it is applied).
@pytest.fixture(scope="module", params=[name for name in crater_detector_names() if name not in FILE_OPTIONS])
def detector(request):
    return crater_detector_class(request.param).from_options({})


def found_near(detections, truth):
    """Return the distance from each true crater to the nearest detection, and that detection's row."""
    apart = np.linalg.norm(truth.centre_px[:, None] - detections.ellipses.centre_px[None], axis=2)
    return apart.min(axis=1), apart.argmin(axis=1)


def alike(detections, rows, truth, apart):
    ratio = np.abs(np.log(detections.ellipses.radius_px[rows] / truth.radius_px))
    return (apart < np.maximum(0.3 * truth.radius_px, 1.5)) & (ratio < 0.36)


@pytest.mark.parametrize("place", [(250.4, 200.7), (251.0, 200.0)])
def test_an_ideal_bowl_is_found(detector, place):
    bowl = Bowl(*place, 16.0)
    detections = detector.detect(frame_of(image_of([bowl], AZIMUTH, INCIDENCE), AZIMUTH, INCIDENCE), CAMERA)
    assert len(detections.ellipses) == 1
    offset = detections.ellipses.centre_px[0] - place
    sun = np.array([np.cos(AZIMUTH), np.sin(AZIMUTH)])
    assert abs(offset @ [-sun[1], sun[0]]) < 0.2
    # The steepest gradient of so sharp a crest lies farther inside on the side of the Sun than on the other: the method
    # of Cheng et al. (2003) is drawn away from the Sun, by a fortieth of the radius. The network has learned it.
    assert abs(offset @ sun) < (0.5 if detector.name == "crater-classic" else 0.3)


@pytest.mark.parametrize(
    ("azimuth_deg", "incidence_deg"),
    [
        (20.0, 35.0),
        (250.0, 65.0),
        *(pytest.param(*sun, marks=pytest.mark.long) for sun in ((20.0, 65.0), (250.0, 35.0))),
    ],
)
def test_bowls_of_a_plain_are_found_and_little_else(detector, azimuth_deg, incidence_deg):
    azimuth, incidence = np.radians([azimuth_deg, incidence_deg])
    bowls = scattered(np.random.default_rng(3), 20)
    detections = detector.detect(frame_of(image_of(bowls, azimuth, incidence), azimuth, incidence), CAMERA)
    truth = crests(bowls)
    apart, rows = found_near(detections, truth)
    assert alike(detections, rows, truth, apart).sum() >= 19
    assert len(detections.ellipses) <= 21
    assert np.median(apart) < 0.5


def test_light_from_the_other_side_makes_no_craters_of_bowls(detector):
    """A detector that ignored the Sun would find all twenty; the network was not trained with mounds."""
    bowls = scattered(np.random.default_rng(3), 20)
    wrong = detector.detect(frame_of(image_of(bowls, AZIMUTH, INCIDENCE), AZIMUTH + np.pi, INCIDENCE), CAMERA)
    if len(wrong.ellipses):
        apart, rows = found_near(wrong, crests(bowls))
        assert alike(wrong, rows, crests(bowls), apart).sum() <= 6


def test_an_image_without_a_crater_gives_none(detector):
    assert len(detector.detect(frame_of(image_of([], AZIMUTH, INCIDENCE), AZIMUTH, INCIDENCE), CAMERA).ellipses) == 0


def test_confidence_falls_and_the_same_image_gives_the_same_bits(detector):
    bowls = scattered(np.random.default_rng(5), 12)
    frame = frame_of(image_of(bowls, AZIMUTH, INCIDENCE, noise=0.05), AZIMUTH, INCIDENCE)
    before = frame.image.copy()
    one, other = detector.detect(frame, CAMERA), detector.detect(frame, CAMERA)
    assert np.all(np.diff(one.confidence) <= 0.0)
    assert one.confidence.max() <= 1.0
    np.testing.assert_array_equal(one.ellipses.centre_px, other.ellipses.centre_px)
    np.testing.assert_array_equal(one.confidence, other.confidence)
    np.testing.assert_array_equal(frame.image, before)


def test_the_scale_of_the_brightness_does_not_matter(detector):
    bowls = scattered(np.random.default_rng(5), 12)
    image = image_of(bowls, AZIMUTH, INCIDENCE)
    one = detector.detect(frame_of(image, AZIMUTH, INCIDENCE), CAMERA)
    other = detector.detect(frame_of(image / np.float32(4096.0), AZIMUTH, INCIDENCE), CAMERA)
    np.testing.assert_allclose(one.ellipses.centre_px, other.ellipses.centre_px, atol=1e-2)


SATURATED = np.minimum(image_of([Bowl(9, 9, 8.0)], AZIMUTH, INCIDENCE), 300.0)


@pytest.mark.parametrize(
    ("image", "said"),
    [
        (np.zeros(SHAPE, np.float32), "is black"),
        (np.full(SHAPE, 7.0, np.float32), "is 7 all over"),
        (np.full(SHAPE, np.nan, np.float32), "221244 pixels that are not finite"),
        (SATURATED, r"\d+ % of the image is saturated at 300"),
        (np.zeros((10, 20), np.float32), r"the image is \(20, 10\) pixels, the camera 537 x 412"),
    ],
)
def test_an_image_that_shows_nothing_is_refused(detector, image, said):
    with pytest.raises(BoresightError, match=said):
        detector.detect(frame_of(image, AZIMUTH, INCIDENCE), CAMERA)


def test_the_sun_behind_the_camera_is_refused(detector):
    frame = frame_of(image_of([], AZIMUTH, INCIDENCE), AZIMUTH, 0.0)
    with pytest.raises(BoresightError, match="the Sun stands along the boresight"):
        detector.detect(frame, CAMERA)

"""SURF's detector against Gaussian blobs in closed form and second derivatives by scipy."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from boresight.estimators.landmark.corners import CornerOptions, detect_corners
from boresight.estimators.landmark.fast_hessian import determinant, fast_hessian

BLOBS = ((80.3, 70.8, 3.0), (170.6, 90.1, 2.4), (110.0, 170.45, 4.0))


def blob_image(sign=1.0, side=256):
    """Gaussian blobs (u, v, sigma), u and v in OpenCV's pixels, on a grey ground."""
    v, u = np.mgrid[:side, :side]
    bumps = sum(np.exp(-0.5 * ((u - x) ** 2 + (v - y) ** 2) / s**2) for x, y, s in BLOBS)
    return (0.5 + 0.4 * sign * bumps).astype(np.float32)


@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["bright", "dark"])
def test_position_and_scale_of_gaussian_blobs_are_recovered(sign):
    """The nominal scale is a fixed part of the true one.

    The moments of the second derivative of side 9, [1 1 1 -2 -2 -2 1 1 1] over 5 rows, are those of a Gaussian's of
    1.47 px along and 1.41 px across, not of 1.2 px, and wider sides have relatively longer lobes: 0.82 at most.
    """
    blobs = fast_hessian(blob_image(sign))
    ratios = []
    for u, v, sigma in BLOBS:
        gap = np.hypot(blobs.peaks[:, 1] - u, blobs.peaks[:, 0] - v)
        near = np.flatnonzero(gap < 2.0)
        best = near[np.argmax(blobs.strength[near])]
        place = blobs.peaks[best, ::-1] + blobs.offsets_px[best]
        np.testing.assert_allclose(place, (u, v), atol=0.1)
        ratios.append(blobs.scale_px[best] / sigma)
    assert min(ratios) > 0.68
    assert max(ratios) < 0.82


@pytest.mark.parametrize("side", [9, 15, 27])
def test_the_determinant_follows_that_of_gaussian_derivatives(side):
    rng = np.random.default_rng(2)
    image = cv2.GaussianBlur(rng.normal(size=(300, 300)).astype(np.float32), (0, 0), 2.4 * side / 9)
    sigma = 1.2 * side / 9
    xx, yy, xy = (gaussian_filter(image.astype(np.float64), sigma, order=o) for o in ((0, 2), (2, 0), (1, 1)))
    inner = (slice(60, -60), slice(60, -60))
    expected = (sigma**4 * (xx * yy - xy**2))[inner]
    assert np.corrcoef(determinant(image, side)[inner].ravel(), expected.ravel())[0, 1] > 0.95


def test_an_edge_and_a_plain_have_no_blobs():
    edge = np.zeros((128, 128), dtype=np.float32)
    edge[:, 64:] = 1.0
    assert len(fast_hessian(np.full((128, 128), 0.5, dtype=np.float32)).peaks) == 0
    blobs = fast_hessian(edge)
    assert (blobs.strength < 1e-9).all()


def test_blobs_are_corners_of_an_image_where_they_are_asked_for():
    image = np.clip(blob_image() - 0.5, 0.0, None)
    options = CornerOptions(detector="surf", self_similarity_max=1.0, min_relative_strength=0.05)
    found = detect_corners(image, options)
    truth = np.array([(u + 0.5, v + 0.5) for u, v, _ in BLOBS])
    assert (np.diff(found.strength) <= 0.0).all()
    gap = np.linalg.norm(found.uv_px[:, None] - truth, axis=2).min(axis=0)
    assert gap.max() < 0.15

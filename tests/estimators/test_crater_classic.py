"""The stages of the detector of Cheng et al. (2003), on shaded bowls of a height field independent of the renderer."""

from __future__ import annotations

import numpy as np
from crater_scenes import CAMERA, Bowl, frame_of, image_of

from boresight.estimators.craters.detection.classic import CraterClassic
from boresight.estimators.craters.detection.preparation import PreparedImage, canny, gradient_of, prepare_image
from boresight.scenarios.geometry import Camera

AZIMUTH, INCIDENCE = np.radians(200.0), np.radians(55.0)


def test_stages_show_both_sides_of_each_rim():
    bowls = [Bowl(150.0, 200.0, 20.0), Bowl(350.0, 180.0, 30.0)]
    frame = frame_of(image_of(bowls, AZIMUTH, INCIDENCE), AZIMUTH, INCIDENCE)
    stages = CraterClassic.from_options({}).stages(frame, CAMERA)
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
    picture = prepare_image(frame_of(image, 0.0, 1.0), camera, 20.0)
    edges = canny(picture, 3, 0.1, 0.5)
    assert np.abs(np.median(edges.uv_px[:, 0]) - 41.3) < 0.15


def test_noise_alone_has_next_to_no_edges():
    """The length of a gradient of white noise follows Rayleigh's law: exp(-3.5^2 / 2) of it is above 3.5 deviations."""
    even = np.random.default_rng(1).normal(0.0, 0.2, (120, 160)).astype(np.float32)
    ground, noise = np.ones(even.shape, dtype=bool), np.full(even.shape, 0.2, dtype=np.float32)
    picture = PreparedImage(even, even, noise, ground, np.array([1.0, 0.0]))
    for kernel in (3, 9):
        assert canny(picture, kernel, 0.15, 0.5).mask.mean() < 3.0 * np.exp(-0.5 * 3.5**2)


def test_even_ground_is_even_beside_the_sky():
    image = np.zeros((120, 200), dtype=np.float32)
    image[:, :110] = 100.0 + np.random.default_rng(2).normal(0.0, 2.0, (120, 110))
    picture = prepare_image(frame_of(image, 0.0, 1.0), Camera.from_fov(200, 120, 0.01), 20.0)
    edge = picture.ground & (np.arange(200) > 85)
    assert edge.any()
    assert abs(picture.even[edge].mean()) < 0.2


def test_the_crest_is_outside_the_steepest_rim_by_its_scale():
    frame = frame_of(image_of([Bowl(256.0, 200.0, 30.0)], AZIMUTH, INCIDENCE), AZIMUTH, INCIDENCE)
    plain, wide = (
        CraterClassic.from_options({"crest_scale": scale}).detect(frame, CAMERA).ellipses for scale in (1.0, 1.2)
    )
    np.testing.assert_allclose(wide.semi_axes_px, 1.2 * plain.semi_axes_px)
    np.testing.assert_allclose(wide.centre_px, plain.centre_px)

"""Images of a GPU beside those of the processor: the same but for rounding, and what rounding does is measured here."""

from __future__ import annotations

import numpy as np
import pytest
from rounding import round_rays_otherwise

from boresight.renderers.mitsuba3 import MitsubaRenderer
from boresight.scenarios.geometry import Camera
from boresight.scenarios.spec.brdf import HapkeSpec

CAMERA = Camera.from_fov(256, 256, np.radians(20.0))
HAPKE = HapkeSpec(kind="hapke")


def assert_the_same_but_for_rounding(image: np.ndarray, other: np.ndarray) -> None:
    """999 of 1000 lit pixels within 1e-4 of the peak; the rest lie at edges, of a facet or of a shadow."""
    lit = (image > 0.0) | (other > 0.0)
    difference = np.abs(image - other)[lit] / image.max()
    assert lit.mean() > 0.1
    assert difference.any(), "another tracer"
    assert (difference < 1e-4).mean() > 0.999
    assert other.sum() == pytest.approx(image.sum(), rel=1e-4)


@pytest.fixture
def view(looking):
    return looking(CAMERA, [900.0, -1500.0, 700.0], [0.9, -0.5, 0.1])


def test_images_of_a_gpu(llvm, cuda, rock, view):
    renderers = [MitsubaRenderer(rock, HAPKE, 4, variant=variant) for variant in (llvm, cuda)]
    assert_the_same_but_for_rounding(*(renderer.render(view) for renderer in renderers))
    uv = np.random.default_rng(5).uniform(0.0, 256.0, (2000, 2))
    hits, others = (renderer.surface(view, uv) for renderer in renderers)
    assert (hits.facets == others.facets).mean() > 0.999
    assert (hits.lit == others.lit).mean() > 0.999


def test_derivatives_of_a_gpu(llvm, cuda, rock, view):
    (image, slopes), (other, others) = (
        MitsubaRenderer(rock, HAPKE, 4, variant=variant).render_with_derivatives(view) for variant in (llvm, cuda)
    )
    assert_the_same_but_for_rounding(image, other)
    scale = np.abs(slopes).max(axis=(1, 2), keepdims=True)
    assert (np.abs(slopes - others) < 1e-3 * scale).mean() > 0.999


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_rounding_of_rays_keeps_within_the_tolerance(llvm, rock, view, monkeypatch, sign):
    renderer = MitsubaRenderer(rock, HAPKE, 4, variant=llvm)
    image = renderer.render(view)
    round_rays_otherwise(monkeypatch, sign)
    assert_the_same_but_for_rounding(image, renderer.render(view))

"""Derivatives of every reflectance law by Dr.Jit, against central differences of the NumPy formula."""

from __future__ import annotations

import numpy as np
import pytest

from boresight.renderers.brdf import MODELS, NUMPY, phase_angle
from boresight.renderers.mitsuba3 import choose_variant
from boresight.renderers.mitsuba3.wavefront import drjit_math
from boresight.scenarios.spec.brdf import HapkeSpec, LambertSpec, LommelSeeligerSpec, McEwenSpec, OrenNayarSpec

pytestmark = pytest.mark.skipif(
    not choose_variant().is_wavefront, reason="the Mitsuba variant of this machine gives no derivatives"
)
VIEWS = 1000
LAWS = {
    "lambert": LambertSpec(kind="lambert"),
    "oren-nayar": OrenNayarSpec(kind="oren-nayar", sigma_deg=31.0),
    "oren-nayar-qualitative": OrenNayarSpec(kind="oren-nayar", sigma_deg=20.0, form="qualitative"),
    "hapke": HapkeSpec(kind="hapke"),
    "hapke-smooth": HapkeSpec(kind="hapke", theta_bar_deg=0.0),
    "hapke-1981": HapkeSpec(kind="hapke", H_function="1981"),
    "lommel-seeliger": LommelSeeligerSpec(kind="lommel-seeliger"),
    "mcewen": McEwenSpec(kind="mcewen"),
}


def around(axis, apart_rad, rng):
    """Unit vectors (N, 3) at given angles from axes (N, 3), at random azimuths."""
    across = rng.normal(size=axis.shape)
    across -= (across * axis).sum(1, keepdims=True) * axis
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return np.cos(apart_rad)[:, None] * axis + np.sin(apart_rad)[:, None] * across


def from_normal(angle_rad, rng):
    return around(np.tile([0.0, 0.0, 1.0], (len(angle_rad), 1)), angle_rad, rng)


def views(place, rng):
    """Directions to the light and to the viewer, (N, 3) each, about the normal z."""
    wide = np.arccos(rng.uniform(0.1, 0.99, VIEWS))
    viewer = from_normal(wide, rng)
    if place == "anywhere":
        return from_normal(np.arccos(rng.uniform(0.1, 0.99, VIEWS)), rng), viewer
    if place == "near opposition":
        return around(viewer, 10.0 ** rng.uniform(-4.0, -1.5, VIEWS), rng), viewer
    if place == "sun behind the camera":
        return viewer.copy(), viewer
    if place == "grazing light":
        return from_normal(np.arccos(10.0 ** rng.uniform(-3.5, -1.5, VIEWS)), rng), viewer
    if place == "limb":
        return viewer, from_normal(np.arccos(10.0 ** rng.uniform(-3.5, -1.5, VIEWS)), rng)
    if place == "sun before the camera":
        light = from_normal(np.arccos(10.0 ** rng.uniform(-3.5, -1.5, VIEWS)), rng)
        return light, around(light * [-1.0, -1.0, 1.0], 10.0 ** rng.uniform(-4.0, -2.5, VIEWS), rng)
    if place == "facing the sun":
        return np.tile([0.0, 0.0, 1.0], (VIEWS, 1)), viewer
    if place == "in one plane":
        turned = viewer * rng.choice([-1.0, 1.0], VIEWS)[:, None] * [1.0, 1.0, 0.0]
        high = rng.uniform(0.1, 1.0, VIEWS)[:, None]
        light = turned * high + viewer * [0.0, 0.0, 1.0]
        return light / np.linalg.norm(light, axis=1, keepdims=True), viewer
    raise ValueError(place)


PLACES = (
    "anywhere", "near opposition", "sun behind the camera", "grazing light", "limb", "sun before the camera",
    "facing the sun", "in one plane",
)  # fmt: skip
# Kinks of the laws, where a rounded direction lies on either side; and phase angles near 180 deg, which single
# precision holds to 2e-7 rad, as large as the square of the azimuth that they leave.
ROUNDED = ("sun behind the camera", "facing the sun", "in one plane", "sun before the camera")


def formula(law, light, viewer, xp):
    """The BRDF of directions as three components each, of either library."""
    sums = sum((a - b) * (a - b) for a, b in zip(light, viewer, strict=True))
    differences = sum((a + b) * (a + b) for a, b in zip(light, viewer, strict=True))
    phase = phase_angle(sums, differences, xp)
    return MODELS[law.kind].formula(dict(law), light[2], viewer[2], phase, xp)


def differences(law, light, viewer, light_rate, viewer_rate, step=1e-7):
    def at(size):
        moved = [v + size * rate for v, rate in ((light, light_rate), (viewer, viewer_rate))]
        return formula(law, *((v / np.linalg.norm(v, axis=1, keepdims=True)).T for v in moved), NUMPY)

    return (at(step) - at(-step)) / (2.0 * step) * np.ones(len(light))


def by_drjit(law, light, viewer, light_rate, viewer_rate, single=False):
    import drjit as dr
    from drjit.llvm import ad

    number = ad.Float32 if single else ad.Float64
    size = number(0.0)
    dr.enable_grad(size)
    moved = [
        [number(np.ascontiguousarray(v[:, k])) + size * number(np.ascontiguousarray(rate[:, k])) for k in range(3)]
        for v, rate in ((light, light_rate), (viewer, viewer_rate))
    ]
    value = number(formula(law, *moved, drjit_math(dr)))
    if not dr.grad_enabled(value):
        return np.asarray(dr.detach(value)) * np.ones(len(light)), np.zeros(len(light))
    dr.set_grad(size, 1.0)
    slope = dr.forward_to(value)
    return np.asarray(dr.detach(value)), np.asarray(slope)


def tangent(v, rng):
    rate = rng.normal(size=v.shape)
    rate -= (rate * v).sum(1, keepdims=True) * v
    return rate / np.linalg.norm(rate, axis=1, keepdims=True)


def everywhere(seed, single=False):
    """Return light, viewer and the rates of both, (N, 3) each, of all places, one after the other."""
    found = []
    for number, place in enumerate(PLACES):
        rng = np.random.default_rng([seed, number])
        light, viewer = views(place, rng)
        if single:
            light, viewer = (v.astype(np.float32).astype(np.float64) for v in (light, viewer))
        found.append((light, viewer, tangent(light, rng), tangent(viewer, rng)))
    return [np.concatenate(part) for part in zip(*found, strict=True)]


def by_place(*values):
    """Return the values of each place by its name."""
    return dict(zip(PLACES, zip(*(np.split(value, len(PLACES)) for value in values), strict=True), strict=True))


@pytest.mark.parametrize("law", LAWS)
def test_derivatives_are_those_of_differences(law):
    light, viewer, *rates = everywhere(7)
    value, slope = by_drjit(LAWS[law], light, viewer, *rates)
    exact = formula(LAWS[law], light.T, viewer.T, NUMPY) * np.ones(len(light))
    np.testing.assert_allclose(value, exact, rtol=1e-9)
    assert np.isfinite(slope).all()
    expected = differences(LAWS[law], light, viewer, *rates)
    wrong = np.abs(slope - expected) > 1e-4 * (np.abs(expected) + value)
    for place, (here, found, wanted) in by_place(wrong, slope, expected).items():
        assert here.mean() <= 0.01, (place, found[here][:5], wanted[here][:5])


@pytest.mark.parametrize("law", LAWS)
def test_derivatives_are_finite_in_single_precision_and_nearly_those_of_double(law):
    given = everywhere(8, single=True)
    value, slope = by_drjit(LAWS[law], *given, single=True)
    assert np.isfinite(value).all()
    assert np.isfinite(slope).all()
    exact = by_drjit(LAWS[law], *given)[1]
    wrong = np.abs(slope - exact) > 0.05 * (np.abs(exact) + value)
    for place, (here,) in by_place(wrong).items():
        assert place in ROUNDED or np.mean(here) < 0.03, place

"""Identification of drawn fields: with a prior and lost in space, with false detections, and none of wrong stars."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from boresight.estimators.stars.detection import Detections
from boresight.estimators.stars.identification import Sky, identify
from boresight.scenarios.geometry import Camera
from boresight.scenarios.stars import StarCatalog, artificial_sky

CAMERA = Camera.from_fov(1024, 1024, np.radians(12.0))
SIGMA_PX, LEVEL = 0.1, 1e-6
TRACKER_RAD = np.radians([0.05, 0.05, 0.2])


@pytest.fixture(scope="module")
def sky():
    return Sky.of(CAMERA, artificial_sky(3, 7.0))


def seen_in(catalog, true, rng, faintest, false=0, hidden=False):
    """Return the detections of an attitude, and their stars (-1 for false ones); ``hidden``: by a body in a corner."""
    uv = CAMERA.project(catalog.directions @ true.T)
    stars = np.flatnonzero(CAMERA.contains(uv) & (catalog.magnitudes < faintest))[:60]
    if hidden:
        stars = stars[(uv[stars] > 512.0).any(axis=1)]
    places = np.concatenate([uv[stars] + SIGMA_PX * rng.normal(size=(len(stars), 2)), rng.uniform(0, 1024, (false, 2))])
    magnitudes = np.concatenate([catalog.magnitudes[stars], rng.uniform(faintest - 4.0, faintest, false)])
    order = np.argsort(magnitudes)
    seen = Detections(places[order], 10 ** (-0.4 * magnitudes[order]), np.full(len(order), SIGMA_PX), 0.5, 1.0)
    return seen, np.concatenate([stars, np.full(false, -1)])[order]


def tracked(true, rng):
    return Rotation.from_rotvec(TRACKER_RAD * rng.normal(size=3)).as_matrix() @ true, TRACKER_RAD


def run(sky, seed, count, tracker, **field):
    """Identify drawn fields: the numbers of those found, and of those found wrong, and the reasons of the others."""
    rng, found, wrong, reasons = np.random.default_rng(seed), 0, 0, []
    for _ in range(count):
        true = Rotation.random(random_state=rng).as_matrix()
        seen, stars = seen_in(sky.catalog, true, rng, **field)
        result = identify(sky, seen, tracked(true, rng) if tracker else None, LEVEL)
        if isinstance(result, str):
            reasons.append((len(seen), (stars >= 0).sum(), result))
            continue
        found += 1
        error = Rotation.from_matrix(result.attitude.R_cam_inertial @ true.T).as_rotvec()
        pull = error @ np.linalg.solve(result.attitude.covariance, error)
        named_wrong = (stars[result.detections] != result.stars).mean()
        wrong += bool(pull > stats.chi2.ppf(1 - 1e-9, 3) or named_wrong > 0.34)
    return found, wrong, reasons


@pytest.mark.parametrize("tracker", [False, True])
@pytest.mark.parametrize("field", [{}, {"hidden": True}, {"false": 6}], ids=str)
def test_no_field_is_identified_wrongly_and_rich_ones_are_identified(sky, tracker, field):
    found, wrong, reasons = run(sky, 11, 120, tracker, faintest=6.0, **field)
    assert wrong == 0
    # The triangles are of the 12 brightest detections: with 6 false ones some fields have too few stars among them.
    rich = [one for one in reasons if one[1] >= 7]
    assert len(rich) <= (0.15 if field.get("false") else 0.0) * 120
    assert found >= 60


@pytest.mark.long
def test_wrong_identifications_of_thousands_of_fields(sky):
    """None in 6000: below 5e-4 with a confidence of 95 %."""
    for number, (tracker, false) in enumerate([(False, 0), (False, 6), (True, 0), (True, 6)]):
        found, wrong, _ = run(sky, 200 + number, 1500, tracker, faintest=6.0, false=false)
        assert wrong == 0 and found > 1000


@pytest.mark.parametrize("tracker", [False, True])
def test_point_sources_at_random_places_are_no_stars(sky, tracker):
    rng = np.random.default_rng(12)
    for _ in range(8):
        true = Rotation.random(random_state=rng).as_matrix()
        seen, _ = seen_in(sky.catalog, true, rng, -5.0, false=20)
        result = identify(sky, seen, tracked(true, rng) if tracker else None, LEVEL)
        assert isinstance(result, str) and "no attitude has enough stars" in result


@pytest.mark.parametrize(("count", "tracker", "told"), [(3, False, "3 point sources"), (1, True, "1 point sources")])
def test_too_few_stars_are_a_reason(sky, count, tracker, told):
    rng = np.random.default_rng(13)
    true = Rotation.random(random_state=rng).as_matrix()
    seen, _ = seen_in(sky.catalog, true, rng, 6.0)
    few = Detections(seen.uv_px[:count], seen.flux_dn[:count], seen.sigma_px[:count], 0.5, 1.0)
    result = identify(sky, few, tracked(true, rng) if tracker else None, LEVEL)
    assert isinstance(result, str) and result.startswith(told)


def test_four_stars_alone_are_too_few_to_be_sure_when_lost():
    """The fourth of four stars agrees with each of the triangles tried with a chance of 1e-5: more than 1e-6."""
    sky, rng = Sky.of(CAMERA, artificial_sky(3, 7.0)), np.random.default_rng(14)
    true = Rotation.random(random_state=rng).as_matrix()
    seen, _ = seen_in(sky.catalog, true, rng, 6.0)
    four = Detections(seen.uv_px[:4], seen.flux_dn[:4], seen.sigma_px[:4], 0.5, 1.0)
    assert "4 of 4 point sources agree" in identify(sky, four, None, LEVEL)
    accepted = identify(sky, four, None, 1e-2)
    assert LEVEL < accepted.false_alarm < 1e-2
    np.testing.assert_allclose(accepted.attitude.R_cam_inertial, true, atol=1e-3)


def test_a_mirror_image_is_not_identified(sky):
    rng = np.random.default_rng(15)
    true = Rotation.random(random_state=rng).as_matrix()
    seen, _ = seen_in(sky.catalog, true, rng, 6.0)
    mirrored = Detections(seen.uv_px * [-1, 1] + [1024, 0], seen.flux_dn, seen.sigma_px, 0.5, 1.0)
    assert isinstance(identify(sky, mirrored, None, LEVEL), str)


def test_stars_too_near_to_be_told_apart_are_not_used():
    """A pair of equal stars 2 pixels apart, one with a neighbour of a thousandth of its light, and a star alone."""
    angles = np.array([0.0, 2.0, 100.0, 102.0, 200.0]) * CAMERA.pixel_angle_rad
    directions = np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=-1)
    catalog = StarCatalog(directions[[0, 1, 2, 4, 3]], np.array([1.0, 1.0, 1.0, 1.0, 8.5]))
    np.testing.assert_array_equal(Sky.of(CAMERA, catalog).blended, [True, True, False, False, True])

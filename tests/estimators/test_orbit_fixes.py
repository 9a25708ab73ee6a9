"""Fixes of the body's centre: against scipy's dense least squares, a Kalman update, and chi-square bounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from orbit_worlds import orbit_world
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from boresight.estimators.contract import Estimate
from boresight.estimators.orbit import fixes as fixes_module
from boresight.estimators.orbit.batch_filter import BatchFilter, BatchState, DataArc
from boresight.estimators.orbit.fixes import ApproachNavigator, ApproachTask, measurement_of, predict_orbit
from boresight.estimators.orbit.model import measured_directions
from boresight.estimators.orbit.parameters import OrbitOptions, ParameterLayout
from boresight.scenarios.dynamics.field import HarmonicField
from boresight.scenarios.dynamics.gravity import Harmonics
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Pose, View
from boresight.scenarios.orbits.data import PositionFixes
from boresight.scenarios.orbits.draw import draw_knowledge
from boresight.scenarios.orbits.true_orbit import epochs_s, pointed_at, propagate_truth

FILTER = BatchFilter(OrbitOptions(gravity_degree=0))
ATTITUDE_RAD, MOUNTING_RAD = 5e-5, 1e-4
APPROACH = {"range_m": 1e6, "speed_m_s": 3.0, "miss_m": 2000.0}
IMAGES = 12


def approaching():
    """Return a world with images along an approach, without gravity's anomalies and radiometric data."""
    world = orbit_world(
        arc={"approach": APPROACH, "days": 3.8202, "predicted_days": 0.03},
        asteroid={"anomaly_sigma": 0.0},
        pointing={"attitude_urad": 1e6 * ATTITUDE_RAD, "misalignment_urad": 1e6 * MOUNTING_RAD},
        knowledge={"position_m": 10_000.0},
        imaging={"epochs": IMAGES},
    )
    return replace(world, spec=world.spec.model_copy(update={"radiometry": None}))


WORLD = approaching()
FLOWN = propagate_truth(WORLD, epochs_s(WORLD), 5, 0)


def drawn(trial, ranged=True, common=0.0):
    """Return images' attitudes, knowledge and fixes with errors that are normal and of the stated sizes.

    One error is ``common`` times as large as the others, and has the same size in sigmas and the same axis in all.
    """
    rng = np.random.default_rng([7, trial])
    known = draw_knowledge(WORLD, FLOWN.wanted_states[0], 5, trial)
    sigma = np.repeat([known.position_sigma_m, known.velocity_sigma_m_s], 3)
    field, true = known.field, WORLD.asteroid.harmonics
    harmonics = Harmonics(true.gm_m3_s2 / (1.0 + known.gm_sigma * rng.normal()), true.radius_m, true.c, true.s)
    light = WORLD.light_m_s2 / (1.0 + known.light_sigma * rng.normal())
    known = replace(
        known,
        state=FLOWN.wanted_states[0] + sigma * rng.normal(size=6),
        field=HarmonicField(harmonics, field.rotation, light),
    )
    attitudes = np.stack([pointed_at(state, np.zeros(3)) for state in FLOWN.image_states])
    turns = Rotation.from_rotvec(ATTITUDE_RAD * rng.normal(size=(IMAGES, 3))).as_matrix()
    turns = turns @ Rotation.from_rotvec(MOUNTING_RAD * rng.normal(size=3)).as_matrix()
    centres = -np.einsum("kij,kj->ki", turns @ attitudes, FLOWN.image_states[:, :3])
    ranges = np.linalg.norm(centres, axis=1)
    information, in_all, shared = np.zeros((IMAGES, 3, 3)), np.zeros((IMAGES, 3)), rng.normal() if common else 0.0
    for i, (centre, distance) in enumerate(zip(centres, ranges, strict=True)):
        sight = centre / distance
        across = np.eye(3) - np.outer(sight, sight)
        information[i] = across / (2e-5 * distance) ** 2
        error = across @ (2e-5 * distance * rng.normal(size=3))
        if ranged and distance < 2e5:
            deep = 2e-9 * distance**2
            information[i] += np.outer(sight, sight) / deep**2
            in_all[i] = common * (2e-5 * distance * across[0] + deep * sight)
            information[i] = np.linalg.inv(np.linalg.inv(information[i]) + np.outer(in_all[i], in_all[i]))
            centres[i] = centre + error + deep * rng.normal() * sight + shared * in_all[i]
        else:  # the range is that of something else
            centres[i] = (centre + error) * 1.01
    return attitudes, known, PositionFixes(np.arange(IMAGES), centres, information, in_all)


IMAGE = np.zeros((2, 2), np.float32)


def task_of(attitudes, known, centre=(0.0, 0.0, 0.0)):
    return ApproachTask(FLOWN.times_s, attitudes, known, np.array(centre), WORLD.sun_dir, None, FLOWN.wanted_s)


def data_of(attitudes, known, fixes):
    return task_of(attitudes, known).data(IMAGES, fixes, FLOWN.wanted_s)


def dense(attitudes, known, fixes):
    """Solve for state, GM, sunlight, mounting and every attitude at once, with scipy's propagation about a point."""
    gm, light = known.field.harmonics.gm_m3_s2, known.field.light_m_s2
    sigma = np.repeat([known.position_sigma_m, known.velocity_sigma_m_s], 3)
    roots = []
    for information in fixes.information:
        values, vectors = np.linalg.eigh(information)
        kept = values > 1e-9 * values[-1]
        roots.append(np.sqrt(values[kept])[:, None] * vectors[:, kept].T)
    flown = {}  # the attitudes, of which there are most, move no orbit

    def way_of(x):
        pull, push = gm * (1.0 + known.gm_sigma * x[6]), light * (1.0 + known.light_sigma * x[7])
        start = known.state + sigma * x[:6]

        def change(_, y):
            return np.r_[y[3:], -pull * y[:3] / np.linalg.norm(y[:3]) ** 3 + push]

        end = FLOWN.times_s[-1]
        return solve_ivp(change, (0.0, end), start, "RK45", t_eval=FLOWN.times_s, rtol=1e-11, atol=1e-9).y.T

    def residuals(x):
        key = x[:8].tobytes()
        if key not in flown:
            flown[key] = way_of(x)
        way = flown[key]
        mounting = Rotation.from_rotvec(MOUNTING_RAD * x[8:11]).as_matrix()
        turns = Rotation.from_rotvec(ATTITUDE_RAD * x[11:].reshape(-1, 3)).as_matrix()
        found = [
            root @ (seen + turn @ mounting @ attitude @ here[:3])
            for root, seen, turn, attitude, here in zip(roots, fixes.position_cam_m, turns, attitudes, way, strict=True)
        ]
        return np.concatenate([*found, x])

    solved = least_squares(residuals, np.zeros(11 + 3 * IMAGES), x_scale=1.0, xtol=1e-12, ftol=1e-14, gtol=1e-12)
    covariance = np.linalg.inv(solved.jac.T @ solved.jac)[:6, :6]
    return known.state + sigma * solved.x[:6], covariance * np.outer(sigma, sigma)


@pytest.mark.parametrize(("ranged", "sigmas"), [(True, 0.01), (False, 0.06)])
def test_state_and_covariance_are_those_of_a_dense_fit(ranged, sigmas):
    """Without ranges the filter weighs the attitudes at the range that the fixes assume, which is wrong by 1 %."""
    attitudes, known, fixes = drawn(3, ranged)
    found = FILTER.determine(data_of(attitudes, known, fixes))
    assert found.status == "ok"
    state, covariance = dense(attitudes, known, fixes)
    sigma = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose((found.orbit.state - state) / sigma, 0.0, atol=sigmas)
    scale = np.outer(sigma, sigma)
    np.testing.assert_allclose(found.orbit.covariance / scale, covariance / scale, atol=sigmas)
    if ranged:  # the depth is what the prior has of it without
        assert sigma[:3].max() < 0.5 * known.position_sigma_m


@pytest.mark.parametrize("common", [0.0, 3.0])
def test_errors_are_those_of_the_covariance(common):
    """NEES of 6 at the epoch, of 3 at the end, over 24 draws; each bound fails by chance once in a thousand."""
    epoch, end = [], []
    for trial in range(24):
        data = data_of(*drawn(trial, common=common))
        orbit = FILTER.determine(data).orbit
        error = orbit.state - FLOWN.wanted_states[0]
        epoch.append(error @ np.linalg.solve(orbit.covariance, error))
        last = orbit.positions_m[-1] - FLOWN.wanted_states[-1, :3]
        end.append(last @ np.linalg.solve(orbit.position_covariances_m2[-1], last))
    for values, freedoms in ((epoch, 6), (end, 3)):
        low, high = chi2.ppf([5e-4, 1.0 - 5e-4], 24 * freedoms)
        assert low < np.sum(values) < high


def test_derivatives_are_central_differences():
    attitudes, known, fixes = drawn(1)
    data = data_of(attitudes, replace(known, focal_sigma=1e-3), fixes)
    layout = ParameterLayout.of(data, FILTER.options)
    start = BatchState.initial(data, layout)
    model = DataArc.until(data, layout, FILTER.options, start, data.pictures.times_s[-1]).model
    x = 0.1 * np.random.default_rng(0).normal(size=layout.size)
    found = model.tracking(x, model.propagate(x))
    assert found.fixes == len(found.residuals) > 2 * IMAGES
    for p in range(layout.size):
        step = np.zeros(layout.size)
        step[p] = 1e-3
        ahead, behind = (model.tracking(x + s, model.propagate(x + s)).residuals for s in (step, -step))
        difference = -(ahead - behind) / 2e-3
        np.testing.assert_allclose(found.by_shared[:, p], difference, atol=2e-3 * np.abs(difference).max() + 1e-6)


def test_a_common_error_is_considered_as_by_the_whole_covariance_of_the_fixes():
    """Weighted least squares with the gain G has the covariance G N G^T and that of the prior, N of all fixes."""
    data = data_of(*drawn(1, common=2.0))
    layout = ParameterLayout.of(data, FILTER.options)
    start = BatchState.initial(data, layout)
    model = DataArc.until(data, layout, FILTER.options, start, data.pictures.times_s[-1]).model
    flown = model.propagate(start.x)
    by = model.tracking(start.x, flown).by_shared
    directions = measured_directions(data.fixes, layout)
    parts = np.einsum("ki,ki->k", directions.rows, data.fixes.common_m[directions.fix])
    between = directions.fix[:, None] != directions.fix
    noise = np.eye(len(parts)) + between * np.outer(parts, parts)
    alone = np.linalg.inv(by.T @ by + layout.information)
    gain = alone @ by.T
    expected = gain @ noise @ gain.T + alone @ layout.information @ alone
    np.testing.assert_allclose(model.considered(start.x, flown, alone), expected, atol=1e-9 * np.abs(expected).max())
    assert expected[0, 0] > 1.2 * alone[0, 0]


@pytest.mark.parametrize("rows", [2, 3])
def test_what_an_update_adds_to_the_prior_is_its_measurement(rows):
    rng = np.random.default_rng(rows)
    root = rng.normal(size=(3, 3)) @ np.diag([3000.0, 500.0, 300.0])
    prior, by = root @ root.T, rng.normal(size=(rows, 3))
    noise = np.diag([25.0, 100.0, 400.0][:rows])
    measured = rng.normal(size=rows) * 300.0
    gain = prior @ by.T @ np.linalg.inv(by @ prior @ by.T + noise)
    common = np.array([3.0, -5.0, 2.0])[:rows]
    found = measurement_of(prior, gain @ measured, prior - gain @ by @ prior, gain @ common)
    expected = by.T @ np.linalg.inv(noise) @ by
    np.testing.assert_allclose(found.information, expected, atol=1e-4 * np.abs(expected).max())
    np.testing.assert_allclose(by @ found.moved_m, measured, rtol=1e-3)
    np.testing.assert_allclose(by @ found.common_m, common, rtol=1e-3)
    whole = measured @ np.linalg.solve(by @ prior @ by.T + noise, measured)
    assert (found.squared, found.directions) == (pytest.approx(whole, rel=1e-4), rows)
    # A hundredth of the variance in one direction is no measurement of it.
    little = np.diag([0.5, 0.99, 0.5])
    assert measurement_of(np.eye(3), np.ones(3), little, np.zeros(3)).moved_m.tolist() == [2.0, 0.0, 2.0]
    assert measurement_of(prior, np.zeros(3), prior, np.zeros(3)) is None
    assert measurement_of(-prior, np.zeros(3), prior, np.zeros(3)) is None


@pytest.mark.parametrize("directions", [1, 2, 3])
def test_the_gate_is_as_rarely_wrong_in_all_directions_as_in_one(directions):
    """The whole length counts, on whatever axes it is: not its mean over the directions."""
    limit = np.sqrt(chi2.isf(chi2.sf(16.0, 1), directions))
    stated = np.diag([1e-4 if axis < directions else 1.0 for axis in range(3)])
    for along in (np.eye(3)[0], np.r_[np.ones(directions), np.zeros(3 - directions)] / np.sqrt(directions)):
        for share, contradicts in ((0.999, False), (1.001, True)):
            # The step is the innovation, of variance 1 / (1 - 1e-4), times the gain 1 - 1e-4.
            step = share * limit * np.sqrt(1.0 - 1e-4) * along
            assert measurement_of(np.eye(3), step, stated, np.zeros(3)).contradicts(4.0) is contradicts
    if directions == 1:
        assert limit == pytest.approx(4.0)


def test_a_turned_estimate_moves_the_centre_of_mass_by_its_own_rotation():
    attitudes, known, _ = drawn(4)
    centre = np.array([1000.0, -2000.0, 500.0])
    navigator = ApproachNavigator(task_of(attitudes, known, centre), FILTER)
    frame = navigator.frame(0, IMAGE)
    prior, before = frame.prior_T_cam_body, frame.prior_covariance
    turned = Rotation.from_rotvec([0.0, 0.0, 0.3]).as_matrix() @ prior.rotation
    # About the centre of mass, which stays where it is.
    pose = Pose(turned, prior.translation_m + (prior.rotation - turned) @ centre)
    navigator.add(0, frame, Estimate("ok", pose=pose, covariance=0.01 * before))
    fix = navigator.result()[1].fixes
    np.testing.assert_allclose(fix.position_cam_m[0], prior.translation_m + prior.rotation @ centre, atol=1e-6)


def navigated(attitudes, known, fixes, wrong=()):
    """Navigate with an estimator that fuses the given fixes with each prior, as those of single images do."""
    centre = np.array([10.0, -20.0, 5.0])
    navigator = ApproachNavigator(task_of(attitudes, known, centre), FILTER)
    for i, (seen, information) in enumerate(zip(fixes.position_cam_m, fixes.information, strict=True)):
        frame = navigator.frame(i, IMAGE)
        prior, before = frame.prior_T_cam_body, frame.prior_covariance
        nominal = attitudes[i] @ known.field.rotation.at(FLOWN.times_s[i : i + 1])[0].T
        np.testing.assert_allclose(prior.rotation, nominal, atol=5.0 * known.misalignment_sigma_rad)
        covariance = before.copy()
        covariance[3:, 3:] = np.linalg.inv(np.linalg.inv(before[3:, 3:]) + information)
        # The origin of the shape is not the centre of mass.
        origin = seen - prior.rotation @ centre + (5e4 if i in wrong else 0.0)
        step = covariance[3:, 3:] @ information @ (origin - prior.translation_m)
        pose = Pose(prior.rotation, prior.translation_m + step)
        common = np.r_[np.zeros(3), covariance[3:, 3:] @ information @ fixes.common_m[i]]
        navigator.add(i, frame, Estimate("ok", pose=pose, covariance=covariance, common=common))
    return navigator.result()[0]


@pytest.mark.parametrize("common", [0.0, 3.0])
def test_priors_of_the_orbit_are_not_counted_twice(common):
    attitudes, known, fixes = drawn(4, common=common)
    found, direct = navigated(attitudes, known, fixes), FILTER.determine(data_of(attitudes, known, fixes))
    assert found.diagnostics["fixes"] == IMAGES
    sigma = np.sqrt(np.diag(direct.orbit.covariance))
    np.testing.assert_allclose((found.orbit.state - direct.orbit.state) / sigma, 0.0, atol=0.05)
    np.testing.assert_allclose(np.sqrt(np.diag(found.orbit.covariance)) / sigma, 1.0, atol=0.02)


@pytest.mark.parametrize("seen", [IMAGES, 2])
def test_a_predicted_covariance_is_that_of_a_dense_fit(seen):
    """The estimator, which sees the views alone, tells what it would add to each prior."""
    attitudes, known, fixes = drawn(4)
    camera, turns = Camera(64, 64, 600.0, 600.0, 32.0, 32.0), known.field.rotation.at(FLOWN.times_s)
    poses = [
        Pose(attitude @ turn.T, position)
        for attitude, turn, position in zip(attitudes, turns, fixes.position_cam_m, strict=True)
    ]
    views = [View(camera, pose, turn @ WORLD.sun_dir) for pose, turn in zip(poses, turns, strict=True)]

    def predict(planned):
        number = int(np.searchsorted(FLOWN.times_s, planned.frame.time_s))
        np.testing.assert_array_equal(planned.frame.prior_T_cam_body.translation_m, poses[number].translation_m)
        np.testing.assert_allclose(planned.frame.sun_dir_cam, attitudes[number] @ WORLD.sun_dir)
        if number >= seen:
            return None
        covariance = planned.frame.prior_covariance.copy()
        covariance[3:, 3:] = np.linalg.inv(np.linalg.inv(covariance[3:, 3:]) + fixes.information[number])
        return Estimate("ok", covariance=covariance)

    nominal = replace(known, state=FLOWN.wanted_states[0])
    found = predict_orbit(task_of(attitudes, nominal), FILTER, camera, views, predict)
    if seen < 3:
        assert found is None
        return
    _, covariance = dense(attitudes, known, fixes)
    sigma = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(found / np.outer(sigma, sigma), covariance / np.outer(sigma, sigma), atol=0.03)


def test_the_prior_of_an_image_has_the_errors_of_attitude_and_spin():
    attitudes, known, _ = drawn(4)
    known = replace(known, pole_sigma_rad=2e-4, spin_sigma=1e-6)
    frame = ApproachNavigator(task_of(attitudes, known), FILTER).frame(3, IMAGE)
    spun = 1e-6 * known.field.rotation.rate_rad_s * FLOWN.times_s[3]
    turned = ATTITUDE_RAD**2 + MOUNTING_RAD**2
    np.testing.assert_allclose(frame.prior_covariance[:3, :3], (turned + 4e-8 + spun**2) * np.eye(3), rtol=1e-9)
    # Before any image the velocity of the epoch leaves its error times the time, plus that of the position.
    range_m = np.linalg.norm(frame.prior_T_cam_body.translation_m)
    sigma2 = known.position_sigma_m**2 + (known.velocity_sigma_m_s * FLOWN.times_s[3]) ** 2
    across = np.sort(np.linalg.eigvalsh(frame.prior_covariance[3:, 3:]))
    np.testing.assert_allclose(across, sigma2 + np.array([0.0, 1.0, 1.0]) * turned * range_m**2, rtol=1e-2)


def test_an_estimate_that_contradicts_its_prior_is_left_out():
    attitudes, known, fixes = drawn(4)
    found = navigated(attitudes, known, fixes, wrong=(8,))
    assert (found.status, found.diagnostics["gated_images"], found.diagnostics["fixes"]) == ("ok", 1, IMAGES - 1)


def innovations(monkeypatch, draws):
    """Return the sum of the squared innovations of right fixes (T, I) in several draws, and of their directions."""
    squares, directions = [], 0

    def spied(*args):
        nonlocal directions
        found = measurement_of(*args)
        if found is not None:
            squares.append(found.squared)
            directions += found.directions
        return found

    monkeypatch.setattr(fixes_module, "measurement_of", spied)
    for attitudes, known, fixes in draws:
        found = navigated(attitudes, known, fixes)
        assert (found.diagnostics["gated_images"], found.diagnostics["fixes"]) == (0, IMAGES)
    return np.reshape(squares, (-1, IMAGES)), directions


def test_innovations_of_right_fixes_are_those_of_their_covariance(monkeypatch):
    """The mounting is estimated: its error is in the prior once, in the last images as in all; bounds of 0.1 %."""
    squares, directions = innovations(monkeypatch, [drawn(trial) for trial in range(5)])
    low, high = chi2.ppf([5e-4, 1.0 - 5e-4], directions)
    assert low < squares.sum() < high
    low, high = chi2.ppf([5e-4, 1.0 - 5e-4], 5 * 4 * 3)  # near the body all three directions are measured
    assert low < squares[:, -4:].sum() < high


def test_priors_have_the_error_of_the_focal_length(monkeypatch):
    """The orbit is known to 100 m, of which an error of one sigma of the focal length is twenty times as much."""
    draws = []
    for trial in range(4):
        attitudes, known, fixes = drawn(trial)
        position_m = fixes.position_cam_m.copy()
        position_m[:, 2] /= 1.0 + 2e-3
        known = replace(
            known,
            focal_sigma=2e-3,
            state=FLOWN.wanted_states[0] + (known.state - FLOWN.wanted_states[0]) / 100.0,
            position_sigma_m=known.position_sigma_m / 100.0,
            velocity_sigma_m_s=known.velocity_sigma_m_s / 100.0,
        )
        draws.append((attitudes, known, replace(fixes, position_cam_m=position_m)))
    assert innovations(monkeypatch, draws)[0].max() < chi2.ppf(1.0 - 1e-5, 3)


@pytest.mark.parametrize("trial", [0, 1, 2])
def test_a_wrong_first_fix_is_left_out_and_not_the_right_ones_after_it(trial, monkeypatch):
    """Alone with the a priori orbit it is 2 sigma off an axis, and passes; the images after it contradict it."""
    attitudes, known, fixes = drawn(trial)
    position_m = fixes.position_cam_m.copy()
    position_m[0, :2] += 12_000.0
    priors, determine = [], ApproachNavigator._accepted

    def spied(navigator, count, wanted_s):
        found = determine(navigator, count, wanted_s)
        priors.append(found.status)
        return found

    monkeypatch.setattr(ApproachNavigator, "_accepted", spied)
    found = navigated(attitudes, known, replace(fixes, position_cam_m=position_m))
    assert (found.status, found.diagnostics["gated_images"], found.diagnostics["fixes"]) == ("ok", 1, IMAGES - 1)
    assert set(priors) == {"ok"}
    error = found.orbit.state - FLOWN.wanted_states[0]
    assert error @ np.linalg.solve(found.orbit.covariance, error) < chi2.ppf(0.999, 6)


def test_a_failure_names_the_images_that_were_left_out():
    attitudes, known, _ = drawn(0)
    navigator = ApproachNavigator(task_of(attitudes, known), FILTER)
    frame = navigator.frame(0, IMAGE)
    prior, before = frame.prior_T_cam_body, frame.prior_covariance
    far = Pose(prior.rotation, prior.translation_m + np.array([1e5, 0.0, 0.0]))
    navigator.add(0, frame, Estimate("ok", pose=far, covariance=1e-4 * before))
    assert navigator.result()[0].reason == (
        f"0 of {IMAGES} images have a fix: at least 3 are needed; left out, as they contradict others: images 1"
    )


def test_images_without_estimates_give_no_orbit():
    attitudes, known, _ = drawn(4)
    navigator = ApproachNavigator(task_of(attitudes, known), FILTER)
    frame = navigator.frame(0, IMAGE)
    for estimate in (Estimate("failed", "black"), Estimate("ok", pose=frame.prior_T_cam_body)):
        navigator.add(0, frame, estimate)
    found, _ = navigator.result()
    assert (found.status, found.reason) == ("failed", f"0 of {IMAGES} images have a fix: at least 3 are needed")


@pytest.mark.parametrize(
    ("image", "position", "said"),
    [
        ([0, 0], np.zeros((2, 3)), "fixes: images must ascend"),
        ([0], np.zeros((2, 3)), "do not go with positions"),
        ([0], np.full((1, 3), np.nan), "finite numbers"),
        ([IMAGES], np.zeros((1, 3)), f"are not all of {IMAGES} pictures"),
    ],
)
def test_wrong_fixes_are_refused(image, position, said):
    attitudes, known, _ = drawn(0)
    with pytest.raises(BoresightError, match=said):
        data_of(attitudes, known, PositionFixes(np.array(image), position, np.zeros((len(image), 3, 3)), 0 * position))

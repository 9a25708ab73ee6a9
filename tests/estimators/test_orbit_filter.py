"""The batch filter: derivatives, Schur complement against scipy's least squares, recovery, consistency, bad input."""

from dataclasses import replace

import numpy as np
import pytest
from orbit_worlds import CAMERA, orbit_world
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from boresight.estimators.orbit.batch_filter import BatchFilter, BatchState, DataArc
from boresight.estimators.orbit.contract import LandmarkFile, OrbitData, Pictures
from boresight.estimators.orbit.kernels import consistent_rays
from boresight.estimators.orbit.model import Unknowns, propagate_orbit
from boresight.estimators.orbit.parameters import OrbitOptions, ParameterLayout
from boresight.estimators.orbit.solve import HuberLoss, LandmarkPrior, StoppingCriteria, adjust, linearise
from boresight.estimators.registry import orbit_estimator_class
from boresight.scenarios.dynamics.field import UniformRotation
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.orbits.draw import draw_orbit

LEAST_SQUARES = HuberLoss(np.inf, 1.0)


@pytest.fixture(scope="module")
def clean():
    return draw_orbit(orbit_world(), 5, 0)


@pytest.fixture(scope="module")
def solved(clean):
    return BatchFilter().determine(clean[1])


def _arc(data, options=None, until=np.inf):
    options = options or OrbitOptions()
    layout = ParameterLayout.of(data, options)
    solution = BatchState.initial(data, layout)
    return DataArc.until(data, layout, options, solution, min(until, data.pictures.times_s[-1])), solution


def test_derivatives_are_central_differences(clean):
    known = replace(clean[1].knowledge, focal_sigma=1e-3, noise_m_s2=1e-10, pole_sigma_rad=2e-4, spin_sigma=1e-4)
    arc, solution = _arc(replace(clean[1], knowledge=known))
    layout, model = arc.layout, arc.model
    assert layout.spin.stop - layout.spin.start == 3
    start = arc.unknowns(solution)
    rng = np.random.default_rng(0)
    start = Unknowns(0.1 * rng.normal(size=layout.size), 1e-4 * rng.normal(size=start.tilts.shape), start.points)
    here = linearise(model, arc.prior(), start, LEAST_SQUARES)
    shared = model.shared(start, here.flown)[model.measured.image]
    by_shared = here.sightings.by_image @ shared

    def predicted(unknowns):
        there = linearise(model, arc.prior(), unknowns, LEAST_SQUARES)
        return -there.sightings.residuals, -there.passes.residuals

    for p in range(layout.size):
        step = np.zeros(layout.size)
        step[p] = 1e-3
        ahead, behind = (predicted(replace(start, x=start.x + s)) for s in (step, -step))
        for found, a, b in zip((by_shared[..., p], here.passes.by_shared[:, p]), ahead, behind, strict=True):
            difference = (a - b) / 2e-3
            np.testing.assert_allclose(found, difference, atol=2e-3 * np.abs(difference).max() + 1e-6)
    for axis in range(2):
        step = np.zeros(start.tilts.shape)
        step[:, axis] = 1e-6
        ahead, behind = (predicted(replace(start, tilts=start.tilts + s))[0] for s in (step, -step))
        difference = (ahead - behind) / 2e-6
        np.testing.assert_allclose(here.sightings.by_image[..., 3 + axis], difference, atol=1e-3 * CAMERA.fx_px)
    for axis in range(3):
        step = np.zeros(start.points.shape)
        step[:, axis] = 0.01
        ahead, behind = (predicted(replace(start, points=start.points + s))[0] for s in (step, -step))
        np.testing.assert_allclose(here.sightings.by_point[..., axis], (ahead - behind) / 0.02, atol=1e-5)


def test_points_on_the_rays_of_sightings_leave_no_residuals(clean):
    data = replace(clean[1], knowledge=replace(clean[1].knowledge, focal_sigma=0.01))
    arc, solution = _arc(data)
    x = 0.5 * np.random.default_rng(0).normal(size=arc.layout.size)
    assert abs(arc.layout.focal(x)) > 1e-4
    rays, first = arc.rays(x, solution.tilts), arc.measured.begin[:-1]
    points = rays.origins_m[first] + 2500.0 * rays.directions[first]
    unknowns = Unknowns(x, solution.tilts[: len(arc.measured.times_s)], points)
    residuals = arc.model.sightings(unknowns, arc.model.propagate(x)).residuals
    np.testing.assert_allclose(residuals[first], 0.0, atol=1e-6)


def test_a_twist_about_the_boresight_is_in_the_deviation_of_pixels(clean):
    known = replace(clean[1].knowledge, attitude_sigma_rad=0.002)
    measured = _arc(replace(clean[1], knowledge=known))[0].measured
    twist = Rotation.from_rotvec([0.0, 0.0, 0.002])
    moved = CAMERA.project(twist.apply(CAMERA.unproject(measured.uv_px))) - measured.uv_px
    added = measured.sigma_px**2 - known.noise_px**2
    np.testing.assert_allclose(added, np.mean(moved**2, axis=1), rtol=1e-3)


def test_a_landmark_of_twice_the_deviation_has_a_quarter_of_the_information(clean):
    data = clean[1]
    wide = replace(data, landmarks=replace(data.landmarks, sigma_m=2.0 * data.landmarks.sigma_m))
    one, other = (_arc(some, OrbitOptions(landmarks="prior"))[0].prior().information for some in (data, wide))
    np.testing.assert_allclose(one, 4.0 * other)


def test_means_of_unmodelled_accelerations_correlate_as_their_integrals(clean):
    """Means of exp(-|s - t|) over two intervals, by 400 midpoints of each."""
    known = replace(clean[1].knowledge, noise_m_s2=1e-10, noise_time_s=86_400.0)
    layout = ParameterLayout.of(replace(clean[1], knowledge=known), OrbitOptions(piece_share=0.5))
    assert layout.pieces == 5
    times = (np.arange(5 * 400) + 0.5) * 0.5 / 400
    expected = np.exp(-abs(times[:, None] - times)).reshape(5, 400, 5, 400).mean(axis=(1, 3))
    pushes = layout.part("pushes")
    found = np.linalg.inv(layout.information[pushes, pushes])
    np.testing.assert_allclose(found, np.kron(expected, np.eye(3)), atol=1e-5)


def test_a_tilted_axis_is_the_same_as_data_that_are_turned_by_hand(solved):
    _, data = draw_orbit(orbit_world(knowledge={"pole_sigma_deg": 0.3, "spin_sigma": 1e-4}), 5, 0)
    known, pictures, radio = data.knowledge, data.pictures, data.radiometry
    spin = known.field.rotation
    turn = spin.R_body_inertial
    field = replace(
        known.field, rotation=UniformRotation(np.eye(3), spin.rate_rad_s), light_m_s2=turn @ known.field.light_m_s2
    )
    state = np.concatenate([turn @ known.state[:3], turn @ known.state[3:]])
    turned = replace(
        data,
        knowledge=replace(known, field=field, state=state),
        pictures=replace(pictures, R_cam_inertial=pictures.R_cam_inertial @ turn.T),
        radiometry=replace(radio, earth_dir=turn @ radio.earth_dir),
    )
    orbit, other = (BatchFilter().determine(one).orbit for one in (data, turned))
    np.testing.assert_allclose(orbit.positions_m @ turn.T, other.positions_m, atol=0.01)
    assert np.linalg.norm(orbit.positions_m - solved.orbit.positions_m, axis=1).max() > 1.0


def test_the_reduced_solution_is_that_of_scipys_least_squares(clean):
    data, options = clean[1], OrbitOptions(gravity_degree=2)
    arc, solution = _arc(data, options, until=0.35 * 86_400.0)
    layout, model = arc.layout, arc.model
    start = arc.unknowns(solution)
    prior = LandmarkPrior(start.points, np.full(len(start.points), 50.0**-2))
    found = adjust(model, prior, start, LEAST_SQUARES, StoppingCriteria(30, 1e-12))
    n, images, sigma = layout.size, len(model.measured.times_s), layout.knowledge.attitude_sigma_rad
    root = np.linalg.cholesky(layout.information).T

    def residuals(values):
        x, tilts = values[:n], sigma * values[n : n + 2 * images].reshape(-1, 2)
        points = start.points + values[n + 2 * images :].reshape(-1, 3)
        here = linearise(model, prior, Unknowns(x, tilts, points), LEAST_SQUARES)
        seen = here.sightings.residuals / model.measured.sigma_px[:, None]
        return np.r_[
            seen.ravel(), here.passes.residuals, root @ x, tilts.ravel() / sigma, (points - start.points).ravel() / 50.0
        ]

    size = n + 2 * images + start.points.size
    dense = least_squares(residuals, np.zeros(size), x_scale="jac", xtol=1e-12, ftol=1e-12, gtol=1e-12)
    assert found.converged
    assert found.linear.cost == pytest.approx(dense.cost, rel=1e-7)
    np.testing.assert_allclose(found.linear.unknowns.x, dense.x[:n], atol=2e-4)
    covariance = np.linalg.inv(dense.jac.T @ dense.jac)[:n, :n]
    scale = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(
        found.covariance(n) / np.outer(scale, scale), covariance / np.outer(scale, scale), atol=0.01
    )


def test_it_finds_the_orbit_within_its_covariance(clean, solved):
    truth, _ = clean
    assert solved.status == "ok", solved.reason
    error = solved.orbit.state - truth.states[0]
    nees = error @ np.linalg.solve(solved.orbit.covariance, error)
    assert nees < 22.5  # 0.1 % of a chi-square of 6
    apart = np.linalg.norm(solved.orbit.positions_m - truth.states[:, :3], axis=1)
    assert apart.max() < 4.0 * np.sqrt(np.trace(solved.orbit.position_covariances_m2, axis1=1, axis2=2).max())
    assert np.sqrt(np.trace(solved.orbit.covariance[:3, :3])) < 5.0  # m, of 30 before
    assert solved.diagnostics["chi_square_per_freedom"] == pytest.approx(1.0, abs=0.15)


def normalised_squares(world, seed, trials):
    """Return the sum over drawn orbits of the squared errors of the state, by the stated covariances."""
    total = 0.0
    for trial in range(trials):
        truth, data = draw_orbit(world, seed, trial)
        found = BatchFilter().determine(data)
        assert found.status == "ok", found.reason
        error = found.orbit.state - truth.states[0]
        total += error @ np.linalg.solve(found.orbit.covariance, error)
    return total


def test_covariances_foretell_errors():
    # The sum is a chi-square of 72 degrees of freedom.
    low, high = chi2.interval(0.999, 72)
    assert low < normalised_squares(orbit_world(), 11, 12) < high


def test_an_error_of_the_spin_is_estimated_and_in_the_covariance():
    """The deviation of the rate turns the body by 1 deg over the arc, up to 8 pixels."""
    world = orbit_world(knowledge={"pole_sigma_deg": 0.3, "spin_sigma": 3e-4})
    # The sum is a chi-square of 36 degrees of freedom.
    low, high = chi2.interval(0.999, 36)
    assert low < normalised_squares(world, 12, 6) < high


def test_the_same_data_give_the_same_bits(clean, solved):
    again = BatchFilter().determine(clean[1])
    assert np.array_equal(again.orbit.state, solved.orbit.state)
    assert np.array_equal(again.orbit.covariance, solved.orbit.covariance)


def test_an_orbit_that_was_followed_is_taken_again_for_the_same_unknowns_alone(clean):
    data = clean[1]
    layout, times = ParameterLayout.of(data, OrbitOptions()), data.pictures.times_s
    x, other = np.zeros(layout.size), np.full(layout.size, 1e-3)
    first = propagate_orbit(layout, x, times)
    assert propagate_orbit(layout, x.copy(), times.copy()) is first
    for unknowns, wanted in ((other, times), (x, times[:-3]), (other, times[:-3]), (x, times)):
        fresh = propagate_orbit(ParameterLayout.of(data, OrbitOptions()), unknowns, wanted)
        assert np.array_equal(propagate_orbit(layout, unknowns, wanted).by_state, fresh.by_state)
    assert len(layout.flights) == 2  # those of a whole solution would fill the memory


def test_wrong_numbers_are_edited_and_shared_ones_split():
    world, split, shared = (
        orbit_world(sightings={"wrong_share": 0.06, "merged_share": 0.1, "wrong_within_px": 200.0}),
        0.0,
        0,
    )
    for trial in (1, 2, 4):
        truth, data = draw_orbit(world, 5, trial)
        found = BatchFilter().determine(data)
        assert found.status == "ok", found.reason
        error = found.orbit.state - truth.states[0]
        assert error @ np.linalg.solve(found.orbit.covariance, error) < 22.5
        assert (~found.orbit.used[truth.wrong]).mean() > 0.8
        numbers, counts = np.unique(found.orbit.numbers, return_counts=True)
        assert set(numbers) <= set(data.landmarks.numbers)
        split += found.diagnostics["split_numbers"]
        shared += int((counts == 2).sum())
    # Not in every draw are both craters of a number seen often enough.
    assert split >= shared > 0


def test_sightings_beyond_four_sigmas_are_edited_and_no_others(clean):
    """Ten sightings of landmarks that are seen often, displaced by 8 sigmas: three times the limit would be 12."""
    data = clean[1]
    pictures, known = data.pictures, data.knowledge
    counts = np.bincount(pictures.landmark)
    moved = np.flatnonzero(counts[pictures.landmark] >= 8)[::7][:10]
    off_axis = np.linalg.norm(pictures.uv_px - [known.camera.cx_px, known.camera.cy_px], axis=1)
    sigma = np.hypot(known.noise_px, known.attitude_sigma_rad * off_axis / np.sqrt(2.0))
    uv = pictures.uv_px.copy()
    uv[moved, 0] += 8.0 * sigma[moved]
    orbit = BatchFilter().determine(replace(data, pictures=replace(pictures, uv_px=uv))).orbit
    lengths = np.linalg.norm(orbit.residuals_px, axis=1) / sigma
    assert len(moved) == 10
    assert (lengths[moved] < 12.0).all()
    assert not orbit.used[moved].any()
    assert orbit.used[np.setdiff1d(np.flatnonzero(lengths <= 4.0), moved)].all()
    assert not orbit.used[lengths > 4.0].any()


def test_hubers_loss_has_its_edge_at_the_limit_times_the_scale():
    """At scale 3 and limit 2 the edge is 6: squares below, straight lines beyond, in units of the scale."""
    robust, lengths = HuberLoss(2.0, 3.0), np.array([0.0, 3.0, 5.9, 6.1, 60.0])
    np.testing.assert_allclose(robust.weights(lengths), [1 / 9, 1 / 9, 1 / 9, 6 / 6.1 / 9, 0.1 / 9])
    for length, cost in zip(lengths, [0.0, 0.5, 0.5 * 5.9**2 / 9, (18 + 6 * 0.1) / 9, (18 + 6 * 54) / 9], strict=True):
        assert robust.cost(np.array([length])) == pytest.approx(cost)
    assert LEAST_SQUARES.cost(lengths) == pytest.approx(0.5 * np.sum(lengths**2))


def test_a_robust_fit_takes_its_scale_from_the_residuals(clean):
    """Pixels and attitudes noisier than believed: the cost is that of Huber's loss at the scale of the residuals."""
    data = clean[1]
    quiet = replace(
        data, knowledge=replace(data.knowledge, noise_px=data.knowledge.noise_px / 3, attitude_sigma_rad=1e-9)
    )
    arc, solution = _arc(quiet)
    solution, adjusted, _ = BatchFilter()._fit_robustly(arc, solution)
    linear = adjusted.linear
    scale = np.median(linear.lengths) / np.sqrt(2.0 * np.log(2.0))
    assert 3.0 < scale < 4.0
    costs = [
        linearise(arc.model, arc.prior(), linear.unknowns, HuberLoss(2.0, s)).cost for s in (0.9 * scale, 1.6 * scale)
    ]
    assert costs[1] < linear.cost < costs[0]


def test_solar_pressure_that_is_held_wrong_costs_accuracy_that_residuals_do_not_show():
    world = orbit_world(light={"area_to_mass_m2_kg": 0.05}, knowledge={"light_sigma": 0.1})
    truth, data = draw_orbit(world, 5, 2)
    errors, residuals = [], []
    for way in ("estimated", "held"):
        found = BatchFilter.from_options({"solar_pressure": way, "chi_square_max": 50.0}).determine(data)
        errors.append(np.linalg.norm(found.orbit.positions_m - truth.states[:, :3], axis=1).max())
        residuals.append(found.diagnostics["residual_rms_px"])
    assert errors[1] > 1.5 * errors[0]
    assert residuals[1] < 1.2 * residuals[0]


def test_a_far_a_priori_orbit_is_no_obstacle():
    world = orbit_world(knowledge={"position_m": 150.0})
    truth, data = draw_orbit(world, 5, 3)
    found = BatchFilter.from_options({"first_days": 0.4}).determine(data)
    assert found.status == "ok", found.reason
    assert np.linalg.norm(found.orbit.state[:3] - truth.states[0, :3]) < 5.0


def test_rays_through_two_places_are_told_apart():
    rng = np.random.default_rng(4)
    places = np.array([[0.0, 0.0, 0.0], [40.0, 0.0, 0.0]])
    which = np.array([0, 1, 0, 0, 1, 0, 1, 0])
    origins = 1000.0 * rng.normal(size=(9, 3))
    directions = np.vstack([places[which], [[300.0, 0.0, 0.0]]]) - origins
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    found = consistent_rays(origins, directions, np.array([0, 9]), np.full(9, 2e-3), 3)
    assert found.tolist() == [*which.tolist(), -1]
    directions[3] *= -1.0  # a ray that leaves its place behind does not see it
    assert consistent_rays(origins, directions, np.array([0, 9]), np.full(9, 2e-3), 3)[3] == -1


def test_nonsense_is_refused_or_fails_with_a_reason(clean):
    data = clean[1]
    pictures = data.pictures
    with pytest.raises(BoresightError, match="stands twice in image"):
        Pictures(
            pictures.times_s,
            pictures.R_cam_inertial,
            np.r_[pictures.image, pictures.image[0]],
            np.r_[pictures.landmark, pictures.landmark[0]],
            np.vstack([pictures.uv_px, pictures.uv_px[:1]]),
        )
    marks = data.landmarks
    with pytest.raises(BoresightError, match="stands twice"):
        LandmarkFile(marks.numbers[[0, 0]], marks.positions_body_m[:2], marks.sigma_m[:2])
    with pytest.raises(BoresightError, match="has no position"):
        OrbitData(
            data.knowledge,
            pictures,
            LandmarkFile(marks.numbers[1:], marks.positions_body_m[1:], marks.sigma_m[1:]),
            None,
            data.wanted_s,
        )
    with pytest.raises(BoresightError, match="unknown"):
        orbit_estimator_class("no-such")
    with pytest.raises(BoresightError, match="growth"):
        BatchFilter.from_options({"growth": 0.5})
    few = replace(pictures, image=pictures.image[:3], landmark=pictures.landmark[:3], uv_px=pictures.uv_px[:3])
    found = BatchFilter().determine(replace(data, pictures=few))
    assert found.status == "failed"
    assert "too few" in found.reason


def test_pixels_that_mean_nothing_and_a_falling_orbit_fail_with_a_reason(clean):
    data = clean[1]
    noise = np.random.default_rng(0).uniform(0.0, 400.0, data.pictures.uv_px.shape)
    found = BatchFilter().determine(replace(data, pictures=replace(data.pictures, uv_px=noise)))
    assert found.status == "failed"
    assert found.reason.startswith("rejected: ")
    assert found.orbit is not None, "the next round of navigation begins with what was rejected"
    assert all(np.isfinite(value) for value in found.diagnostics.values())
    falling = np.r_[data.knowledge.state[:3] / 8.0, 0.0 * data.knowledge.state[3:]]
    known = replace(data.knowledge, state=falling, position_sigma_m=0.01, velocity_sigma_m_s=1e-6)
    found = BatchFilter().determine(replace(data, knowledge=known))
    assert found.status == "failed"
    assert "diverged" in found.reason

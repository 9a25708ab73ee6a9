"""Random draws against the distributions of a scenario.

Every statistical test has a false-alarm level of 1e-4 under the law; seeds are fixed, so that a pass repeats.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from boresight.scenarios.bodies import load_body
from boresight.scenarios.draw import (
    Stream,
    degrade,
    draw_aimed_view,
    draw_lit_view,
    draw_view,
    generator,
    prior_covariance,
)
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import look_at
from boresight.scenarios.load import load_scenario
from boresight.scenarios.spec.distribution import Choice, LogNormal, LogUniform, Normal, Uniform
from boresight.scenarios.spec.vectors import Choice3, Component3, Correlated3, Correlated6, Mixture3, Normal3, Uniform3
from boresight.scenarios.spec.world import (
    PAPER_POSE_ERROR,
    AttitudeErrorSpec,
    LightingSpec,
    PoseErrorSpec,
    ViewpointSpec,
)

FALSE_ALARM = 1e-4
N = 4000
FEW = 1000  # five standard errors of a variance are 22 % of it


@pytest.fixture(scope="module")
def paper():
    return load_scenario("itokawa-2km-lambert").spec


@pytest.fixture(scope="module")
def views(paper):
    return [draw_view(paper, paper.camera.camera(), generator(1, Stream.TRUTH, trial)) for trial in range(N)]


def assert_follows(sample, law) -> None:
    assert stats.kstest(sample, law.cdf).pvalue > FALSE_ALARM


def uniform(low, high):
    return stats.uniform(low, high - low)


# --- streams ---------------------------------------------------------------------------------------------------------


def test_streams_keep_their_numbers():
    assert [(s.name, s.value) for s in Stream][:5] == [
        ("TRUTH", 0), ("POSE_ERROR", 1), ("DETECTOR", 2), ("ESTIMATOR", 3), ("DATABASE", 4),
    ]  # fmt: skip


def test_a_stream_is_its_address():
    """The numbers that numpy documents for a spawned seed sequence, and no two addresses alike."""
    expected = np.random.default_rng(np.random.SeedSequence(5).spawn(3)[2].spawn(8)[7]).random(4)
    assert np.array_equal(generator(5, Stream.DETECTOR, 7).random(4), expected)
    firsts = {generator(s, k, t).random() for s in (0, 1) for k in Stream for t in range(50)}
    assert len(firsts) == 2 * len(Stream) * 50


# --- views -----------------------------------------------------------------------------------------------------------


def turns_of(poses, others):
    """Rotation vectors (N, 3) rad from other attitudes to those of poses, by scipy."""
    rotations, theirs = (np.array([pose.rotation for pose in some]) for some in (poses, others))
    return Rotation.from_matrix(rotations @ np.swapaxes(theirs, 1, 2)).as_rotvec()


def test_the_camera_is_uniform_over_the_sphere(views):
    positions = np.array([v.T_cam_body.camera_position_m for v in views])
    assert np.allclose(np.linalg.norm(positions, axis=1), 2000.0, rtol=1e-12)
    for axis in range(3):
        # Archimedes: each coordinate of a uniform point of a sphere is uniform.
        assert_follows(positions[:, axis] / 2000.0, uniform(-1, 1))
    assert_follows(np.arctan2(positions[:, 1], positions[:, 0]), uniform(-np.pi, np.pi))


def test_the_boresight_points_at_the_origin(views):
    assert np.allclose([v.T_cam_body.translation_m for v in views], [0.0, 0.0, 2000.0], atol=1e-9)


def test_the_roll_is_uniform(views):
    upright = [look_at(view.T_cam_body.camera_position_m) for view in views]
    turns = turns_of([view.T_cam_body for view in views], upright)
    assert np.allclose(turns[:, :2], 0.0, atol=1e-6)
    rolls = turns[:, 2]
    assert_follows(np.abs(rolls), uniform(0, np.pi))
    assert stats.binomtest(int(np.sum(rolls > 0)), N).pvalue > FALSE_ALARM


def test_the_sun_is_uniform_over_the_cap_of_phase_angles(views):
    phases = np.array([v.phase_angle_rad for v in views])
    assert np.degrees(phases.max()) <= 60.0
    assert_follows(np.cos(phases), uniform(0.5, 1.0))
    azimuths = []
    for view in views:
        sun_cam = view.T_cam_body.rotate(view.sun_dir_body)
        azimuths.append(np.arctan2(sun_cam[1], sun_cam[0]))
    assert_follows(np.array(azimuths), uniform(-np.pi, np.pi))


def test_the_phase_may_be_uniform_in_the_angle(paper):
    lighting = LightingSpec(phase_deg=Uniform(uniform=(20, 90)), measure="angle")
    camera, viewpoint = paper.camera.camera(), paper.viewpoint
    drawn = [draw_lit_view(viewpoint, lighting, camera, generator(2, Stream.TRUTH, t)) for t in range(FEW)]
    assert_follows(np.degrees([v.phase_angle_rad for v in drawn]), uniform(20, 90))


def test_a_latitude_band_is_uniform_over_its_area(paper):
    viewpoint = ViewpointSpec(range_m=10, latitude_deg=Uniform(uniform=(-10, 80)))
    drawn = [
        draw_lit_view(viewpoint, LightingSpec(), paper.camera.camera(), generator(3, Stream.TRUTH, t))
        for t in range(FEW)
    ]
    sines = np.array([v.T_cam_body.camera_position_m[2] for v in drawn]) / 10
    assert_follows(sines, uniform(*np.sin(np.radians([-10, 80]))))
    # Latitudes that are themselves uniform are told from these.
    even = stats.uniform(-10, 90)
    assert stats.kstest(np.degrees(np.arcsin(sines)), even.cdf).pvalue < FALSE_ALARM


def test_a_fixed_phase_and_roll_are_kept(paper):
    viewpoint = ViewpointSpec(range_m=10, roll_deg=Uniform(uniform=(30, 30)))
    lighting = LightingSpec(phase_deg=Uniform(uniform=(40, 40)))
    view = draw_lit_view(viewpoint, lighting, paper.camera.camera(), np.random.default_rng(0))
    assert np.degrees(view.phase_angle_rad) == pytest.approx(40, abs=1e-9)
    upright = look_at(view.T_cam_body.camera_position_m, np.radians(30))
    assert view.T_cam_body.angle_to(upright) < 1e-7


def test_real_images_have_no_view_to_draw():
    spec = load_scenario("navcam67p-real").spec
    with pytest.raises(BoresightError, match="viewpoint: missing"):
        draw_view(spec, spec.camera.camera(), np.random.default_rng(0))


# --- pose errors -----------------------------------------------------------------------------------------------------


def priors_of(spec, true_poses, camera):
    return [degrade(T, spec, camera, generator(1, Stream.POSE_ERROR, t)) for t, T in enumerate(true_poses)]


@pytest.fixture(scope="module")
def priors(paper, views):
    return priors_of(paper.pose_error, [v.T_cam_body for v in views], paper.camera.camera())


def errors_of(priors, true_poses):
    """Rotation vectors (N, 3) rad and shifts (N, 3) m, worked out with scipy from the poses alone."""
    shifts = [p.translation_m - T.translation_m for p, T in zip(priors, true_poses, strict=True)]
    return turns_of(priors, true_poses), np.array(shifts)


def test_the_error_of_the_paper_follows_its_law(priors, views):
    turns, shifts = errors_of(priors, [v.T_cam_body for v in views])
    for axis, bound in enumerate((50, 50, 5)):
        assert_follows(shifts[:, axis], uniform(-bound, bound))
    angles = np.linalg.norm(turns, axis=1)
    assert_follows(np.degrees(angles), uniform(0, 2))
    for axis in range(3):
        assert_follows(turns[:, axis] / angles, uniform(-1, 1))
    # Attitude and translation are independent: no correlation beyond 4 sigma.
    assert np.abs(np.corrcoef(turns.T, shifts.T)[:3, 3:]).max() < 4 / np.sqrt(N)


def test_the_prior_error_of_the_paper_is_reproduced(priors, views):
    """Rowell et al. (2015), section 4.2: 1.00 deg, 45.3 m and (27.1, 27.4, 2.45) m of 6000 images before recognition.

    The intervals are four standard errors of a median of 4000.
    """
    pairs = [(prior, view.T_cam_body) for prior, view in zip(priors, views, strict=True)]
    angles = np.degrees([p.angle_to(T) for p, T in pairs])
    errors = np.array([T.rotate(p.camera_position_m - T.camera_position_m) for p, T in pairs])
    assert np.median(angles) == pytest.approx(1.0, abs=4 * 2 / np.sqrt(12) * 1.8 / np.sqrt(N))
    assert np.median(np.linalg.norm(errors, axis=1)) == pytest.approx(45.3, abs=1.7)
    medians = np.sqrt(np.median(errors**2, axis=0))
    assert medians == pytest.approx([27.1, 27.4, 2.45], abs=1.5)
    assert medians[2] == pytest.approx(2.5, abs=0.17)


@pytest.mark.parametrize(
    "pose_error",
    [
        PoseErrorSpec(position_cam_m=Uniform3(uniform=((-50, 50), (-20, 60), (1, 5)))),
        PoseErrorSpec(
            position_cam_m=Normal3(normal=(30, 20, 3)), attitude=AttitudeErrorSpec(angle_deg=Normal(normal=1.5))
        ),
        PoseErrorSpec(
            position_cam_px=Normal3(normal=(9, 7, 1)),
            attitude=AttitudeErrorSpec(rotation_vector_deg=Normal3(normal=(1, 0.5, 0.1))),
        ),
        PoseErrorSpec(
            position_cam_px=Uniform3(uniform=((-40, 40), (-40, 40), (-4, 4))),
            attitude=AttitudeErrorSpec(rotation_vector_deg=Uniform3(uniform=((-1, 1), (0, 1), (-2, 2)))),
        ),
        PoseErrorSpec(
            position_cam_m=Correlated3(covariance=((900, 600, -30), (600, 800, 0), (-30, 0, 25))),
            attitude=AttitudeErrorSpec(angle_deg=Normal(normal=(1.0, 0.5), within=(0.0, 1.5))),
        ),
        PoseErrorSpec(position_cam_m=Normal3(normal=(30, 20, 3), mean=(5, -10, 2), student_t=9.0)),
        PoseErrorSpec(position_cam_m=Choice3(choice=((1, 2, 3), (-4, 5, 0), (0, 0, 30)))),
        PoseErrorSpec(
            position_cam_px=Mixture3(
                mixture=(
                    Component3(weight=3, law=Normal3(normal=(5, 4, 1))),
                    Component3(weight=1, law=Uniform3(uniform=((20, 40), (-40, 40), (0, 4)))),
                )
            )
        ),
    ],
)
def test_the_prior_covariance_is_the_second_moment_of_the_errors(paper, pose_error):
    camera, pose = paper.camera.camera(), look_at(np.array([300.0, -900.0, 1200.0]))
    turns, shifts = errors_of(priors_of(pose_error, [pose] * FEW, camera), [pose] * FEW)
    sample = np.hstack([turns, shifts])
    covariance = prior_covariance(pose_error, pose, camera)
    products = sample[:, :, None] * sample[:, None, :]
    # Standard error of a mean product from the sample itself; 5 sigma for 21 of them.
    error = products.std(axis=0) / np.sqrt(FEW)
    assert (np.abs(products.mean(axis=0) - covariance) < 5.0 * error + 1e-15).all()
    assert np.array_equal(covariance, covariance.T)
    assert not covariance[:3, 3:].any(), "shift and turn are independent"


JOINT = np.array([0.3, 0.2, 0.1, 30.0, 20.0, 5.0])[:, None] * (np.eye(6) + 0.5 * np.eye(6, k=3) + 0.5 * np.eye(6, k=-3))
JOINT = JOINT * np.array([0.3, 0.2, 0.1, 30.0, 20.0, 5.0])


@pytest.mark.parametrize("more", [{}, {"mean": (0.1, 0.0, 0.0, 0.0, 0.0, 9.0), "student_t": 12.0}])
def test_attitude_and_position_with_one_covariance(paper, more):
    camera, pose = paper.camera.camera(), look_at(np.array([300.0, -900.0, 1200.0]))
    spec = PoseErrorSpec(pose_cam_deg_m=Correlated6(covariance=JOINT.tolist(), **more))
    turns, shifts = errors_of(priors_of(spec, [pose] * FEW, camera), [pose] * FEW)
    sample = np.hstack([np.degrees(turns), shifts])
    mean = np.array(more.get("mean", np.zeros(6)))
    products = sample[:, :, None] * sample[:, None, :]
    expected = JOINT + np.outer(mean, mean)
    assert (np.abs(products.mean(axis=0) - expected) < 5.0 * products.std(axis=0) / np.sqrt(FEW)).all()
    units = np.repeat([np.radians(1.0), 1.0], 3)
    assert np.allclose(prior_covariance(spec, pose, camera), expected * np.outer(units, units), rtol=1e-12)


@pytest.mark.parametrize("attitude", [1e-5, 1e-2, 10.0])
def test_components_of_unlike_size_keep_their_digits(attitude):
    sigmas = np.array([attitude, attitude, attitude, 1e5, 1e4, 1e3])
    correlations = 0.5 * (np.ones((6, 6)) + np.eye(6))
    law = Correlated6(covariance=(correlations * np.outer(sigmas, sigmas)).tolist())
    rng = np.random.default_rng(5)
    draws = np.array([law.draw(rng) for _ in range(N)]) / sigmas
    found = draws.T @ draws / N
    # Standard error of a mean product of unit normals: sqrt((1 + r^2) / N).
    assert np.abs(found - correlations).max() < 5.0 * np.sqrt(2.0 / N)


def test_students_t_has_the_tails_of_scipys():
    law = Normal3(normal=(2.0, 1.0, 3.0), student_t=4.0)
    rng = np.random.default_rng(3)
    draws = np.array([law.draw(rng) for _ in range(N)])
    scale = np.array(law.normal) * np.sqrt(2.0 / 4.0)  # its covariance is 4 / (4 - 2) times the squared scale
    assert stats.kstest(draws[:, 2], stats.t(4.0, scale=scale[2]).cdf).pvalue > FALSE_ALARM
    # The components of one draw have the same tails: Hotelling's T^2 of known scale is 3 F(3, 4).
    squares = np.sum((draws / scale) ** 2, axis=1) / 3.0
    assert stats.kstest(squares, stats.f(3, 4).cdf).pvalue > FALSE_ALARM


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{normal: [1, 1, 1], student_t: 2}", "is not in \\(2, "),
        ("{mixture: [{weight: 1, law: {normal: [1, 1, 1]}}]}", "at least 2"),
        ("{mixture: [{weight: 0, law: {normal: [1, 1, 1]}}, {weight: 1, law: {normal: [1, 1, 1]}}]}", "is not above 0"),
        ("{choice: []}", "at least 1"),
        ("{covariance: [[1, 2, 0], [2, 1, 0], [0, 0, 1]]}", "not positive semidefinite"),
    ],
)
def test_laws_of_vectors_that_are_none_are_refused(text, said):
    with pytest.raises(BoresightError, match=said):
        load_scenario("quickstart", [f"pose_error.position_cam_m={text}"])


def test_a_joint_covariance_replaces_an_inherited_attitude_and_is_refused_next_to_one():
    joint, paper = f"pose_cam_deg_m: {{covariance: {JOINT.tolist()}}}", "attitude: {angle_deg: {uniform: [-2, 2]}}"
    law = load_scenario("quickstart", ["pose_error.attitude={angle_deg: 3}", f"pose_error={{{joint}}}"]).spec.pose_error
    assert law.pose_cam_deg_m is not None
    assert "attitude" not in law.model_dump(), "show prints what can be read again"
    assert PoseErrorSpec.model_validate(law.model_dump()) == law
    for attitude in ("attitude: {angle_deg: 3}", paper):
        with pytest.raises(BoresightError, match="give either pose_cam_deg_m or attitude, not both"):
            load_scenario("quickstart", [f"pose_error={{{joint}, {attitude}}}"])


@pytest.mark.parametrize(
    ("key", "matrix", "said"),
    [
        ("pose_cam_deg_m", np.eye(3), "6 x 6 expected, not 3 x 3"),
        ("pose_cam_deg_m", np.eye(7), "6 x 6 expected, not 7 x 7"),
        ("position_cam_m", np.eye(6), "3 x 3 expected, not 6 x 6"),
        ("position_cam_m", np.eye(3)[:, :2], "3 x 3 expected, not 3 x 2"),
        ("position_cam_m", np.ones(3), "3 x 3 expected"),
    ],
)
def test_a_covariance_of_another_size_is_one_line(key, matrix, said):
    with pytest.raises(BoresightError) as caught:
        load_scenario("quickstart", [f"pose_error={{{key}: {{covariance: {matrix.tolist()}}}}}"])
    assert str(caught.value).endswith(f": pose_error.{key}.covariance: {said}")
    assert "\n" not in str(caught.value)


PAPER_PLACE = "position_cam_px: {uniform: [[-40, 40], [-40, 40], [-4, 4]]}"


@pytest.fixture
def joint_file(tmp_path):
    file = tmp_path / "joint.yaml"
    file.write_text(f"extends: quickstart\npose_error: {{pose_cam_deg_m: {{covariance: {JOINT.tolist()}}}}}\n")
    return file


@pytest.mark.parametrize(
    ("given", "missing"),
    [
        ("attitude: {angle_deg: 1}", "position_cam_m, position_cam_px, position_body_m or position_rtn_m"),
        ("position_cam_m: {normal: [1, 1, 1]}", "attitude"),
    ],
)
@pytest.mark.parametrize("section", ["pose_error", "onboard.pose_error"])
def test_half_of_a_joint_covariance_is_never_replaced_alone(joint_file, section, given, missing):
    key = given.partition(":")[0]
    said = f"{section}.{key} replaces pose_cam_deg_m: give {missing} too, or change pose_cam_deg_m instead"
    joint = f"{section}.pose_cam_deg_m.covariance={JOINT.tolist()}"
    with pytest.raises(BoresightError) as caught:
        load_scenario(str(joint_file), [joint, f"{section}={{{given}}}"])
    assert str(caught.value) == f"--set {section}={{{given}}}: {said}"


@pytest.mark.parametrize("layer", ["base", "levels"])
def test_half_of_a_joint_covariance_is_not_replaced_by_a_campaign(joint_file, layer):
    given = {"pose_error.attitude.angle_deg": 1}
    with pytest.raises(BoresightError, match=r"pose_error\.attitude replaces pose_cam_deg_m: give position_cam_m, "):
        load_scenario(str(joint_file), **{layer: given if layer == "base" else [given]})


def test_half_of_a_joint_covariance_is_not_replaced_by_a_file_that_extends(joint_file):
    child = joint_file.with_name("child.yaml")
    child.write_text("extends: joint.yaml\npose_error:\n  attitude: {angle_deg: 1}\n")
    with pytest.raises(BoresightError, match=r"child.yaml:3: pose_error.attitude replaces pose_cam_deg_m: give pos"):
        load_scenario(str(child))


@pytest.mark.parametrize("order", [1, -1])
def test_both_halves_replace_a_joint_covariance_in_any_order(joint_file, order):
    halves = ["pose_error.attitude.angle_deg={uniform: [-2, 2]}", f"pose_error={{{PAPER_PLACE}}}"]
    assert load_scenario(str(joint_file), halves[::order]).spec.pose_error == PAPER_POSE_ERROR
    defaults = ["pose_error=null", "pose_error.attitude.angle_deg={uniform: [-2, 2]}"]
    assert load_scenario(str(joint_file), defaults).spec.pose_error == PAPER_POSE_ERROR


def test_an_error_in_body_axes_is_that_of_the_camera_whatever_the_attitude_is(paper):
    """Position and attitude by themselves, and by the covariance in camera axes: NEES of six degrees of freedom."""
    camera, pose = paper.camera.camera(), look_at(np.array([300.0, -900.0, 1200.0]), 0.7)
    place = np.array([[900.0, 600.0, -30.0], [600.0, 800.0, 0.0], [-30.0, 0.0, 25.0]])
    spec = PoseErrorSpec(
        position_body_m=Correlated3(covariance=place.tolist()),
        attitude=AttitudeErrorSpec(rotation_vector_deg=Normal3(normal=(0.02, 0.01, 0.05))),
    )
    priors = [degrade(pose, spec, camera, generator(3, Stream.POSE_ERROR, t)) for t in range(FEW)]
    errors = np.array([prior.camera_position_m - pose.camera_position_m for prior in priors])
    products = errors[:, :, None] * errors[:, None, :]
    assert (np.abs(products.mean(axis=0) - place) < 5.0 * products.std(axis=0) / np.sqrt(FEW) + 1e-15).all()
    turns, shifts = errors_of(priors, [pose] * FEW)
    assert np.abs(np.corrcoef(turns.T, errors.T)[:3, 3:]).max() < 5.0 / np.sqrt(FEW)
    off = np.hstack([turns, shifts])
    weights = np.array([np.linalg.inv(prior_covariance(spec, prior, camera)) for prior in priors])
    nees = np.einsum("ti,tij,tj->t", off, weights, off)
    assert nees.mean() == pytest.approx(6.0, abs=5.0 * np.sqrt(12.0 / FEW))
    assert stats.kstest(nees, stats.chi2(6).cdf).pvalue > 1e-3


LAWS = {
    Normal(normal=2.0): stats.norm(0.0, 2.0),
    Normal(normal=(5.0, 2.0)): stats.norm(5.0, 2.0),
    Normal(normal=(5.0, 2.0), within=(4.0, 9.0)): stats.truncnorm(-0.5, 2.0, 5.0, 2.0),
    Normal(normal=(0.0, 1.0), within=(3.0, 4.0)): stats.truncnorm(3.0, 4.0),
    Uniform(uniform=(-1.0, 3.0)): stats.uniform(-1.0, 4.0),
    LogUniform(log_uniform=(10.0, 1000.0)): stats.loguniform(10.0, 1000.0),
    LogNormal(log_normal=(100.0, 0.5)): stats.lognorm(0.5, scale=100.0),
}


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.text("m"))
def test_a_law_is_that_of_scipy(law):
    theirs, rng = LAWS[law], np.random.default_rng(8)
    assert stats.kstest([law.draw(rng) for _ in range(4000)], theirs.cdf).pvalue > 1e-3
    assert law.median == pytest.approx(theirs.median(), abs=1e-9, rel=1e-9)
    shares = (1e-9, 0.1, 0.7, 1.0 - 1e-6)
    assert [law.quantile(share) for share in shares] == pytest.approx(theirs.ppf(shares), abs=1e-9, rel=1e-9)
    assert law.second_moment == pytest.approx(theirs.expect(lambda x: x * x), rel=1e-6)
    if law.support != (0.0, np.inf):
        assert law.support == pytest.approx(theirs.support())


def test_a_truncated_log_normal_law_is_the_part_of_the_whole():
    law, whole = LogNormal(log_normal=(100.0, 0.5), within=(80.0, 300.0)), stats.lognorm(0.5, scale=100.0)
    share = whole.cdf(300.0) - whole.cdf(80.0)
    rng = np.random.default_rng(9)
    drawn = [law.draw(rng) for _ in range(4000)]
    assert stats.kstest(drawn, lambda x: np.clip((whole.cdf(x) - whole.cdf(80.0)) / share, 0.0, 1.0)).pvalue > 1e-3
    assert law.second_moment == pytest.approx(whole.expect(lambda x: x * x, lb=80.0, ub=300.0) / share, rel=1e-9)
    assert whole.cdf(law.median) == pytest.approx(whole.cdf(80.0) + 0.5 * share)


@pytest.mark.parametrize(
    "law",
    [
        LogNormal(log_normal=(10.0, 5.0), within=(1.0, 1000.0)),
        LogNormal(log_normal=(1.0, 10.0), within=(0.5, 2.0)),
        LogNormal(log_normal=(1.0, 0.5), within=(8.0, 20.0)),
        Normal(normal=1.0, within=(-1e-8, 1e-8)),
        Normal(normal=(5.0, 1.0), within=(-1e-3, 1e-3)),
        Normal(normal=1.0, within=(5.5, 1e15)),
    ],
)
def test_moments_hold_in_tails_and_between_narrow_bounds(law):
    """Against the sum over a fine grid of the logarithm of the density, which cannot cancel."""
    (low, high), (mean, sigma) = law.support, law._normal
    z = np.linspace(law._limits[0], min(law._limits[1], max(law._limits[0], 0.0) + 20.0), 400_001)
    values = np.exp(mean + sigma * z) if isinstance(law, LogNormal) else mean + sigma * z
    weights = np.exp(-0.5 * z * z + 0.5 * np.min(z * z))
    assert law.second_moment == pytest.approx(np.sum(weights * values**2) / np.sum(weights), rel=1e-4)
    drawn = [law.draw(generator(4, Stream.TRUTH, trial)) for trial in range(200)]
    assert low <= min(drawn) <= max(drawn) <= high


def test_a_drawn_range_leaves_aims_at_the_ground_alone():
    spec = load_scenario("quickstart").spec
    mesh, lighting = load_body(spec.body.model_copy(update={"detail": None}), ()).mesh, spec.lighting
    fixed = ViewpointSpec(range_m=2000.0, targets=("nadir", "limb"))
    drawn = ViewpointSpec(range_m=Uniform(uniform=(1999.999, 2000.001)), targets=("nadir", "limb"))
    for trial in range(5):
        one, other = (
            draw_aimed_view(viewpoint, lighting, spec.camera.camera(), mesh, generator(1, Stream.TRUTH, trial))
            for viewpoint in (fixed, drawn)
        )
        np.testing.assert_allclose(one.T_cam_body.rotation, other.T_cam_body.rotation, atol=1e-5)


def test_a_choice_draws_each_of_its_values_as_often_as_it_stands_there():
    law, rng = Choice(choice=(1.0, 2.0, 2.0, 5.0)), np.random.default_rng(10)
    values, counts = np.unique([law.draw(rng) for _ in range(4000)], return_counts=True)
    assert values.tolist() == [1.0, 2.0, 5.0]
    assert stats.chisquare(counts, [1000, 2000, 1000]).pvalue > 1e-3
    assert (law.median, law.second_moment, law.support) == (2.0, 8.5, (1.0, 5.0))
    assert [law.quantile(share) for share in (0.0, 0.24, 0.26, 0.74, 0.76, 1.0)] == [1.0, 1.0, 2.0, 2.0, 5.0, 5.0]


def test_a_law_without_spread_is_its_middle():
    for law in (Normal(normal=(5.0, 0.0)), Normal(normal=(5.0, 0.0), within=(4.0, 6.0)), Uniform(uniform=(5.0, 5.0)),
                LogNormal(log_normal=(5.0, 0.0), within=(1.0, 9.0)), LogUniform(log_uniform=(5.0, 5.0))):  # fmt: skip
        assert law.draw(np.random.default_rng(0)) == pytest.approx(5.0), law
        assert law.support == pytest.approx((5.0, 5.0)), law
        assert law.second_moment == pytest.approx(25.0), law


def test_a_drawn_range_changes_nothing_else_of_a_view():
    lighting = LightingSpec(phase_deg=Uniform(uniform=(20.0, 60.0)))
    drawn = ViewpointSpec(range_m=LogUniform(log_uniform=(1000.0, 4000.0)))
    camera = load_scenario("quickstart").spec.camera.camera()
    ranges = []
    for trial in range(200):
        one, other = (
            draw_lit_view(viewpoint, lighting, camera, generator(1, Stream.TRUTH, trial))
            for viewpoint in (ViewpointSpec(range_m=2000.0), drawn)
        )
        ranges.append(float(np.linalg.norm(other.T_cam_body.translation_m)))
        np.testing.assert_allclose(one.T_cam_body.rotation, other.T_cam_body.rotation, atol=1e-14)
        np.testing.assert_allclose(one.sun_dir_body, other.sun_dir_body, atol=1e-14)
    assert stats.kstest(ranges, stats.loguniform(1000.0, 4000.0).cdf).pvalue > 1e-3
    assert (*drawn.range_bounds_m, drawn.median_range_m) == pytest.approx((1000.0, 4000.0, 2000.0))


@pytest.mark.parametrize("law", [Normal(normal=(45.0, 10.0), within=(10.0, 80.0)), Choice(choice=(30.0, 90.0))])
def test_a_phase_that_is_not_uniform_follows_its_law(law):
    camera = load_scenario("quickstart").spec.camera.camera()
    viewpoint, lighting = ViewpointSpec(range_m=2000.0), LightingSpec(phase_deg=law)
    views = [draw_lit_view(viewpoint, lighting, camera, generator(1, Stream.TRUTH, t)) for t in range(500)]
    phases = np.degrees([view.phase_angle_rad for view in views])
    if isinstance(law, Choice):
        assert set(np.round(phases, 6)) == {30.0, 90.0}
    else:
        assert stats.kstest(phases, stats.truncnorm(-3.5, 3.5, 45.0, 10.0).cdf).pvalue > 1e-3


def test_off_pointing_turns_the_camera_in_its_place_and_nothing_else():
    camera = load_scenario("quickstart").spec.camera.camera()
    lighting = LightingSpec()
    angles, azimuths = [], []
    for trial in range(1000):
        there, off = (
            draw_lit_view(viewpoint, lighting, camera, generator(4, Stream.TRUTH, trial))
            for viewpoint in (
                ViewpointSpec(range_m=2000.0),
                ViewpointSpec(range_m=2000.0, off_pointing_deg=Uniform(uniform=(1.0, 3.0))),
            )
        )
        assert np.allclose(off.T_cam_body.camera_position_m, there.T_cam_body.camera_position_m, atol=1e-9)
        assert np.allclose(off.sun_dir_body, there.sun_dir_body, atol=1e-15)
        x, y, z = off.T_cam_body.translation_m
        angles.append(np.degrees(np.arctan2(np.hypot(x, y), z)))
        azimuths.append(np.arctan2(y, x))
    assert_follows(angles, uniform(1.0, 3.0))
    assert_follows(azimuths, uniform(-np.pi, np.pi))


def test_errors_in_pixels_move_the_body_by_pixels():
    spec = load_scenario("navcam67p-real").spec
    camera = spec.camera.camera()
    pose = look_at(np.array([0.0, -1.0e5, 0.0]))
    fixed = PoseErrorSpec(
        position_cam_px=Uniform3(uniform=((40, 40), (-7, -7), (0, 0))),
        attitude=AttitudeErrorSpec(angle_deg=Normal(normal=0)),
    )
    prior = degrade(pose, fixed, camera, np.random.default_rng(0))
    moved = camera.project(prior.translation_m) - camera.project(pose.translation_m)
    assert moved == pytest.approx([40, -7], abs=1e-9)


def test_an_attitude_error_turns_the_body_about_its_origin():
    pose = look_at(np.array([0.0, -1000.0, 0.0]))
    spec = PoseErrorSpec(
        position_cam_m=Normal3(normal=(0, 0, 0)),
        attitude=AttitudeErrorSpec(rotation_vector_deg=Uniform3(uniform=((0, 0), (3, 3), (0, 0)))),
    )
    prior = degrade(pose, spec, load_scenario("quickstart").spec.camera.camera(), np.random.default_rng(0))
    assert np.array_equal(prior.translation_m, pose.translation_m)
    turned = Rotation.from_euler("y", 3, degrees=True).as_matrix() @ pose.rotation
    assert np.allclose(prior.rotation, turned, atol=1e-12)

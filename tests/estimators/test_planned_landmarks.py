"""Covariances predicted from the landmarks of a planned view, against scipy's fits of landmarks that are drawn."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from boresight.estimators.altimeter import AltimeterEstimator, AltimeterOptions, boresight_range
from boresight.estimators.landmark.database import LandmarkDatabase
from boresight.estimators.landmark.planned import planned_problem, recognised_shares
from boresight.estimators.landmark.recognizer import LandmarkOptions, LandmarkRecognizer, translation_aligner
from boresight.estimators.landmark.robust.estimator import ConsensusOptions, ConsensusRecognizer
from boresight.estimators.landmark.robust.search import retained_information
from boresight.scenarios.bodies.embedded import icosphere
from boresight.scenarios.geometry import Camera, look_at
from boresight.scenarios.observation import CameraSigma, Frame, Observation, RangeReading
from boresight.scenarios.sequences.ground import MeshGround

CAMERA = Camera(400, 400, 2000.0, 2000.0, 200.0, 200.0)
POSE = look_at(np.array([300.0, -1950.0, 400.0]), 0.4)
PRIOR = np.diag([1e-3, 2e-3, 1e-3, 0.5, 0.4, 3.0]) ** 2
PLANNED = Observation(CAMERA, Frame(np.zeros((0, 0), np.float32), np.array([0.0, 0.0, -1.0]), POSE, PRIOR))


def database(seen=1.0, images=None):
    """Return a sphere of 100 m with landmarks that are off by 0.1 to 0.4 m along turned axes."""
    mesh, rng = icosphere(2, 100.0), np.random.default_rng(4)
    axes = Rotation.random(len(mesh.vertices_m), random_state=5).as_matrix()
    variances = rng.uniform(0.1, 0.4, (len(axes), 3)) ** 2
    covariances = np.einsum("nij,nj,nkj->nik", axes, variances, axes)
    counts = np.full(len(axes), round(seen * (images or 2) / 2.0))
    told = {} if images is None else {"images": images}
    return LandmarkDatabase(mesh.vertices_m, 0.5 * (covariances + covariances.swapaxes(1, 2)), counts, mesh.faces, told)


def harris(found, **options):
    parsed = LandmarkOptions(**options)
    return LandmarkRecognizer(found, None, parsed, translation_aligner(parsed))


def ransac(found, detection_probability=1.0 - 1e-12, **more):
    """Return the method; a landmark that is sure to be detected loses nothing among clutter."""
    mixture = {"covariance_scale": 1.0, "corner_sigma_px": 1e-6, "detection_probability": detection_probability}
    options = ConsensusOptions(mixture=mixture, **more)
    return ConsensusRecognizer(found, None, options)


@pytest.mark.parametrize("with_prior", [False, True], ids=["landmarks", "with prior"])
def test_errors_of_scipys_fits_of_drawn_landmarks_are_as_predicted(with_prior):
    """Landmarks are drawn in space by their covariances: whitened errors of 60 fits have a chi-square distribution."""
    found, rng, total = database(), np.random.default_rng(6), 0.0
    covariance = (ransac(found) if with_prior else harris(found)).predict(PLANNED)
    problem = planned_problem(found, PLANNED)
    rows = np.flatnonzero((found.means_m[:, None] == problem.points_body_m).all(axis=2).any(axis=1))
    # The camera is above the plane of the sphere at a landmark that it sees; one beyond may have a facet that it sees.
    height = (found.means_m @ POSE.camera_position_m - 100.0**2) / (100.0 * np.linalg.norm(POSE.camera_position_m))
    assert set(np.flatnonzero(height > 0.0)) <= set(rows) <= set(np.flatnonzero(height > -np.sin(np.radians(20.0))))
    means = found.means_m[rows]
    spread = np.linalg.cholesky(found.covariances_m2[rows])

    def pixels(x, points):
        turned = (Rotation.from_rotvec(x[:3]).as_matrix() @ POSE.rotation @ points.T).T + POSE.translation_m + x[3:]
        return 2000.0 * turned[:, :2] / turned[:, 2:] + 200.0

    # Weights by the spread of many drawn pixels: no derivative of a projection is used.
    many = np.stack(
        [
            pixels(np.zeros(6), means + np.einsum("nij,nj->ni", spread, rng.normal(size=means.shape)))
            for _ in range(2000)
        ]
    )
    roots = np.linalg.cholesky(np.linalg.inv([np.cov(many[:, i].T) for i in range(len(means))]))
    sigmas = np.sqrt(np.diag(PRIOR))
    for _ in range(60):
        uv_px = pixels(np.zeros(6), means + np.einsum("nij,nj->ni", spread, rng.normal(size=means.shape)))
        prior = sigmas * rng.normal(size=6)

        def residuals(x, uv_px=uv_px, prior=prior):
            white = np.einsum("nji,nj->ni", roots, uv_px - pixels(x, means)).ravel()
            return np.r_[white, (x - prior) / sigmas] if with_prior else white

        error = least_squares(residuals, np.zeros(6), x_scale=np.sqrt(np.diag(covariance))).x
        total += error @ np.linalg.solve(covariance, error)
    assert chi2.ppf(0.001, 360) < total < chi2.ppf(0.999, 360)


def test_a_share_of_the_images_counts_for_each_landmark():
    """A point of a convex body is visible in half of 200 images: seen in 25, its corner is in a quarter of these."""
    rare = database(seen=0.25, images=200)
    np.testing.assert_allclose(recognised_shares(rare), 0.25)
    np.testing.assert_allclose(recognised_shares(database(seen=1.5, images=200)), 1.0)
    np.testing.assert_allclose(harris(rare).predict(PLANNED), 4.0 * harris(database()).predict(PLANNED))
    visible = len(planned_problem(database(), PLANNED).uv_px)
    few = database(seen=3.9 / visible, images=2000)
    assert harris(few).predict(PLANNED) is None and ransac(few).predict(PLANNED) is None


def test_clutter_leaves_less_of_the_information():
    """All landmarks have the same share left if their covariances are the same; a wide prior adds next to nothing."""
    found = database()
    found = replace(found, covariances_m2=np.repeat(0.3**2 * np.eye(3)[None], len(found), axis=0))
    wide = replace(PLANNED, frame=replace(PLANNED.frame, prior_covariance=1e8 * PRIOR))
    sure, robust = ransac(found).predict(wide), ransac(found, 0.02).predict(wide)
    shares = np.linalg.eigvals(np.linalg.solve(robust, sure)).real
    # 250 corners on the disc of a sphere that is 0.1 of its 2,000 m: 0.008 in a square pixel, sigma 0.3 px.
    odds = 0.02 / 0.98 * np.pi * 100.0**2 / 250 / (2.0 * np.pi * 0.3**2)
    np.testing.assert_allclose(shares, retained_information(np.array(odds)), rtol=0.1)


def test_the_alignment_adds_a_place_across_the_line_of_sight():
    """A place that is known to a thousandth of a pixel is known to that many metres, whatever the landmarks are."""
    close = ransac(database(), alignment_sigma_px=0.001).predict(PLANNED)
    depth_m = np.linalg.norm(POSE.translation_m)
    np.testing.assert_allclose(np.sqrt(np.diag(close)[3:5]), 0.001 / 2000.0 * depth_m, rtol=1e-3)


def test_the_calibration_enters():
    """Whole without a prior, and with one by the share of the image, I - P P_0^-1."""
    found, off = database(), replace(PLANNED, camera_sigma=CameraSigma(focal=1e-3))
    whole = np.diag([0, 0, 0, 0, 0, (1e-3 * POSE.translation_m[2]) ** 2])
    share = np.eye(6) - ransac(found).predict(PLANNED) @ np.linalg.inv(PRIOR)
    for method, expected in ((harris(found), whole), (ransac(found), share @ whole @ share.T)):
        added = method.predict(off) - method.predict(PLANNED)
        np.testing.assert_allclose(added, expected, atol=1e-12)
    assert harris(found, pose={"method": "closed-form"}).predict(PLANNED) is None


def test_a_range_adds_its_information():
    found = database()
    base, ground = harris(found), MeshGround(found.mesh())
    method = AltimeterEstimator(base, found, AltimeterOptions(height_sigma_m=0.3))
    before = base.predict(PLANNED)
    np.testing.assert_array_equal(method.predict(PLANNED), before)  # no reading
    met = boresight_range(ground, POSE)
    variance = 0.2**2 + (0.3 / met.cos_incidence) ** 2
    # The reading is off, as a surface is beside its mesh: what is measured decides nothing.
    planned = replace(PLANNED, frame=replace(PLANNED.frame, altimeter=RangeReading(met.range_m + 5.0, 0.2)))
    after = method.predict(planned)
    along = [met.gradient @ one @ met.gradient for one in (before, after)]
    assert 1.0 / along[1] == pytest.approx(1.0 / along[0] + 1.0 / variance)
    other = AltimeterEstimator(object(), found, AltimeterOptions())
    assert other.predict(planned) is None

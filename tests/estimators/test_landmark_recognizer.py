"""The whole recogniser on images of a body with relief, and the interface of the estimators."""

import numpy as np
import pytest
from boulder_worlds import BoulderWorld, boulder_mesh, errors

from boresight.estimators.contract import Estimate
from boresight.estimators.dense.photometric import WholeImageRecognizer
from boresight.estimators.landmark.database import (
    DatabaseOptions,
    LandmarkDatabase,
    database_from_candidates,
    extract_candidates,
)
from boresight.estimators.landmark.recognizer import PRODUCT, LandmarkOptions, LandmarkRecognizer, translation_aligner
from boresight.estimators.landmark.robust.search import MixtureEvaluation
from boresight.estimators.landmark.signal import extract_signal
from boresight.estimators.registry import estimator_class
from boresight.renderers.mitsuba3 import MitsubaRenderer
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, View
from boresight.scenarios.observation import Frame, Observation

CAMERA = Camera.from_fov(512, 512, np.radians(18.3))
DATABASE = {
    "images": 60,
    "min_observations": 6,
    "clusters": {"seed_radius_m": 4.0},
    "corners": {"count": 100},
}
TRIALS = 12
MANY = 20  # of eight trials the medians of some seeds are no better than the prior's


class World(BoulderWorld):
    """Lends a data base of images of the body itself."""

    def __init__(self):
        super().__init__(CAMERA, boulder_mesh(90_000), [0.02] * 3 + [29.0] * 3)
        self._recognised, self._recognizer = {}, None
        options = LandmarkOptions(database=DATABASE).database
        images = list(self.images(options.images))
        candidates = [
            extract_candidates(image, lambda uv, view=view: self.renderer.surface(view, uv).points_body_m, options)
            for view, image in images
        ]
        cameras_m = np.array([view.T_cam_body.camera_position_m for view, _ in images])
        self.database = database_from_candidates(candidates, cameras_m, options)

    def recognised(self, trial, noise_dn=0.0):
        """Return a view, its frame and the estimate of the recogniser with its default options, made once."""
        self._recognizer = self._recognizer or recogniser(self)
        if (trial, noise_dn) not in self._recognised:
            view, frame = self.frame(trial, noise_dn)
            self._recognised[trial, noise_dn] = view, frame, estimate(self._recognizer, frame)
        return self._recognised[trial, noise_dn]


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("BORESIGHT_CACHE", str(tmp_path_factory.mktemp("cache")))
        return World()


def recogniser(world, **options):
    return LandmarkRecognizer.from_options({"database": DATABASE, **options}, world)


def estimate(estimator, frame):
    return estimator.estimate(Observation(CAMERA, frame), rng=np.random.default_rng(0))


def test_the_mesh_of_the_landmarks_fits_the_body(world):
    assert len(world.database) > 60
    assert abs(world.database.mesh().volume_m3 / world.mesh.volume_m3 - 1.0) < 0.08


@pytest.mark.parametrize(
    "noise_dn", [pytest.param(0.0, id="clean"), pytest.param(15.0, id="noisy", marks=pytest.mark.long)]
)
def test_recognition_improves_on_the_prior(world, noise_dn):
    before, after, landmark_errors = [], [], []
    for trial in range(MANY):
        view, frame, result = world.recognised(trial, noise_dn)
        assert result.status == "ok", result.reason
        before.append(errors(view, frame.prior_T_cam_body))
        after.append(errors(view, result.pose))
        table = result.details["landmarks"]
        hits = world.renderer.surface(view, np.column_stack([table["u_px"], table["v_px"]])).points_body_m
        means = np.column_stack([table["x_m"], table["y_m"], table["z_m"]])
        landmark_errors.append(np.linalg.norm(hits - means, axis=1))
    attitude, position = np.median(before, axis=0)
    assert np.median(after, axis=0)[1] < 0.75 * position
    assert np.median(after, axis=0)[0] < 0.95 * attitude
    # Three pixels of this camera are 3.4 m on the body.
    assert np.nanmedian(np.concatenate(landmark_errors)) < 3.4


def test_a_recognition_counts_only_where_it_is_the_better_likeness_if_asked(world):
    """Otherwise the aligned pose is the answer, which uses no landmark and has no covariance."""
    careful, answers, offsets = recogniser(world, keep="if-better"), {0: 0, 1: 0}, []
    shape = MitsubaRenderer(world.shape(), world.brdf, 1)
    for trial in range(MANY - TRIALS, MANY):
        view, frame = world.frame(trial)
        result = estimate(careful, frame)
        kept = result.diagnostics["kept"]
        poses = {stage.name: stage.T_cam_body for stage in result.stages}
        looks = [_likeness(shape, frame, poses[name]) for name in ("centroid", "recognition")]
        np.testing.assert_allclose([result.diagnostics[n] for n in ("likeness_before", "likeness")], looks, atol=1e-6)
        assert kept == int(looks[1] >= looks[0])
        assert list(poses) == ["centroid", "recognition", "choice"]
        assert result.pose is poses["choice"] is poses["recognition" if kept else "centroid"]
        assert (result.covariance is not None, "landmarks" in result.details) == (kept, kept)
        assert bool(result.diagnostics["n_landmarks"]) == bool(kept)
        answers[kept] += 1
        offsets.append([errors(view, pose)[1] for pose in (result.pose, poses["recognition"])])
    assert min(answers.values()) > 0
    chosen, recognised = np.sqrt(np.mean(np.square(offsets), axis=0))
    assert chosen < recognised


def _likeness(shape, frame, pose):
    """numpy's own coefficient of the image and the onboard shape at a pose."""
    rendered = shape.render(View(CAMERA, pose, pose.rotation.T @ frame.sun_dir_cam))
    signals = (extract_signal(frame.image), extract_signal(rendered, (0.0, 0.0)))
    return np.corrcoef(*(signal.image.ravel().astype(np.float64) for signal in signals))[0, 1]


def test_the_whole_image_turns_the_mesh_before_landmarks_are_looked_for(world):
    """The alignment of centroids leaves the prior's attitude unchanged; that of the whole image corrects it."""
    by_image = WholeImageRecognizer.from_options({"database": DATABASE}, world)
    starts, gains = [], []
    for trial in range(TRIALS):
        view, frame, by_centroid = world.recognised(trial)
        results = [by_centroid, estimate(by_image, frame)]
        assert [result.status for result in results] == ["ok", "ok"]
        assert [stage.name for stage in results[1].stages] == ["registration", "recognition"]
        starts.append([errors(view, result.stages[0].T_cam_body)[0] for result in results])
        gains.append(errors(view, results[1].pose)[1] / errors(view, frame.prior_T_cam_body)[1])
    before, after = np.sqrt(np.mean(np.square(starts), axis=0))
    assert after < 0.95 * before
    assert np.median(gains) < 0.9


def test_an_estimate_holds_what_the_contract_says(world):
    _, _, result = world.recognised(1)
    assert result.status == "ok"
    assert [stage.name for stage in result.stages] == ["centroid", "recognition"]
    assert result.stages[-1].T_cam_body is result.pose
    assert set(result.timings_s) == {"mesh_rendering", "centroid", "feature_extraction", "recognition", "consistency"}
    assert all(seconds > 0.0 for seconds in result.timings_s.values())
    expected = {"n_landmarks", "n_predicted", "n_corners", "outlier_rounds", "centroid_iterations", "chi2", "stable"}
    expected |= {"centroid_residual_px"}
    assert set(result.diagnostics) == expected
    table = result.details["landmarks"]
    n = result.diagnostics["n_landmarks"]
    assert {len(column) for column in table.values()} == {n}
    assert 4 <= n <= result.diagnostics["n_predicted"] <= len(world.database)
    np.testing.assert_array_equal(table["x_m"], world.database.means_m[table["landmark"], 0])
    np.testing.assert_array_equal(table["syz_m2"], world.database.covariances_m2[table["landmark"], 1, 2])
    assert np.sum(table["d2_px"]) == pytest.approx(result.diagnostics["chi2"], rel=0.2)
    assert (np.linalg.eigvalsh(result.covariance) > 0.0).all()
    rotation = np.sqrt(np.diag(result.covariance)[:3])
    assert (np.degrees(rotation) < 5.0).all()


def test_the_stages_can_be_looked_at(world):
    _, frame = world.frame(2)
    record = recogniser(world).recognise(frame, CAMERA)
    assert record.failure == ""
    assert record.alignment.steps[0].T_cam_body is frame.prior_T_cam_body
    assert record.alignment.steps[0].rendered.shape == frame.image.shape
    first, last = record.solution.rounds[0], record.solution.rounds[-1]
    assert first.projection.uv_px.shape == (len(world.database), 2)
    assert first.visible[first.matches.landmark].all()
    assert last.matches.corner.max() < len(record.corners)


def test_the_centroid_brings_the_body_into_place(world):
    prior, moved = [], []
    for trial in range(TRIALS):
        view, frame, result = world.recognised(trial)
        truth = CAMERA.project(view.T_cam_body.translation_m)
        prior.append(np.linalg.norm(CAMERA.project(frame.prior_T_cam_body.translation_m) - truth))
        moved.append(np.linalg.norm(CAMERA.project(result.stages[0].T_cam_body.translation_m) - truth))
    assert np.median(prior) > 10.0
    assert np.median(moved) < 3.0


@pytest.mark.parametrize("alignment", ["image", "none"])
def test_the_alignment_is_an_option(world, alignment):
    _, frame, default = world.recognised(2)
    other = recogniser(world, alignment=alignment).recognise(frame, CAMERA)
    if alignment == "none":
        assert other.alignment.steps == ()
        assert other.alignment.T_cam_body is frame.prior_T_cam_body
    else:
        shift = other.alignment.T_cam_body.translation_m - default.stages[0].T_cam_body.translation_m
        assert 0.0 < np.linalg.norm(shift) < 20.0


def test_corners_of_the_image_may_differ_from_those_of_the_data_base(world):
    _, frame, default = world.recognised(2)
    assert default.diagnostics["n_corners"] == 100
    assert estimate(recogniser(world, corners={"count": 20}), frame).diagnostics["n_corners"] == 20


def spoilt(frame, image):
    return Frame(image.astype(np.float32), frame.sun_dir_cam, frame.prior_T_cam_body, frame.prior_covariance)


def test_hard_images_fail_with_a_reason(world):
    _, frame = world.frame(1)
    nan = frame.image.copy()
    nan[100, 100] = np.nan
    noise = np.random.default_rng(0).normal(50.0, 3.0, frame.image.shape)
    smooth = np.zeros_like(frame.image)
    smooth[118:138, 118:138] = 1.0
    estimator = recogniser(world)
    for image, reason in (
        (np.zeros_like(frame.image), "black"),
        (np.full_like(frame.image, 9.0), "black"),
        (noise, "black"),
        (nan, "NaN"),
        (smooth, "landmarks recognised, 4 needed"),
    ):
        result = estimate(estimator, spoilt(frame, image))
        assert result.status == "failed"
        assert reason in result.reason
        assert result.pose is result.covariance is None
        assert result.details == {}
    with pytest.raises(BoresightError, match=r"\(511, 512\)"):
        estimate(estimator, spoilt(frame, frame.image[1:]))


def test_a_prior_that_looks_past_the_body_fails_with_a_reason(world):
    _, frame = world.frame(1)
    away = frame.prior_T_cam_body.perturbed(np.zeros(3), np.array([3000.0, 0.0, 0.0]))
    lost = Frame(frame.image, frame.sun_dir_cam, away, frame.prior_covariance)
    assert "out of view" in estimate(recogniser(world), lost).reason
    assert estimate(recogniser(world, alignment="none"), lost).status == "failed"


def same(first: Estimate, second: Estimate) -> bool:
    a, b = first.pose, second.pose
    poses = np.array_equal(a.rotation, b.rotation) and np.array_equal(a.translation_m, b.translation_m)
    return poses and dict(first.diagnostics) == dict(second.diagnostics) and first.status == second.status


def test_the_prior_is_returned_as_it_is(world):
    _, frame = world.frame(3)
    result = estimate(estimator_class("prior").from_options({}, world), frame)
    assert result.pose is frame.prior_T_cam_body
    assert result.covariance is frame.prior_covariance


def test_the_data_base_is_asked_for_by_its_options(world):
    world.asked.clear()
    recogniser(world)
    (kind, options), *_ = world.asked
    assert kind == PRODUCT
    assert DatabaseOptions.model_validate(options) == LandmarkOptions(database=DATABASE).database


def test_a_product_of_another_kind_is_refused(world):
    class Wrong:
        camera = CAMERA

        def product(self, kind, options):
            return {"kind": kind, **options}

        def mesh_renderer(self, mesh):
            raise NotImplementedError

    with pytest.raises(BoresightError, match="is a dict"):
        LandmarkRecognizer.from_options({}, Wrong())


def test_wrong_options_name_estimator_key_and_value(world):
    with pytest.raises(
        BoresightError, match=r"estimator landmark-harris: database\.corners\.k: 7 is not in \(0, 0\.25\)"
    ):
        LandmarkRecognizer.from_options({"database": {"corners": {"k": 7}}}, world)
    with pytest.raises(BoresightError, match="alignment"):
        LandmarkRecognizer.from_options({"alignment": "sideways"}, world)


def test_a_saved_data_base_recognises_the_same(world, tmp_path):
    world.database.save(tmp_path)
    again = LandmarkDatabase.load(tmp_path)
    _, frame = world.frame(1)
    options = LandmarkOptions(database=DATABASE)
    aligner = translation_aligner(options)
    first = LandmarkRecognizer(world.database, world.mesh_renderer(world.database.mesh()), options, aligner)
    second = LandmarkRecognizer(again, world.mesh_renderer(again.mesh()), options, aligner)
    assert same(estimate(first, frame), estimate(second, frame))


@pytest.mark.parametrize("name", ["landmark-harris", "landmark-ransac"])
def test_a_solution_that_disagrees_with_the_light_fails_if_asked(world, name):
    evidence = {"log_evidence_min": 0} if name == "landmark-ransac" else {}

    def limited(**options):
        built = estimator_class(name).from_options({"database": DATABASE, **evidence, **options}, world)
        return estimate(built, world.frame(1)[1])

    reported = limited()
    if reported.bound is not None:  # nobody tells which corner is whose
        assert np.linalg.eigvals(np.linalg.solve(reported.bound, reported.covariance)).real.min() > 1.0
    assert (reported.bound is not None) == (name == "landmark-ransac")
    residual = reported.diagnostics["centroid_residual_px"]
    assert 0.0 < residual < 10.0
    assert limited(consistency_max_px=1.01 * residual).status == "ok"
    refused = limited(consistency_max_px=0.99 * residual)
    assert (refused.status, refused.pose) == ("failed", None)
    assert f"{residual:.3g} px from the image's" in refused.reason


def test_a_solution_without_evidence_fails(world):
    def limited(**options):
        built = estimator_class("landmark-ransac").from_options({"database": DATABASE, **options}, world)
        return estimate(built, world.frame(1)[1])

    evidence = limited(log_evidence_min=None).diagnostics["log_evidence"]
    assert 0.0 < evidence < 1.0
    assert limited().status == "failed"
    assert limited(log_evidence_min=evidence - 0.1).status == "ok"
    refused = limited(log_evidence_min=evidence + 0.1)
    assert (refused.status, refused.pose) == ("failed", None)
    assert refused.reason.startswith(f"the log evidence for landmarks is {evidence:.3g}: less than")
    assert refused.diagnostics["log_evidence"] == evidence


def test_a_pose_that_is_no_maximum_fails(world, monkeypatch):
    """As if the iteration had ended at a saddle, where more than all information is missing."""
    observed = MixtureEvaluation.observed_information.fget
    monkeypatch.setattr(MixtureEvaluation, "observed_information", property(lambda self: -observed(self)))
    built = estimator_class("landmark-ransac").from_options({"database": DATABASE}, world)
    refused = estimate(built, world.frame(1)[1])
    assert (refused.status, refused.pose) == ("failed", None)
    assert refused.reason.startswith("the pose found is no maximum of the posterior")

"""Pose solvers on drawn landmarks: the draws follow their distributions, and rows are the same however they come."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, kstest
from tiny_campaign import SCENE, compute, run, write_campaign

from boresight.campaign.cli import main
from boresight.campaign.kinds.pose_convergence import (
    LANDMARKS,
    PoseConvergence,
    draw_landmarks,
    first_visible,
    problem_stack,
)
from boresight.campaign.runs.resolve import resolve
from boresight.campaign.store import RunFolder
from boresight.campaign.trial.kind import WorkerContext
from boresight.campaign.trial.score import pose_error, pose_errors
from boresight.estimators.landmark.pose.stack import PoseStack
from boresight.estimators.landmark.projection import project_landmarks, visible_landmarks
from boresight.renderers.mitsuba3 import choose_variant
from boresight.scenarios.draw import Stream, draw_view, generator
from boresight.scenarios.errors import BoresightError

CONVERGENCE = """\
title: Pose solvers
experiment: pose-convergence
scenarios: [scene]
estimators:
  - pose-solver: {label: closed, method: closed-form, database: &base BASE}
  - pose-solver: {label: alone, method: non-linear, marquardt: {parameters: minimal}, database: *base}
  - pose-solver: {label: both, method: both, database: *base}
  - pose-solver:
      label: fixed
      method: non-linear
      marquardt: {schedule: fixed, damping: 1.0, max_iterations: 20}
      database: *base
trials: 60
seed: 11
""".replace("BASE", "{images: 40, min_observations: 6, clusters: {seed_radius_m: 15, sigma_floor_m: 0.1}}")
GAUSSIAN = SCENE + "pose_error: {position_cam_m: {normal: [50, 50, 50]}, attitude: {angle_deg: {normal: 2}}}\n"


@pytest.fixture(scope="module")
def file(cache, tmp_path_factory):
    return write_campaign(tmp_path_factory.mktemp("convergence"), CONVERGENCE, GAUSSIAN)


@pytest.fixture(scope="module")
def stored(file):
    compute(file, file.parent / "run", 60)
    return RunFolder(file.parent / "run")


@pytest.fixture(scope="module")
def experiment(file, stored):
    campaign = resolve(str(file), variant=choose_variant().name)
    return PoseConvergence.open(campaign, campaign.scenarios[0], WorkerContext(stored.path, 1, keep_images=False))


def test_what_adapts_reaches_the_minimum_and_a_fixed_lambda_does_not(stored):
    rows = stored.table("rows")
    assert (rows["status"] == "ok").all()
    medians = rows.groupby("estimator")["position_error_m"].median()
    assert medians["alone"] == pytest.approx(medians["both"], rel=1e-3)
    assert (medians < rows["prior_position_error_m"].median()).all()
    numbers = stored.table("diagnostics").pivot_table(index=["trial", "estimator"], columns="name", values="value")
    excess = numbers["chi2_excess"].unstack()
    assert excess["both"].abs().max() < 1e-3
    assert (excess["closed"] > -1e-6).all()
    assert (excess["fixed"] > 1.0).mean() > 0.2
    assert (numbers["iterations"].unstack()["closed"] == 0).all()


def test_rows_do_not_depend_on_how_trials_are_split(experiment):
    whole = experiment.run(range(20))
    parts = [experiment.run(trials) for trials in (range(13), range(13, 20))]
    for table in ("rows", "diagnostics"):
        assert whole[table] == parts[0][table] + parts[1][table]


def test_two_jobs_and_a_continued_run_give_the_same_rows(file, stored, tmp_path):
    compute(file, tmp_path, 25)
    compute(file, tmp_path, 60, jobs=2)
    assert RunFolder(tmp_path).table("rows").equals(stored.table("rows"))


def test_views_are_those_of_the_images_and_landmarks_are_visible_ones(experiment):
    spec, database = experiment.spec, experiment.landmarks
    camera = spec.camera.camera()
    for trial in range(20):
        draw = draw_landmarks(spec, database, 11, trial)
        expected = draw_view(spec, camera, generator(11, Stream.TRUTH, trial)).T_cam_body
        np.testing.assert_array_equal(draw.view.T_cam_body.rotation, expected.rotation)
        visible = np.flatnonzero(visible_landmarks(database.mesh(), camera, expected))
        assert set(draw.chosen) <= set(visible)
        assert len(set(draw.chosen)) == min(LANDMARKS, len(visible))


def test_an_altitude_is_refused(file):
    campaign = resolve(str(file), overrides=["viewpoint.altitude_m=1800"])
    with pytest.raises(BoresightError, match=r"viewpoint.altitude_m has no part in pose-solver: give range_m"):
        PoseConvergence.check_scenario(campaign.scenarios[0])


def test_all_visible_landmarks_are_found_in_the_given_order(experiment):
    database, camera = experiment.landmarks, experiment.spec.camera.camera()
    pose = draw_landmarks(experiment.spec, database, 11, 3).view.T_cam_body
    order = np.random.default_rng(0).permutation(len(database))
    visible = visible_landmarks(database.mesh(), camera, pose)
    found = first_visible(database.mesh(), camera, pose, order, count=len(database))
    np.testing.assert_array_equal(found, order[visible[order]])


def test_observed_positions_follow_the_projected_covariances(experiment):
    """Squared distances weighted by the covariances are chi-square with 2 degrees of freedom; false alarm 1e-4."""
    spec, database = experiment.spec, experiment.landmarks
    squares = []
    for trial in range(200):
        draw = draw_landmarks(spec, database, 5, trial)
        seen = project_landmarks(database, spec.camera.camera(), draw.view.T_cam_body)
        offset = draw.uv_px - seen.uv_px[draw.chosen]
        solved = np.linalg.solve(seen.covariances_px2[draw.chosen], offset[..., None])[..., 0]
        squares.append(np.einsum("ni,ni->n", offset, solved))
    assert kstest(np.concatenate(squares), chi2(2).cdf).pvalue > 1e-4


def test_weights_are_those_of_the_disturbed_pose(experiment):
    """Truth never reaches a solver: neither its points nor its weights depend on the true pose."""
    spec, database = experiment.spec, experiment.landmarks
    draw = draw_landmarks(spec, database, 11, 7)
    stack = problem_stack([draw], database, spec.camera.camera())
    at_prior = project_landmarks(database, spec.camera.camera(), draw.prior).covariances_px2[draw.chosen]
    np.testing.assert_allclose(stack.information_px2[0], np.linalg.inv(at_prior), rtol=1e-9)


def test_errors_side_by_side_are_those_of_one_pose(experiment):
    draws = [draw_landmarks(experiment.spec, experiment.landmarks, 11, trial) for trial in range(6)]
    truths, priors = [d.view.T_cam_body for d in draws], [d.prior for d in draws]
    found = pose_errors(PoseStack.of(priors), PoseStack.of(truths))
    for row, (prior, truth) in enumerate(zip(priors, truths, strict=True)):
        for name, value in pose_error(prior, truth).items():
            assert found[name][row] == pytest.approx(value, rel=1e-9, abs=1e-9)


def test_too_few_visible_landmarks_are_a_failure_with_a_reason(experiment):
    records = replace(experiment, spec=_from_afar(experiment.spec)).run(range(3))
    assert [row["status"] for row in records["rows"]] == ["failed"] * 12
    assert records["rows"][0]["reason"] == "0 landmarks are visible, 10 needed"
    assert records["diagnostics"] == []


def _from_afar(spec):
    """The same scenario with a camera whose image the body does not reach."""
    camera = spec.camera.model_copy(update={"principal_point_px": (-4000.0, -4000.0)})
    return spec.model_copy(update={"camera": camera})


def test_the_report_names_the_solvers(file, stored, capsys):
    assert main(["report", str(stored.path)]) == 0
    page = (stored.path / "report" / "report.html").read_text(encoding="utf-8")
    assert "chi2_excess" in page
    assert (stored.path / "report" / "method_errors_scene.png").exists()
    assert "closed" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("pose-solver: {label: closed,", "prior: {label: closed,", "the only method is pose-solver"),
        ("method: both", "method: guess", "closed-form"),
        ("method: both, database: *base", "method: both, database: {images: 41}", "give all the same"),
    ],
)
def test_bad_campaigns_are_refused_in_one_line(tmp_path, capsys, old, new, complaint):
    bad = write_campaign(tmp_path, CONVERGENCE.replace(old, new), GAUSSIAN)
    assert run(bad, tmp_path / "run") == 2
    said = capsys.readouterr().err
    assert complaint in said
    assert "Traceback" not in said

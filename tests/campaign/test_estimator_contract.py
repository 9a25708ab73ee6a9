"""Every estimator of the name table keeps the contract, in the real renderer's images and with a real data base."""

from __future__ import annotations

import os
import pickle
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from tiny_campaign import DATABASE, SCENE

from boresight.campaign.imaging.observe import observe
from boresight.campaign.imaging.world import open_world
from boresight.campaign.kinds.single_image import SingleImage, check
from boresight.campaign.products import BuiltAssets
from boresight.estimators.contract import Assets, Estimate, Estimator
from boresight.estimators.registry import estimator_class, estimator_names
from boresight.renderers.mitsuba3 import choose_variant
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import load_scenario
from boresight.scenarios.observation import CameraSigma, Frame, Observation

MAPLETS = {"spacing_m": 15, "side": 15}
PHOTOMETRIC = {"samples_per_pixel": 1, "levels": [{"reduction": 4, "iterations": 3}]}
REHEARSALS = {"trials": 20, "bodies": 1}
# What a table entry needs to be built quickly; whoever is not here is built with its defaults.
QUICK = {
    "landmark-harris": {"database": DATABASE},
    "centroid": {"shape": "landmark-mesh", "database": DATABASE},
    "landmark-ransac": {"database": DATABASE, "log_evidence_min": None},
    "whole-image": {"database": DATABASE},
    "photometric": PHOTOMETRIC,
    "landmark-altimeter": {"options": {"database": DATABASE}},
    "lmaps": {"maplets": MAPLETS},
    "consensus": {"options": {"maplets": MAPLETS}, "second_options": PHOTOMETRIC},
    "tuned": {"options": PHOTOMETRIC, "tuning": REHEARSALS},
}
# Need what the scene has not: their contract is tested with bodies that have craters, and with stars in images.
ELSEWHERE = {"crater-pose", "stars"}
NAMES = tuple(name for name in estimator_names() if name not in ELSEWHERE)
# State the errors of the calibration, with a fit that has the prior.
CALIBRATED = ("landmark-orb", "landmark-ransac", "landmark-sift", "limb", "lmaps", "photometric", "tuned")
# The control row answers whatever the image shows.
BLIND = {"prior"}


@dataclass(frozen=True)
class Bench:
    assets: BuiltAssets
    experiment: SingleImage

    def observation(self, trial: int) -> Observation:
        return observe(
            self.experiment.world, self.experiment.world.source.trial_image(5, trial), self.experiment.seed, trial
        )


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    folder = tmp_path_factory.mktemp("bench")
    (folder / "scene.yaml").write_text(SCENE + "sensors: {altimeter: {sigma_m: 5}}\n")
    scenario, variant = load_scenario(str(folder / "scene.yaml")), choose_variant().name
    return Bench(
        BuiltAssets(scenario, folder / "products", 1, variant),
        SingleImage(world=open_world(scenario, variant), scenario="scene", methods={}, seed=5),
    )


@pytest.fixture(scope="module", params=NAMES)
def estimator(request: pytest.FixtureRequest, bench: Bench) -> Estimator:
    return estimator_class(request.param).from_options(QUICK.get(request.param, {}), bench.assets)


class QuickProducts:
    """Lends quick data bases and rehearsals to whoever asks for them by default options."""

    def __init__(self, assets: BuiltAssets) -> None:
        self.camera = assets.camera
        self.mesh_renderer = assets.mesh_renderer
        self.shape = assets.shape
        self._assets = assets

    def product(self, kind: str, options: Mapping[str, object]) -> object:
        if kind == "covariance-tuning":
            options = {**options, **REHEARSALS, "options": PHOTOMETRIC}
        return self._assets.product(kind, {"landmark-database": DATABASE, "maplets": MAPLETS}.get(kind, options))


def answer(estimator: Estimator, observation: Observation, seed: int = 1) -> Estimate:
    return estimator.estimate(observation, rng=np.random.default_rng(seed))


def content(estimate: Estimate) -> bytes:
    """Everything of an estimate but the wall times, as bytes."""
    poses = [*filter(None, [estimate.pose]), *(stage.T_cam_body for stage in estimate.stages)]
    return pickle.dumps(
        [
            estimate.status, estimate.reason, sorted(estimate.diagnostics.items()),
            [(p.rotation.tobytes(), p.translation_m.tobytes(), p.to_frame, p.from_frame) for p in poses],
            [m if m is None else m.tobytes() for m in (estimate.covariance, estimate.bound)],
            [s.name for s in estimate.stages],
            [(name, column, table[column].tobytes()) for name, table in sorted(estimate.details.items())
             for column in sorted(table)],
        ]
    )  # fmt: skip


def with_image(observation: Observation, image: np.ndarray) -> Observation:
    return replace(observation, frame=replace(observation.frame, image=image))


@pytest.mark.parametrize("name", NAMES)
def test_default_options_build(bench, name):
    found = estimator_class(name)
    assets: Assets = QuickProducts(bench.assets)
    estimator = found.from_options({}, assets)
    assert isinstance(estimator, found)
    assert found.name == name
    assert found.version >= 1
    estimate = answer(estimator, bench.observation(0))
    # Few landmarks of 128 x 128 pixels are no evidence.
    assert estimate.status == "ok" or (name == "landmark-ransac" and "log_evidence_min" in estimate.reason)


@pytest.mark.parametrize("name", estimator_names())
def test_an_unknown_option_is_refused_by_name(bench, name):
    with pytest.raises(BoresightError, match=rf"estimator {name}: colour: .*\S") as caught:
        estimator_class(name).from_options({**QUICK.get(name, {}), "colour": "red"}, bench.assets)
    assert "\n" not in str(caught.value)


def test_a_good_image_is_answered_by_the_contract(estimator, bench):
    for trial in range(3):
        observation = bench.observation(trial)
        estimate = answer(estimator, observation)
        assert estimate.status == "ok"
        check(estimate)
        if estimate.covariance is not None:
            np.testing.assert_allclose(estimate.covariance, estimate.covariance.T)
            assert (np.linalg.eigvalsh(estimate.covariance) > 0).all()
        lengths = {name: {len(column) for column in table.values()} for name, table in estimate.details.items()}
        assert all(len(found) == 1 for found in lengths.values()), lengths


@pytest.mark.parametrize("estimator", CALIBRATED, indirect=True)
def test_the_calibration_errs_as_far_as_the_image_decides(estimator, bench):
    """Of a wrong focal length the range errs by the share of the image; of a wrong middle the place does whole."""
    seen = bench.observation(0)
    known, range_m = seen.frame.prior_covariance, seen.frame.prior_T_cam_body.translation_m[2]

    def added_m(prior, *sigmas):
        given = replace(seen, frame=replace(seen.frame, prior_covariance=prior))
        exact, wrong = (
            answer(estimator, replace(given, camera_sigma=s)) for s in (CameraSigma(), CameraSigma(*sigmas))
        )
        np.testing.assert_array_equal(wrong.pose.translation_m, exact.pose.translation_m)
        return np.sqrt(np.maximum(np.diag(wrong.covariance - exact.covariance)[3:], 0.0))

    across_m = added_m(known, 0.0, 2.0)[:2] * seen.camera.fx_px / range_m
    assert across_m.min() > 1.5 and across_m.max() < 2.1
    sure = known * np.outer([1, 1, 1, 1, 1, 1e-4], [1, 1, 1, 1, 1, 1e-4])
    shares = [added_m(prior, 0.005, 0.0)[2] / (0.005 * range_m) for prior in (known, sure)]
    assert 0.03 < shares[0] < 1.01 and shares[1] < 1e-3


@pytest.mark.parametrize("level", [0.0, 100.0])
def test_a_black_image_fails_with_a_reason(estimator, bench, level):
    observation = bench.observation(0)
    black = with_image(observation, np.full_like(observation.frame.image, level))
    estimate = answer(estimator, black)
    if estimator.name in BLIND:
        assert estimate.status == "ok"
        return
    assert estimate.status == "failed"
    assert "black" in estimate.reason
    assert estimate.pose is estimate.covariance is estimate.bound is None
    check(estimate)


def test_the_same_rng_gives_the_same_answer_whatever_came_before(estimator, bench):
    first, other = bench.observation(1), bench.observation(2)
    before = content(answer(estimator, first))
    answer(estimator, other)
    answer(estimator, with_image(first, np.zeros_like(first.frame.image)))
    assert content(answer(estimator, first)) == before
    assert content(answer(estimator, other)) != before


def test_a_rebuilt_estimator_gives_the_same_answer(estimator, bench):
    again = type(estimator).from_options(QUICK.get(estimator.name, {}), bench.assets)
    assert content(answer(again, bench.observation(1))) == content(answer(estimator, bench.observation(1)))


def test_inputs_are_not_changed(estimator, bench):
    observation = bench.observation(1)
    frame = observation.frame
    writable = Frame(
        frame.image.copy(), frame.sun_dir_cam.copy(), frame.prior_T_cam_body, frame.prior_covariance.copy()
    )
    arrays = [writable.image, writable.sun_dir_cam, writable.prior_covariance]
    poses = [writable.prior_T_cam_body.rotation, writable.prior_T_cam_body.translation_m]
    before = [array.tobytes() for array in (*arrays, *poses)]
    answer(estimator, Observation(observation.camera, writable))
    assert [array.tobytes() for array in (*arrays, *poses)] == before


def test_calls_leave_nothing_behind(estimator, bench, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    observation = bench.observation(1)
    answer(estimator, observation)
    state, environment = _state(estimator), dict(os.environ)
    numpy_state = np.random.get_state()[1].tobytes()  # noqa: NPY002  the global generator must stay untouched
    answer(estimator, bench.observation(2))
    assert _state(estimator) == state
    assert dict(os.environ) == environment
    assert np.random.get_state()[1].tobytes() == numpy_state  # noqa: NPY002
    assert not list(Path(tmp_path).iterdir())


def _state(estimator: Estimator) -> dict[str, int]:
    return {name: id(value) for name, value in vars(estimator).items()}

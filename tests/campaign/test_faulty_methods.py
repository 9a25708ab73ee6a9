"""Whatever a method of any contract does wrong is its own error; what scoring does wrong is not."""

from __future__ import annotations

import asyncio
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_crater_score import circles

from boresight.campaign.kinds.crater_matching import check_matches
from boresight.campaign.kinds.sequence.score import check_sequence
from boresight.campaign.kinds.single_image import check
from boresight.campaign.pool.guard import Call
from boresight.campaign.trial.runner import GaveUpError, Work, try_build
from boresight.campaign.trial.score import check_detections
from boresight.estimators.contract import Estimate, Stage
from boresight.estimators.craters.contract import CraterDetections, CraterImage, CraterMatches
from boresight.estimators.slam.contract import FrameEstimate, SequenceEstimate
from boresight.renderers.mitsuba3 import MitsubaRenderer, choose_variant
from boresight.scenarios.bodies.embedded import EMBEDDED
from boresight.scenarios.geometry import Camera, Pose, View, look_at
from boresight.scenarios.observation import Frame, TrackFrame, TrackSequence
from boresight.scenarios.spec.brdf import LambertSpec
from boresight.scenarios.spec.campaign import EstimatorSpec

HERE = Pose(np.eye(3), np.array([0.0, 0.0, 1e3]))
CAMERA = Camera.from_fov(100, 100, 0.1)
FRAME = Frame(np.zeros((100, 100), np.float32), np.array([0.0, 0.0, -1.0]), HERE, np.eye(6))
WORK = Work(Call("scene", 7, "mine"), "estimator", {"range_m": 5.0})
NAMES = ("u_px", "v_px", "x_m", "y_m", "z_m", "sxx_m2", "sxy_m2", "sxz_m2", "syy_m2", "syz_m2", "szz_m2")
TABLE = {"landmark": np.arange(2), **{name: np.full(2, float(name[1:3] in ("xx", "yy", "zz"))) for name in NAMES}}
# Metres and radians, and a correlation of 1.01: the eigenvalues of the correlations are 1 +- 1.01.
INDEFINITE = np.diag([1e-12, 1.0, 1.0, 1.0, 1.0, 1e6])
INDEFINITE[0, 5] = INDEFINITE[5, 0] = 1.01e-3
GOOD = Estimate("ok", pose=HERE, covariance=np.eye(6), details={"landmarks": TABLE})


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (None, "a NoneType is no Estimate"),
        ("ok", "a str is no Estimate"),
        ({"status": "ok", "pose": HERE}, "a dict is no Estimate"),
        (replace(GOOD, status=["ok"]), "not ok or failed"),
        (replace(GOOD, status="maybe"), "status is 'maybe', not ok or failed"),
        (Estimate("failed"), "gives as its reason ''"),
        (replace(GOOD, reason=7), "the reason is 7"),
        (Estimate("failed", "x" * 10_000), "the reason is '10000 characters'"),
        (replace(GOOD, reason="all went well"), "an ok estimate gives as its reason 'all went well'"),
        (replace(GOOD, pose=np.eye(4)), "a ndarray is no Pose"),
        (replace(GOOD, pose=None), "an ok estimate has no pose"),
        (replace(GOOD, pose=(HERE,)), "a tuple is no Pose"),
        (replace(GOOD, pose=Pose(np.eye(3), [np.nan, 0, 0])), r"translation \[nan"),
        (replace(GOOD, pose=Pose(np.full((3, 3), np.nan), [0, 0, 1e3])), "rotation off by nan"),
        (replace(GOOD, pose=Pose(-np.eye(3), [0, 0, 1e3])), "is not rigid"),
        (replace(GOOD, pose=Pose(1.01 * np.eye(3), [0, 0, 1e3])), "is not rigid: rotation off by 2.0e-02"),
        (replace(GOOD, pose=HERE.inverse()), "T_body_cam, not T_cam_body"),
        (replace(GOOD, pose=Pose(np.eye(3), [0, 0, 1e16])), "the pose is not rigid"),
        (replace(GOOD, stages=(Stage("half", Pose(2 * np.eye(3), [0, 0, 1])),)), "after half is not rigid"),
        (replace(GOOD, stages=(Stage("half", Pose(np.eye(3), [0, 0, np.inf])),)), "the pose after half is not rigid"),
        (replace(GOOD, covariance=np.eye(6).tolist()), "a list, not an array"),
        (replace(GOOD, covariance=np.eye(3)), r"a covariance of shape \(3, 3\)"),
        (replace(GOOD, covariance=np.full((6, 6), 1e300)), "beyond 1e"),
        (replace(GOOD, bound=1j * np.eye(6)), "of finite numbers"),
        (replace(GOOD, common=np.full(6, np.nan)), "the common error of shape .* finite numbers"),
        (replace(GOOD, covariance=np.triu(np.ones((6, 6)))), "not symmetric"),
        (replace(GOOD, covariance=np.diag([1, 1, 1, 1, 1, -1e-9])), "a covariance has a negative variance: -1e-09"),
        (replace(GOOD, covariance=INDEFINITE), "a covariance is not positive semidefinite: .* eigenvalue -0.01"),
        (replace(GOOD, bound=INDEFINITE), "a bound is not positive semidefinite"),
        (replace(GOOD, details={"landmarks": {**TABLE, "sxy_m2": np.full(2, 1.01)}}), "landmarks: a covariance is not"),
        (replace(GOOD, stages=(Stage("\x1b[2Jhalf", HERE),)), r"a stage has the name '\\x1b\[2Jhalf'"),
        (replace(GOOD, stages=(Stage("", HERE),)), "a stage has the name ''"),
        (replace(GOOD, diagnostics={"chi2\n": 1.0}), r"diagnostics has the name 'chi2\\n'"),
        (replace(GOOD, timings_s={"\x07": 1.0}), r"timings_s has the name '\\x07'"),
        (replace(GOOD, details={"\x1b": {}}), r"details has the name '\\x1b'"),
        (replace(GOOD, stages=iter(())), "stages are a tuple_iterator, not a tuple"),
        (Estimate("failed", "late", pose=np.eye(4)), "a ndarray is no Pose"),
        (replace(GOOD, details={"mine": {"a": np.array([None])}}), "mine: a is no array of numbers or texts"),
        (replace(GOOD, diagnostics={(1, 2): 3.0}), "diagnostics of type dict have no names"),
        (replace(GOOD, diagnostics={"chi2": np.nan}), "diagnostics: chi2 is nan"),
        (replace(GOOD, diagnostics={"chi2": 1j}), "chi2 is complex, not a number"),
        (replace(GOOD, diagnostics={"chi2": np.zeros(3)}), "chi2 is ndarray, not a number"),
        (replace(GOOD, diagnostics={"n_landmarks": "many"}), "n_landmarks is a text"),
        (
            replace(GOOD, diagnostics={"chi2": 1e300}),
            r"diagnostics: chi2 is 1e\+300, not a number from -1e\+15 to 1e\+15",
        ),
        (replace(GOOD, diagnostics={"chi2": -1e16}), "chi2 is -1e"),
        (replace(GOOD, timings_s={"all": "long"}), "all is str, not a number"),
        (replace(GOOD, timings_s={"all": -1e-9}), "timings_s: all is -1e-09, not a number from 0 to"),
        (replace(GOOD, timings_s={"all": 1e300}), r"all is 1e\+300"),
        (replace(GOOD, details={"landmarks": {"landmark": np.arange(3), "u_px": np.ones(3)}}), "missing: v_px, x_m"),
        (replace(GOOD, details={"landmarks": {**TABLE, "sxx_m2": np.zeros(2)}}), "a covariance is singular"),
        (replace(GOOD, details={"landmarks": {**TABLE, "landmark": np.ones(2)}}), "of whole numbers"),
        (replace(GOOD, details={"landmarks": {**TABLE, "u_px": np.full(2, 1e9)}}), "u_px has a number beyond"),
        (replace(GOOD, details={"landmarks": {**TABLE, "v_px": np.ones(3)}}), r"v_px of shape \(3,\)"),
    ],
)
def test_wrong_estimates(answer, said):
    check(GOOD)
    with pytest.raises(ValueError, match=said):
        check(answer)


STEP = FrameEstimate(np.zeros(3), np.eye(3), np.zeros(0, np.int64), np.zeros((0, 3)), 0.1)


@pytest.fixture
def sequence():
    """A sequence of which only the tracks of its one frame are looked at."""
    frame, found = TrackFrame.__new__(TrackFrame), TrackSequence.__new__(TrackSequence)
    object.__setattr__(frame, "tracks", np.arange(3))
    object.__setattr__(found, "frames", (frame,))
    return found


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (None, "a NoneType is no SequenceEstimate"),
        ("ok", "a str is no SequenceEstimate"),
        ({"frames": []}, "a dict is no SequenceEstimate"),
        (SequenceEstimate("ok", ()), "0 frames of ok for 1 of the sequence"),
        (SequenceEstimate("ok", (STEP, STEP)), "2 frames of ok for 1 of the sequence"),
        (SequenceEstimate("failed", (step for step in (STEP,)), "late"), "frames are a generator, not a tuple"),
        (SequenceEstimate("ok", (STEP,), diagnostics={(1, 2): 3.0}), "diagnostics of type dict have no names"),
        (SequenceEstimate("ok", (replace(STEP, position_m=1j * np.ones(3)),)), "of finite numbers"),
        (SequenceEstimate("ok", (replace(STEP, position_m=np.full(3, np.nan)),)), "of finite numbers"),
        (SequenceEstimate("ok", (replace(STEP, covariance_m2=np.triu(np.ones((3, 3)))),)), "is not symmetric"),
        (SequenceEstimate("ok", (None,)), "a NoneType is no FrameEstimate"),
        (SequenceEstimate("ok", (replace(STEP, position_m=None),)), "position_m is a NoneType"),
        (SequenceEstimate("ok", (replace(STEP, position_m=np.full(3, 1e200)),)), "position_m has a number beyond"),
        (SequenceEstimate("ok", (replace(STEP, position_m=np.zeros(4)),)), r"is not \(3,\)"),
        (SequenceEstimate("ok", (replace(STEP, covariance_m2=np.full((3, 3), np.nan)),)), "of finite numbers"),
        (SequenceEstimate("ok", (replace(STEP, covariance_m2=INDEFINITE[::5, ::5]),)), "covariance_m2 of shape"),
        (SequenceEstimate("ok", (replace(STEP, covariance_m2=INDEFINITE[3:, 3:] - 2.0),)), "a negative variance: -1"),
        (SequenceEstimate("ok", (replace(STEP, covariance_m2=np.eye(3)[::-1]),)), "eigenvalue -1"),
        (SequenceEstimate("ok", (STEP,), "done"), "an ok estimate gives as its reason 'done'"),
        (SequenceEstimate("ok", (STEP,), diagnostics={"\x1b": 1.0}), "diagnostics has the name"),
        (SequenceEstimate("ok", (replace(STEP, seconds=None),)), "seconds is NoneType"),
        (SequenceEstimate("ok", (replace(STEP, seconds=-1.0),)), "seconds is -1, not a number from 0"),
        (SequenceEstimate("ok", (STEP,), diagnostics={"gm_m3_s2": 1e300}), r"gm_m3_s2 is 1e\+300"),
        (SequenceEstimate("ok", (replace(STEP, tracks=np.zeros(1)),)), "of whole numbers"),
        (SequenceEstimate("ok", (STEP,), diagnostics={"gm_m3_s2": "heavy"}), "gm_m3_s2"),
    ],
)
def test_wrong_estimates_of_a_sequence(sequence, answer, said):
    check_sequence(SequenceEstimate("ok", (STEP,)), sequence)
    with pytest.raises(ValueError, match=said):
        check_sequence(answer, sequence)


def test_wrong_detections_and_matches():
    rims = circles((10, 10, 5), (30, 30, 5))
    for answer in (None, CraterDetections(None, np.ones(2)), CraterDetections(circles((1e9, 1, 5)), np.ones(1))):
        with pytest.raises(ValueError, match=r"is no|beyond"):
            check_detections(answer)
    images = [CraterImage(number, FRAME, CAMERA, CraterDetections(rims, np.ones(2))) for number in (0, 1)]
    both = CraterMatches(np.zeros((1, 2), np.int64), np.ones(1), "rejected")
    for answer in (None, CraterMatches(np.zeros((1, 2)), np.ones(1)), CraterMatches([[0, 0]], np.ones(1)), both):
        with pytest.raises(ValueError, match=r"is no|whole numbers|not an array|1 matches, and a reason why there are"):
            check_matches(answer, *images)


def _never(answer: object) -> dict[str, list[dict[str, object]]]:
    raise AssertionError("this is not to be scored")


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (ZeroDivisionError("by nought"), "the estimator raised ZeroDivisionError: by nought"),
        (SystemExit(0), "the estimator raised SystemExit: 0"),
        (GeneratorExit(), "the estimator raised GeneratorExit"),
        (asyncio.CancelledError("late"), "the estimator raised asyncio.exceptions.CancelledError: late"),
        (MemoryError(), "the estimator raised MemoryError"),
        (ValueError("\x1b[2J"), r"the estimator raised ValueError: \x1b[2J"),
        (KeyError("a\nb"), "the estimator raised KeyError: 'a\\nb'"),
        (ValueError("in <thing at 0x7f00a1>"), "the estimator raised ValueError: in <thing at 0x...>"),
    ],
)
def test_what_a_method_raises_is_a_row_with_its_reason(error, reason):
    def work():
        raise error

    records = WORK.run(work, lambda answer: None, _never)
    assert records["rows"] == [{"range_m": 5.0, "status": "error", "reason": reason, "n_landmarks": 0}]
    assert "in work\n    raise error\n" in records["tracebacks"][0]["traceback"]


def test_a_method_that_is_led_below_the_ground_has_failed():
    """A renderer refuses the camera there, whatever method asks it; the method did not break."""
    body = MitsubaRenderer(
        EMBEDDED["sphere"](), LambertSpec(), samples_per_pixel=1, shading="flat", variant=choose_variant()
    )
    down = View(CAMERA, look_at(np.array([1.0, 2.0, 3.0])), np.array([1.0, 0.0, 0.0]))
    (row,) = WORK.run(lambda: body.render(down), lambda answer: None, _never)["rows"]
    assert row["status"] == "failed"
    assert row["reason"].startswith("the pose was led below the ground: the camera at (1, 2, 3) m, 3.74166 m from")


def test_why_a_method_cannot_be_built_is_one_printable_line():
    def make():
        raise ValueError("\x1b[2J\ngone")

    unbuilt = try_build(EstimatorSpec(name="mine", label="mine"), "scene", make)
    assert unbuilt.reason.startswith(r"mine cannot be built for scene: ValueError: \x1b[2J gone; ")


def test_an_interruption_stays_one():
    def work():
        raise KeyboardInterrupt

    for do, check_it in ((work, lambda answer: None), (lambda: 1, lambda answer: work())):
        with pytest.raises(KeyboardInterrupt):
            WORK.run(do, check_it, _never)


def test_what_breaks_the_contract_is_rubbish_whatever_the_check_raises():
    raised = ((ValueError("too long"), "too long"), (TypeError("len"), "TypeError: len"), (GeneratorExit(), "Gen"))
    for error, said in raised:

        def refuse(answer, error=error):
            raise error

        (row,) = WORK.run(lambda: 1, refuse, _never)["rows"]
        assert row["status"] == "error"
        assert row["reason"].startswith(f"the estimator returned an invalid result: {said}")


def test_a_witness_is_shown_what_keeps_the_contract_alone():
    shown = []

    def refuse(answer):
        if answer == "rubbish":
            raise ValueError(answer)

    for answer in ("rubbish", "sound"):
        WORK.run(lambda answer=answer: answer, refuse, lambda answer: {"rows": []}, shown.append)
    assert shown == [None, "sound"]


def test_a_method_may_give_up():
    def work():
        raise GaveUpError("too\x1b[2J dark")

    records = WORK.run(work, lambda answer: None, _never)
    assert records["rows"] == [{"range_m": 5.0, "status": "failed", "reason": r"too\x1b[2J dark", "n_landmarks": 0}]
    assert "tracebacks" not in records


def test_a_method_that_changes_the_folder_leaves_the_process_where_it_was(tmp_path):
    def work():
        os.chdir(tmp_path)
        raise RuntimeError("and fails there")

    before = Path.cwd()
    WORK.run(work, lambda answer: None, _never)
    assert Path.cwd() == before != tmp_path


def test_a_fault_of_scoring_is_not_the_methods():
    def score(answer):
        raise KeyError("of our own")

    with pytest.raises(KeyError) as caught:
        WORK.run(lambda: 1, lambda answer: None, score)
    (note,) = caught.value.__notes__
    assert "scenario='scene', trial=7, label='mine'" in note
    assert "an error of boresight" in note

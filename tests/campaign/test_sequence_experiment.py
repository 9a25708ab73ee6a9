"""The sequence experiment: scores against scipy and closed forms, faults recorded, the smoke campaign end to end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.distance import mahalanobis

from boresight.campaign.cli.main import main
from boresight.campaign.kinds.sequence import SequenceTrials
from boresight.campaign.kinds.sequence.score import (
    check_sequence,
    final_landmark_rmse,
    parameter_errors,
    score_epochs,
    summary,
)
from boresight.estimators.slam.contract import FrameEstimate, SequenceEstimate
from boresight.estimators.slam.following import DeadReckoning
from boresight.scenarios.geometry import Camera
from boresight.scenarios.sequences import SphereGround, draw_sequence
from boresight.scenarios.spec.sequence import SequenceSpec

CAMERA = Camera.from_fov(1024, 1024, np.radians(30.0))
SPEC = SequenceSpec.model_validate({"sphere_radius_m": 190, "orbit": {"revolutions": 1.0, "step_deg": 6}})
GROUND = SphereGround(190.0)
SHIFT_M = np.array([1.0, -2.0, 2.0])


@pytest.fixture(scope="module")
def drawn():
    return draw_sequence(SPEC, CAMERA, GROUND, 7, 0)


def shifted(truth, sequence, landmark_error_m=3.0):
    """Return an estimate whose every error is known."""
    covariance = np.diag([1.0, 4.0, 9.0])
    away = np.array([0.0, 0.0, landmark_error_m])
    frames = tuple(
        FrameEstimate(
            pose.camera_position_m + SHIFT_M, covariance, frame.tracks, truth.points_m[frame.tracks] + away, 0.01
        )
        for pose, frame in zip(truth.poses, sequence.frames, strict=True)
    )
    return SequenceEstimate("ok", frames)


def test_a_known_error_is_scored_as_what_it_is(drawn):
    truth, sequence = drawn
    epochs = score_epochs(shifted(truth, sequence), sequence, truth)
    for pose, epoch in zip(truth.poses, epochs, strict=True):
        assert epoch["position_error_m"] == pytest.approx(3.0)
        # The camera's axes: x along the velocity, y against the normal, z towards the body.
        along, minus_cross, minus_radial = pose.rotation @ SHIFT_M
        assert [epoch["along_m"], epoch["cross_m"], epoch["radial_m"]] == pytest.approx(
            [along, -minus_cross, -minus_radial], abs=1e-9
        )
        assert epoch["nees"] == pytest.approx(mahalanobis(SHIFT_M, np.zeros(3), np.diag([1, 1 / 4, 1 / 9])) ** 2)
        assert epoch["landmark_rmse_m"] == pytest.approx(3.0)
    assert epochs[0]["n_settled"] == 0
    assert epochs[0]["settled_landmark_rmse_m"] is None
    told = summary(shifted(truth, sequence), sequence, truth, epochs)
    assert told["error_after_1_m"] == pytest.approx(3.0)
    assert told["error_after_2_m"] is None
    assert told["landmark_rmse_m"] == pytest.approx(3.0)


def test_an_estimate_in_wrong_body_axes_is_right_if_it_is_right_in_inertial_space():
    """The body's rotation is believed wrong; positions and landmarks are where they are, said in those axes."""
    turning = {"body_motion": {"kind": "spin"}, "knowledge": {"pole_sigma_deg": 2.0, "spin_sigma": 0.01}}
    spec = SequenceSpec.model_validate({**SPEC.model_dump(), **turning})
    truth, sequence = draw_sequence(spec, CAMERA, GROUND, 7, 0)
    frames = []
    for pose, seen, true in zip(truth.poses, sequence.frames, truth.trajectory.R_body_inertial, strict=True):
        place, points = true.T @ pose.camera_position_m, truth.points_m[seen.tracks] @ true
        shift = np.cross([0.0, 0.0, 1.0], place) / np.linalg.norm(place)  # along the motion about the z axis
        known = seen.R_body_inertial
        frames.append(FrameEstimate(known @ (place + 2.0 * shift), np.eye(3), seen.tracks, points @ known.T, 0.0))
    assert np.linalg.norm(frames[-1].position_m - truth.poses[-1].camera_position_m) > 5.0
    epochs = score_epochs(SequenceEstimate("ok", frames), sequence, truth)
    for epoch in epochs:
        assert epoch["position_error_m"] == pytest.approx(2.0)
        assert [epoch["radial_m"], epoch["along_m"], epoch["cross_m"]] == pytest.approx([0.0, 2.0, 0.0], abs=1e-6)
        assert epoch["landmark_rmse_m"] == pytest.approx(0.0, abs=1e-9)
    assert final_landmark_rmse(SequenceEstimate("ok", frames), sequence, truth) == pytest.approx(0.0, abs=1e-9)


def test_new_landmarks_are_left_out_of_the_settled_error(drawn):
    truth, sequence = drawn
    good = shifted(truth, sequence, 0.0)
    spoilt, older = [], np.empty(0)
    for frame, seen in zip(good.frames, sequence.frames, strict=True):
        new = ~np.isin(seen.tracks, older)
        spoilt.append(replace(frame, points_m=frame.points_m + new[:, None] * np.array([0.0, 8.0, 0.0])))
        older = seen.tracks
    estimate = SequenceEstimate("ok", spoilt)
    told = summary(estimate, sequence, truth, score_epochs(estimate, sequence, truth))
    assert told["settled_landmark_rmse_m"] == 0.0
    total = sum(len(frame.tracks) for frame in sequence.frames)
    new = len(truth.points_m)
    assert told["landmark_rmse_m"] == pytest.approx(8.0 * np.sqrt(new / total))
    # A landmark that was seen once is left out of the final error, with whatever error it has.
    tracks, counts = np.unique(np.concatenate([seen.tracks for seen in sequence.frames]), return_counts=True)
    once = tracks[counts == 1]
    wild = [
        replace(frame, points_m=frame.points_m + 8.0 * np.isin(frame.tracks, once)[:, None]) for frame in good.frames
    ]
    assert len(once) > 0
    assert final_landmark_rmse(SequenceEstimate("ok", wild), sequence, truth) == 0.0


def test_dead_reckoning_is_consistent_and_walks_at_random(drawn):
    ends, nees = [], []
    for trial in range(40):
        truth, sequence = draw_sequence(SPEC, CAMERA, GROUND, 7, trial)
        epochs = score_epochs(DeadReckoning().follow(sequence), sequence, truth)
        ends.append(epochs[-1]["position_error_m"])
        nees.append(epochs[-1]["nees"])
    step_m = 0.5 * 2 * 790.0 * np.sin(np.radians(3.0))
    assert np.sqrt(np.mean(np.square(ends))) == pytest.approx(step_m * np.sqrt(60), rel=0.3)
    assert np.mean(nees) == pytest.approx(3.0, abs=4 * np.sqrt(6 / 40))


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda e: replace(e, frames=e.frames[:-1]), "frames of ok"),
        (lambda e: replace(e, status="failed"), "as its reason"),
        (lambda e: replace(e, status="fine"), "not ok or failed"),
        (lambda e: replace(e, frames=(replace(e.frames[0], position_m=np.full(3, np.nan)), *e.frames[1:])), "finite"),
        (lambda e: replace(e, frames=(replace(e.frames[0], tracks=e.frames[0].tracks * 0), *e.frames[1:])), "twice"),
    ],
)
def test_rubbish_is_refused(drawn, spoil, said):
    truth, sequence = drawn
    good = shifted(truth, sequence)
    check_sequence(good, sequence)
    with pytest.raises(ValueError, match=said):
        check_sequence(spoil(good), sequence)


def test_parameters_of_the_motion_are_scored(drawn):
    truth, sequence = drawn
    told = {"gm_m3_s2": 1.02 * truth.gm_m3_s2, "gm_sigma_m3_s2": 0.01 * truth.gm_m3_s2, "radiation_m_s2": 1e-7}
    estimate = replace(shifted(truth, sequence), diagnostics=told)
    scores = parameter_errors(estimate, truth)
    assert scores == pytest.approx({"gm_error_percent": 2.0, "gm_nees": 4.0})  # there is no pressure on a circle
    assert parameter_errors(shifted(truth, sequence), truth) == {}
    trials = trials_with({"told": Returns(estimate)})
    added = {row["name"]: row["value"] for row in trials.run(range(1))["diagnostics"]}
    assert added == pytest.approx({**told, **scores})


def trials_with(estimators):
    return SequenceTrials(scenario="x", methods=estimators, seed=7, spec=SPEC, camera=CAMERA, ground=GROUND)


class Returns:
    name, version = "returns", 1

    def __init__(self, estimate):
        self.estimate = estimate

    def follow(self, sequence):
        return self.estimate


class Raises:
    name, version = "raises", 1

    def follow(self, sequence):
        raise RuntimeError("out of order")


class StopsHalfWay:
    name, version = "stops", 1

    def follow(self, sequence):
        whole = DeadReckoning().follow(sequence)
        return SequenceEstimate("failed", whole.frames[:10], "the scale became unobservable")


def test_what_goes_wrong_becomes_a_row_and_the_campaign_goes_on():
    trials = trials_with({"a": Raises(), "b": StopsHalfWay(), "c": DeadReckoning()})
    found = trials.run(range(2))
    assert [row["status"] for row in found["rows"]] == ["error", "failed", "ok"] * 2
    assert "out of order" in found["tracebacks"][0]["traceback"]
    stopped = found["rows"][1]
    assert stopped["reason"] == "the scale became unobservable"
    assert stopped["error_after_1_m"] is None
    assert "position_error_m" not in stopped
    assert sum(epoch["estimator"] == "b" for epoch in found["epochs"]) == 20


def test_what_is_summed_up_over_frames_is_of_runs_that_ended():
    """Of three runs one fails at its second frame, with a landmark error of 0.2 m where the others have 3 and 5 m."""
    drawn = {trial: draw_sequence(SPEC, CAMERA, GROUND, 7, trial) for trial in range(3)}
    whole = {trial: shifted(*drawn[trial], error) for trial, error in ((0, 3.0), (1, 0.2), (2, 5.0))}
    stopped = SequenceEstimate("failed", whole[1].frames[:2], "scale", {"gm_m3_s2": 1.0})
    assert parameter_errors(stopped, drawn[1][0]) == {}
    rows, times = [], []
    for trial, estimate in enumerate((whole[0], stopped, whole[2])):
        found = trials_with({"a": Returns(estimate)}).run(range(trial, trial + 1))
        rows += found["rows"]
        times += found["timings"]
    table = pd.DataFrame(rows)
    assert table["landmark_rmse_m"].mean() == pytest.approx(4.0)
    over_frames = ("landmark_rmse_m", "settled_landmark_rmse_m", "final_landmark_rmse_m", "mean_position_nees")
    assert table[[*over_frames]].count().tolist() == [2, 2, 2, 2]
    assert [time["trial"] for time in times] == [0, 2]


def test_an_error_that_was_reached_before_a_failure_counts():
    spec = SequenceSpec.model_validate({"sphere_radius_m": 190, "orbit": {"revolutions": 2.0, "step_deg": 6}})
    truth, sequence = draw_sequence(spec, CAMERA, GROUND, 7, 0)
    estimate = SequenceEstimate("failed", shifted(truth, sequence).frames[:90], "scale")
    told = summary(estimate, sequence, truth, score_epochs(estimate, sequence, truth))
    assert (told["error_after_1_m"], told["error_after_2_m"]) == (pytest.approx(3.0), None)
    assert told["landmark_rmse_m"] is None


def test_the_smoke_campaign_runs_end_to_end_and_twice_the_same(tmp_path):
    for folder, trials, report in (("one", "2", ("--worst", "0")), ("two", "1", ("--no-report",))):
        words = ["run", "delpech2015-smoke", "--set", "sequence.orbit.step_deg=4", "--trials", trials, "--jobs", "1"]
        assert main([*words, *report, "--out", str(tmp_path / folder)]) == 0
    tables = [[pd.read_parquet(tmp_path / folder / name) for name in ("rows", "epochs")] for folder in ("one", "two")]
    for one, two in zip(*tables, strict=True):
        pd.testing.assert_frame_equal(one[one["trial"] == 0].reset_index(drop=True), two)
    methods = 4
    assert len(tables[0][0]) == 2 * methods
    frames = tables[0][1].groupby(["estimator", "trial"]).size()
    whole = tables[0][0].set_index(["estimator", "trial"])["status"] == "ok"
    assert (frames[whole] == 181).all()
    assert (frames[~whole] < 181).all()
    assert whole["fixed-lag"].all()
    rows, epochs = (table[table["estimator"] == "fixed-lag"] for table in tables[0])
    at_one = epochs.loc[epochs["anomaly_deg"] == 360.0, "position_error_m"]
    np.testing.assert_array_equal(rows["error_after_1_m"], at_one)
    report = (tmp_path / "one" / "report" / "report.md").read_text(encoding="utf-8")
    assert "position error after 2 revolutions" in report
    assert (tmp_path / "one" / "report" / "traces_apophis-sphere-sequence.png").stat().st_size > 10_000
    table = pd.read_csv(tmp_path / "one" / "report" / "table.csv")
    told = table[(table["measure"] == "error_after_2_m") & (table["estimator"] == "fixed-lag")].set_index("statistic")[
        "value"
    ]
    assert told["mean"] == pytest.approx(rows["error_after_2_m"].mean())
    assert told["deviation"] == pytest.approx(rows["error_after_2_m"].std(ddof=1))

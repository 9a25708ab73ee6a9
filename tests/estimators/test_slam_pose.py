"""The filter with the camera's pose in its state: attitudes, derivatives, covariance, consistency, accuracy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from slam_sequences import CAMERA, ORBIT_M, STEP_RAD, Recipe, central_differences, look_down, make_sequence

from boresight.estimators.slam.contract import SequenceEstimate
from boresight.estimators.slam.filters.ekf import ConsistentEkfSlam, EkfSlam, IteratedEkfSlam
from boresight.estimators.slam.filters.ekf_pose import PoseState, left_jacobian, rotation_of
from boresight.estimators.slam.filters.ekf_state import landmark_points, turn_jacobians
from boresight.estimators.slam.filters.ekf_update import FrameMeasurements
from boresight.estimators.slam.smoothing.smoother import FixedLagSmoother
from boresight.scenarios.geometry import cross_matrix
from boresight.scenarios.observation import TrackFrame, TrackSequence

SECONDS = 480.0
SPIN = Rotation.from_rotvec([0.01, -0.02, 0.03])
TURN_NOISE_RAD = np.radians(1.0)


def on_orbit(number: int) -> np.ndarray:
    return ORBIT_M * np.array([np.cos(number * STEP_RAD), np.sin(number * STEP_RAD), 0.0])


def frame_at(number: int, **values: object) -> TrackFrame:
    """A frame without tracks above a body that rotates by ``SPIN`` between frames."""
    turned = SPIN.as_rotvec() * number
    known = Rotation.from_rotvec(turned).as_matrix()
    here = TrackFrame(
        time_s=SECONDS * number,
        R_cam_body=look_down(on_orbit(number)) @ known.T,
        tracks=np.zeros(0, dtype=np.int64),
        uv_px=np.zeros((0, 2)),
        sigma_px=0.7,
        motion_m=known @ on_orbit(number) - Rotation.from_rotvec(turned - SPIN.as_rotvec()).apply(on_orbit(number - 1)),
        motion_covariance_m2=np.diag([1.0, 4.0, 9.0]),
        R_body_inertial=known,
    )
    return replace(here, **values)


@pytest.fixture
def state() -> PoseState:
    """Three landmarks anchored at the first pose, the camera a frame further on; all attitudes have errors on them."""
    rng = np.random.default_rng(3)
    sigmas = {"attitude_sigma_rad": 0.02, "attitude_bias_sigma_rad": 0.01}
    start = PoseState.at_first(on_orbit(0), 0.01 * np.eye(3), frame_at(0, **sigmas), TURN_NOISE_RAD)
    elements = np.column_stack([rng.uniform(300, 700, (3, 2)), np.full(3, 1.0 / 620.0)])
    noise = np.tile([0.4, 0.4, (0.1 / 620.0) ** 2], (3, 1))
    moved = start.augmented(np.array([4, 7, 9]), elements, noise).predicted(CAMERA, frame_at(1, **sigmas))
    x = moved.x.copy()
    x[6:9] = 0.05, -0.1, 0.2
    x[15:].reshape(3, 9)[:, 6:] = rng.normal(0.0, 0.1, (3, 3))
    return replace(moved, x=x)


def errors_of(state: PoseState, true: PoseState) -> np.ndarray:
    """(15,) errors of a state, in the elements of its covariance; rotations by scipy."""
    turn = Rotation.from_matrix(true.attitude) * Rotation.from_matrix(state.attitude).inv()
    wrong = true.x[:15] - state.x[:15]
    wrong[6:9] = turn.as_rotvec()
    return wrong


@pytest.mark.parametrize("angle", [0.0, 1e-6, 1e-4, 0.01, 1.0, 3.0])
def test_rotation_vectors_are_those_of_scipy(angle: float) -> None:
    turn = angle * np.array([[2.0, -1.0, 2.0], [0.6, 0.0, -0.8]]) / np.array([[3.0], [1.0]])
    foreign = Rotation.from_rotvec(turn)
    np.testing.assert_allclose(rotation_of(turn), foreign.as_matrix(), atol=1e-15)
    np.testing.assert_allclose(cross_matrix(turn)[1] @ [1.0, 2.0, 3.0], np.cross(turn[1], [1.0, 2.0, 3.0]), atol=1e-15)
    for row, J in zip(turn, left_jacobian(turn), strict=True):
        numeric = central_differences(
            lambda t, row=row: (Rotation.from_rotvec(t) * Rotation.from_rotvec(row).inv()).as_rotvec(),
            row,
            np.full(3, 1e-5),
        )
        np.testing.assert_allclose(J, numeric, atol=1e-9)


def test_landmark_turns_with_its_anchor(state: PoseState) -> None:
    R = state.anchor_attitudes
    analytic = turn_jacobians(CAMERA, state.landmarks, R)
    for k in range(3):
        numeric = central_differences(
            lambda t, k=k: landmark_points(
                CAMERA, state.landmarks[k : k + 1], (Rotation.from_rotvec(t).as_matrix() @ R[k])[None]
            )[0],
            np.zeros(3),
            np.full(3, 1e-5),
        )
        np.testing.assert_allclose(analytic[k], numeric, atol=1e-5)


def test_innovation_derivatives_are_those_of_central_differences(state: PoseState) -> None:
    """Of pixels and of distances, at attitude errors that are not zero."""
    seen = FrameMeasurements(
        CAMERA, np.array([2, 0]), np.full((2, 2), 500.0), 0.7, np.array([1, 2]), np.full(2, 600.0), np.ones(2)
    )
    landmark = [1e-2, 1e-2, 1e-8, 1e-3, 1e-3, 1e-3, 1e-6, 1e-6, 1e-6]
    steps = np.concatenate([np.full(6, 1e-3), np.full(3, 1e-6), np.full(6, 1e-3), np.tile(landmark, 3)])
    numeric = central_differences(lambda x: -seen.residual(replace(state, x=x)), state.x, steps)
    scale = steps / 1e-3  # in units of the steps, so that metres, radians and inverse metres compare
    np.testing.assert_allclose(seen.innovation(state).jacobian * scale, numeric * scale, atol=1e-5)
    assert np.abs(numeric[:4, 6:9]).min() > 1.0


def test_propagation_has_the_derivatives_of_central_differences(state: PoseState) -> None:
    """With a rotating body; the process noise is the covariance of drawn motions and accelerations."""
    start = state.with_errors_reset()
    end = start.propagated(frame_at(2))
    shifts = np.concatenate([np.full(6, 1e-3), np.full(3, 1e-5), np.full(3, 1e-7), np.full(3, 1e-5)])
    columns = []
    for i, shift in enumerate(shifts):
        sides = []
        for sign in (1.0, -1.0):
            x = start.x.copy()
            x[i] += sign * shift
            sides.append(errors_of(end, replace(start, x=x).with_errors_reset().propagated(frame_at(2))))
        columns.append((sides[0] - sides[1]) / (2.0 * shift))
    F = np.stack(columns, axis=1)
    scale = 1.0 / np.sqrt(np.diag(end.covariance))
    np.testing.assert_allclose(
        end.covariance[:15, 15:] * scale[:15, None] * scale[15:],
        F @ start.covariance[:15, 15:] * scale[:15, None] * scale[15:],
        atol=1e-6,
    )
    added = end.covariance[:15, :15] - F @ start.covariance[:15, :15] @ F.T
    drawn = _drawn_noise(start, 20000)
    spread = drawn.std(axis=0)
    lively = spread > 0.0
    assert lively.sum() == 12
    expected = added[np.ix_(lively, lively)] / np.outer(spread[lively], spread[lively])
    np.testing.assert_allclose(np.corrcoef(drawn[:, lively].T), expected, atol=0.05)


def _drawn_noise(start: PoseState, count: int) -> np.ndarray:
    """(count, 15) errors after an interval with random motions and angular accelerations."""
    rng = np.random.default_rng(8)
    frame, end = frame_at(2), start.propagated(frame_at(2))
    known, dt = frame.R_body_inertial, SECONDS
    drawn = np.zeros((count, 15))
    moves = rng.multivariate_normal(np.zeros(3), frame.motion_covariance_m2, count)
    turns = TURN_NOISE_RAD * rng.normal(size=(count, 3))
    drawn[:, :3] = moves
    drawn[:, 3:6] = moves @ known / dt
    rate = start.x[9:12]
    about = start.frame.R_body_inertial @ known.T
    begin = Rotation.from_matrix(start.attitude)
    there = Rotation.from_rotvec(-(rate * dt + turns)) * begin * Rotation.from_matrix(about)
    drawn[:, 6:9] = (there * Rotation.from_matrix(end.attitude).inv()).as_rotvec()
    drawn[:, 9:12] = 2.0 * turns / dt
    return drawn


def test_folding_keeps_the_pose_and_refers_errors_to_it(state: PoseState) -> None:
    folded = state.with_errors_reset()
    np.testing.assert_allclose(folded.attitude, state.attitude, atol=1e-15)
    np.testing.assert_allclose(folded.points(CAMERA), state.points(CAMERA), atol=1e-10)
    assert not folded.x[6:9].any()
    assert not folded.anchor_turns.any()

    def turned(x: np.ndarray) -> np.ndarray:
        moved = replace(state, x=x)
        return errors_of(folded, moved)[6:9]

    J = central_differences(turned, state.x, np.full(len(state.x), 1e-5))
    np.testing.assert_allclose(folded.covariance[6:9, 6:9], J @ state.covariance @ J.T, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(folded.covariance[6:9, :3], (J @ state.covariance)[:, :3], rtol=1e-6, atol=1e-9)


def test_what_is_told_stands_in_the_axes_that_the_spacecraft_knows(state: PoseState) -> None:
    """Without a misalignment the lasting error is the body's: with the measured attitude, pixels do not change."""
    grown = replace(state.with_errors_reset(), misalignment_rad=0.0)
    grown = replace(grown, x=grown.x + np.eye(len(grown.x))[12] * 0.01)
    position, covariance, points = grown.estimate(CAMERA)
    known = Rotation.from_rotvec(grown.x[12:15]).as_matrix() @ grown.attitude
    there = (grown.points(CAMERA) - grown.position_m) @ grown.attitude.T
    np.testing.assert_allclose((points - position) @ known.T, there, atol=1e-9)
    steps = np.full(len(grown.x), 1e-5)
    J = central_differences(lambda x: replace(grown, x=x).estimate(CAMERA)[0], grown.x, steps)
    J[:, 6:9] = 0.0  # a turn of the axes is itself the error: of second order
    expected = J @ grown.covariance @ J.T
    np.testing.assert_allclose(covariance, expected, rtol=0.02, atol=0.02 * np.abs(expected).max())
    still = replace(state.with_errors_reset(), misalignment_rad=state.frame.attitude_bias_sigma_rad)
    np.testing.assert_array_equal(still.estimate(CAMERA)[0], still.position_m)
    half = replace(grown, misalignment_rad=np.sqrt(0.5) * grown.frame.attitude_bias_sigma_rad)
    np.testing.assert_allclose(half.estimate(CAMERA)[0], 0.5 * (position + grown.position_m), atol=0.02)


def test_star_tracker_without_landmarks_is_consistent() -> None:
    """Attitude, rate and misalignment of 80 drawn cameras: their NEES has the mean of a chi-square of 9."""
    rng, lasting, white, frames = np.random.default_rng(5), 0.01, 0.005, 6
    sigmas = {"attitude_sigma_rad": float(np.hypot(lasting, white)), "attitude_bias_sigma_rad": lasting}
    total, runs = 0.0, 80
    for _ in range(runs):
        wrong, rate = lasting * rng.normal(size=3), rng.normal(0.0, 1e-5, 3)
        true, state = Rotation.from_matrix(look_down(on_orbit(0))), None
        for number in range(frames):
            if number:
                push = TURN_NOISE_RAD * rng.normal(size=3)
                true = Rotation.from_rotvec(-(rate * SECONDS + push)) * true
                rate = rate + 2.0 * push / SECONDS
            seen = Rotation.from_rotvec(wrong + white * rng.normal(size=3)) * true
            frame = frame_at(number, R_cam_body=seen.as_matrix(), R_body_inertial=np.eye(3), **sigmas)
            if state is None:
                state = PoseState.at_first(on_orbit(0), np.eye(3), frame, TURN_NOISE_RAD)
            else:
                state = state.predicted(CAMERA, frame)
        turn = true * Rotation.from_matrix(state.attitude).inv()
        error = np.concatenate([turn.as_rotvec(), rate - state.x[9:12], wrong - state.x[12:15]])
        covariance = state.covariance[6:15, 6:15]
        total += error @ np.linalg.solve(covariance, error)
    low, high = chi2.ppf([0.001, 0.999], 9 * runs)
    assert low < total < high
    assert np.sqrt(np.diag(covariance)[:3]).min() > 0.99 * lasting  # the misalignment is not observable


def test_rate_and_velocity_are_those_of_the_orbit() -> None:
    """In inertial space, above a rotating body: closed form for a circle with the camera pointed at its centre."""
    state = PoseState.at_first(on_orbit(0), np.zeros((3, 3)), frame_at(0), TURN_NOISE_RAD)
    for number in range(1, 9):
        state = state.predicted(CAMERA, frame_at(number))
    rate = look_down(on_orbit(8)) @ [0.0, 0.0, STEP_RAD / SECONDS]
    np.testing.assert_allclose(state.x[9:12], rate, atol=1e-3 * STEP_RAD / SECONDS)
    np.testing.assert_allclose(state.velocity_m_s, (on_orbit(8) - on_orbit(7)) / SECONDS, atol=1e-12)
    np.testing.assert_allclose(state.attitude, frame_at(8).R_cam_body, atol=1e-9)
    np.testing.assert_allclose(state.propagated(frame_at(9)).attitude, frame_at(9).R_cam_body, atol=1e-4)


@pytest.mark.parametrize("estimator", [EkfSlam, IteratedEkfSlam, ConsistentEkfSlam])
@pytest.mark.parametrize("gate", ["none", "one-point"])
def test_exact_attitude_gives_what_the_position_alone_does(estimator: type[EkfSlam], gate: str) -> None:
    sequence, _ = make_sequence(np.random.default_rng(6), Recipe(frames=16))
    alone = estimator.from_options({"gate": gate}).follow(sequence)
    whole = estimator.from_options({"gate": gate, "camera": "pose"}).follow(sequence)
    assert (alone.status, len(alone.frames)) == ("ok", len(whole.frames))
    for a, b in zip(alone.frames, whole.frames, strict=True):
        np.testing.assert_allclose(b.position_m, a.position_m, atol=1e-6)
        np.testing.assert_allclose(b.covariance_m2, a.covariance_m2, atol=1e-6)
        np.testing.assert_allclose(b.points_m, a.points_m, atol=1e-5)
        np.testing.assert_array_equal(b.tracks, a.tracks)


def disturbed(sequence: TrackSequence, rng: np.random.Generator, noise_rad: float, lasting_rad: float) -> TrackSequence:
    """A star tracker that is noisy and misaligned."""
    wrong = lasting_rad * rng.normal(size=3)
    frames = [
        replace(
            frame,
            R_cam_body=Rotation.from_rotvec(wrong + noise_rad * rng.normal(size=3)).as_matrix() @ frame.R_cam_body,
            attitude_sigma_rad=float(np.hypot(noise_rad, lasting_rad)),
            attitude_bias_sigma_rad=lasting_rad,
        )
        for frame in sequence.frames
    ]
    return replace(sequence, frames=tuple(frames))


def squares(estimate: SequenceEstimate, true_m: np.ndarray) -> tuple[float, float]:
    """Mean squared error and mean NEES / 3 of the frames after the tenth."""
    assert estimate.status == "ok", estimate.reason
    found, nees = [], []
    for frame, true in list(zip(estimate.frames, true_m, strict=True))[10:]:
        assert frame.covariance_m2 is not None
        error = frame.position_m - true
        found.append(error @ error)
        nees.append(error @ np.linalg.solve(frame.covariance_m2, error) / 3.0)
    return float(np.mean(found)), float(np.mean(nees))


@pytest.mark.parametrize(("noise_deg", "lasting_deg"), [pytest.param(0.03, 0.0, marks=pytest.mark.long), (0.0, 0.1)])
def test_whole_camera_is_more_accurate_and_more_consistent(noise_deg: float, lasting_deg: float) -> None:
    """Compared with the position-only filter with the star tracker's attitude taken as exact; on the same tracks."""
    kept = []
    for seed in range(4):
        sequence, truth = make_sequence(np.random.default_rng(seed), Recipe(frames=60))
        rng = np.random.default_rng(100 + seed)
        wrong = disturbed(sequence, rng, np.radians(noise_deg), np.radians(lasting_deg))
        kept.append(
            [
                squares(ConsistentEkfSlam.from_options({"camera": camera}).follow(wrong), truth.positions_m)
                for camera in ("position", "pose")
            ]
        )
    (error_alone, nees_alone), (error_whole, nees_whole) = np.mean(kept, axis=0)
    assert error_whole < error_alone
    assert 0.4 < nees_whole < 2.0 < nees_alone


def test_smoother_counts_noise_of_attitudes_as_noise_of_pixels() -> None:
    """Without frame-to-frame noise nothing changes; with it the smoother is less overconfident."""
    kept = []
    for seed in range(4):
        sequence, truth = make_sequence(np.random.default_rng(seed), Recipe(frames=60))
        noisy = disturbed(sequence, np.random.default_rng(100 + seed), np.radians(0.03), 0.0)
        found = [FixedLagSmoother.from_options({"attitude": a}).follow(noisy) for a in ("known", "noisy")]
        kept.append([squares(estimate, truth.positions_m)[1] for estimate in found])
    known, counted = np.mean(kept, axis=0)
    assert abs(np.log(counted)) < 0.6 * abs(np.log(known))
    lasting = disturbed(sequence, np.random.default_rng(9), 0.0, 3e-4)
    one, two = (FixedLagSmoother.from_options({"attitude": a}).follow(lasting).frames for a in ("known", "noisy"))
    assert [f.position_m.tobytes() for f in one] == [f.position_m.tobytes() for f in two]


def test_same_input_gives_the_same_bits_and_stays_as_it_was() -> None:
    sequence, _ = make_sequence(np.random.default_rng(6), Recipe(frames=12))
    wrong = disturbed(sequence, np.random.default_rng(7), 3e-4, 3e-4)
    before = [frame.R_cam_body.tobytes() + frame.uv_px.tobytes() for frame in wrong.frames]
    one, two = (EkfSlam.from_options({"camera": "pose"}).follow(wrong).frames for _ in range(2))
    assert [f.position_m.tobytes() for f in one] == [f.position_m.tobytes() for f in two]
    assert [f.velocity_m_s is None for f in one] == [True] + 11 * [False]
    assert before == [frame.R_cam_body.tobytes() + frame.uv_px.tobytes() for frame in wrong.frames]


def test_propagation_adds_the_whole_covariance_of_the_motion(state: PoseState) -> None:
    """Compared with the position: no other camera element affects it."""
    frame = frame_at(2)
    moved = state.with_errors_reset().propagated(frame)
    added = moved.covariance[:3, :3] - state.with_errors_reset().covariance[:3, :3]
    np.testing.assert_allclose(added, frame.motion_covariance_m2, rtol=1e-9)
    assert np.trace(frame.motion_covariance_m2) > 0.0

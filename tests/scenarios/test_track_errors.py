"""Errors of simulated tracks that accumulate: their laws, and those that are common to all tracks."""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
import pytest
from scipy import stats

from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Pose
from boresight.scenarios.load import canonical_json, load_scenario
from boresight.scenarios.sequences import SphereGround, draw_sequence
from boresight.scenarios.sequences.track_simulation import SimulatedTracks, accumulated_errors_px, noise
from boresight.scenarios.spec.vision import TrackErrorsSpec

CAMERA = Camera.from_fov(1024, 1024, np.radians(30.0))
GROUND = SphereGround(190.0)


def errors_of(trial, *, revolutions=2, **vision):
    """Pixel errors of each frame by track."""
    keys = ", ".join(f"{key}: {value}" for key, value in vision.items())
    changes = f"sequence.vision={{landmarks_per_frame: 60, {keys}}}", f"sequence.orbit.revolutions={revolutions}"
    spec = load_scenario("apophis-sphere-sequence", changes).spec
    truth, sequence = draw_sequence(spec.sequence, CAMERA, GROUND, 11, trial)
    return [
        dict(
            zip(
                frame.tracks.tolist(),
                frame.uv_px - CAMERA.project(pose.transform(truth.points_m[frame.tracks])),
                strict=True,
            )
        )
        for pose, frame in zip(truth.poses, sequence.frames, strict=True)
    ]


def test_without_them_nothing_changes_to_the_last_bit():
    plain, none = errors_of(1), errors_of(1, track_errors="{}")
    for one, other in zip(plain, none, strict=True):
        assert one.keys() == other.keys()
        assert all((one[track] == other[track]).all() for track in one)
    assert "track_errors" not in canonical_json(load_scenario("apophis-sphere-sequence").spec)


def test_a_walk_has_a_variance_that_grows_with_the_age_of_a_track():
    frames = errors_of(0, noise_px=0, repeatability=0.95, track_errors="{walk_px: 0.4}")
    first: dict[int, int] = {}
    by_age: dict[int, list[float]] = {}
    steps = []
    for index, frame in enumerate(frames):
        for track, error in frame.items():
            by_age.setdefault(index - first.setdefault(track, index), []).extend(error.tolist())
    for one, other in pairwise(frames):
        steps += [x for track in one.keys() & other.keys() for x in (other[track] - one[track]).tolist()]
    assert np.abs(by_age[0]).max() < 1e-9
    # 99.9 % bounds of a chi-square; tracks are independent at one age, and so are all steps.
    for values, variance in ((by_age[1], 0.16), (by_age[4], 4 * 0.16), (by_age[9], 9 * 0.16), (steps, 0.16)):
        low, high = stats.chi2.interval(0.999, len(values))
        assert low < np.sum(np.square(values)) / variance < high
    assert abs(np.corrcoef(steps[:-1], steps[1:])[0, 1]) < 3.3 / np.sqrt(len(steps))


def test_noise_is_normal_or_student_of_the_same_deviation():
    rng = np.random.default_rng(4)
    plain, heavy = noise(None, (40_000,), rng), noise(5.0, (40_000,), rng)
    assert stats.kstest(plain, "norm").pvalue > 0.001
    assert stats.kstest(heavy / np.sqrt(1.0 - 2.0 / 5.0), stats.t(5.0).cdf).pvalue > 0.001
    assert stats.kstest(heavy, "norm").pvalue < 0.001
    # The fourth moment of t of 5 degrees of freedom is 9 times the squared variance.
    assert np.var(heavy) == pytest.approx(1.0, abs=4.0 * np.sqrt(8.0 / 40_000))


def test_a_contraction_is_a_share_of_the_way_to_the_principal_point_in_each_sequence():
    """The places are those of OpenCV's projection; what has added up since a track began is summed here."""
    camera = Camera(1024, 900, 1000.0, 1200.0, 500.0, 400.0)
    matrix = np.array([[1000.0, 0.0, 500.0], [0.0, 1200.0, 400.0], [0.0, 0.0, 1.0]])
    points = np.array([[40.0, 10.0, 0.0], [-60.0, -30.0, 20.0], [5.0, 70.0, -10.0]])
    tracks = SimulatedTracks(points, np.arange(3), (np.array([0, 1]), np.arange(3), np.arange(3)))
    turns = [np.array([0.02 * k, -0.01, 0.3 * k]) for k in range(3)]
    poses = [Pose(cv2.Rodrigues(turn)[0], np.array([5.0 * k, 0.0, 800.0 - 50.0 * k])) for k, turn in enumerate(turns)]
    places = [
        cv2.projectPoints(points, turn, pose.translation_m, matrix, None)[0][:, 0] - [500.0, 400.0]
        for turn, pose in zip(turns, poses, strict=True)
    ]
    for seed in (1, 2):
        spec = TrackErrorsSpec(contraction=2e-3)
        found = list(accumulated_errors_px(spec, tracks, poses, camera, np.random.default_rng(seed)))
        assert not found[0].any()
        np.testing.assert_allclose(found[1], -2e-3 * places[1] * [[1.0], [1.0], [0.0]], atol=1e-9)
        np.testing.assert_allclose(found[2][:2], -2e-3 * (places[1] + places[2])[:2], atol=1e-9)
        np.testing.assert_allclose(found[2][2], -2e-3 * places[2][2], atol=1e-9)


def test_a_landmark_that_is_found_again_has_the_errors_of_the_turn_since_its_first_view():
    """A camera circles by steps of 30 deg; the common errors are exact, and walks have their variance."""
    camera, frames = Camera(1000, 1000, 1000.0, 1000.0, 500.0, 500.0), 14
    angles = np.radians(30.0 * np.arange(frames))
    poses = [Pose(cv2.Rodrigues(np.array([0.0, angle, 0.0]))[0], np.array([0.0, 0.0, 900.0])) for angle in angles]
    # Seen from frames 1 and 2, after a gap from 5, and a revolution and less than a step before its first view from 12.
    seen = {1: 0, 2: 0, 5: 1, 6: 1, 12: 2, 13: 2}
    point = np.array([30.0, -20.0, 10.0])
    alive = tuple(np.array([seen[k]] if k in seen else [], dtype=np.int64) for k in range(frames))
    tracks = SimulatedTracks(np.tile(point, (3, 1)), np.zeros(3, dtype=np.int64), alive)

    def moved(spec: TrackErrorsSpec, seed: int) -> dict[int, np.ndarray]:
        drawn = accumulated_errors_px(spec, tracks, poses, camera, np.random.default_rng(seed))
        return {k: error[0] for k, error in enumerate(drawn) if k in seen}

    place = {k: camera.project(poses[k].transform(point[None]))[0] - 500.0 for k in seen}
    common = moved(TrackErrorsSpec(contraction=1e-3), 1)
    on, back = place[2] + 3.0 * place[5], -place[12]
    for k, value in {1: 0.0 * place[1], 2: place[2], 5: on, 6: on + place[6], 12: back, 13: back + place[13]}.items():
        np.testing.assert_allclose(common[k], -1e-3 * value, atol=1e-9)

    walks = [moved(TrackErrorsSpec(walk_px=0.3), seed) for seed in range(400)]
    low, high = stats.chi2.interval(0.999, 2 * len(walks))
    for first, then, steps in ((1, 2, 1), (1, 5, 4), (2, 5, 3), (1, 12, 1), (5, 12, 5), (12, 13, 1)):
        square = sum(np.sum((one[then] - one[first]) ** 2) for one in walks)
        assert low < square / (0.09 * steps) < high, (first, then)


def test_a_drift_is_one_step_for_all_tracks_of_a_sequence_and_normal_over_sequences():
    walks = "walk_px: 0.3, student_t: 4"
    drawn = []
    for trial in range(30):
        plain, moved = (
            errors_of(trial, revolutions=0.05, track_errors=f"{{{walks}{more}}}") for more in ("", ", drift_px: 0.2")
        )
        first: dict[int, int] = {}
        steps = []
        for index, (one, other) in enumerate(zip(plain[:8], moved[:8], strict=True)):
            assert one.keys() == other.keys()
            # The walk and the noise are the same draws with a drift and without.
            ages = {track: index - first.setdefault(track, index) for track in one}
            assert all(np.abs(other[track] - one[track]).max() < 1e-9 for track in one if not ages[track])
            steps += [(other[track] - one[track]) / ages[track] for track in one if ages[track]]
        np.testing.assert_allclose(steps, np.tile(steps[0], (len(steps), 1)), atol=1e-9)
        drawn.append(steps[0])
    low, high = stats.chi2.interval(0.999, 2 * len(drawn))
    assert low < np.sum(np.square(drawn)) / 0.2**2 < high
    assert np.abs(np.mean(drawn, axis=0)).max() < 3.5 * 0.2 / np.sqrt(len(drawn))


def test_what_is_stated_of_them_reaches_the_frames_and_nothing_else():
    scene = "apophis-sphere-sequence"
    plain, told = (
        draw_sequence(load_scenario(scene, stated).spec.sequence, CAMERA, GROUND, 11, 0)[1].frames
        for stated in ((), ("sequence.knowledge={walk_px: 0.3, contraction: 2.0e-4, drift_px: 0.1}",))
    )
    assert {(frame.walk_px, frame.contraction, frame.drift_px) for frame in plain} == {(0.0, 0.0, 0.0)}
    assert {(frame.walk_px, frame.contraction, frame.drift_px) for frame in told} == {(0.3, 2e-4, 0.1)}
    for one, other in zip(plain, told, strict=True):
        np.testing.assert_array_equal(one.uv_px, other.uv_px)
        assert one.sigma_px == other.sigma_px
    assert "walk_px" not in canonical_json(load_scenario(scene).spec)


@pytest.mark.parametrize("stated", ["walk_px=-1", "walk_px=0", "contraction=.nan", "drift_px=.inf", "drift_px=fast"])
def test_impossible_knowledge_of_them_is_refused(stated):
    with pytest.raises(BoresightError, match=rf"sequence\.knowledge\.{stated.partition('=')[0]}"):
        load_scenario("apophis-sphere-sequence", (f"sequence.knowledge.{stated}",))


@pytest.mark.parametrize(
    "errors",
    ["{student_t: 2}", "{walk_px: -1}", "{drift_px: .nan}", "{walk: 1}", "{contraction: 0.1}", "{drift_px: -1}"],
)
def test_impossible_errors_are_refused(errors):
    with pytest.raises(BoresightError, match=r"sequence\.vision\.track_errors"):
        load_scenario("apophis-sphere-sequence", (f"sequence.vision.track_errors={errors}",))

"""Parts of the navigation chain: files, the input of orbit determination, and errors that images share."""

from dataclasses import replace

import numpy as np
import pytest
from orbit_worlds import CAMERA, orbit_world
from scipy.spatial.transform import Rotation

from boresight.estimators.craters.contract import CraterDetections, CraterMatches
from boresight.estimators.craters.database.files import (
    LANDMARKS,
    PICTURES,
    CraterDatabase,
    ImageDetections,
    read_detections,
    read_matches,
    write_detections,
    write_matches,
)
from boresight.estimators.craters.database.landmarks import (
    Landmarks,
    PairMatches,
    SequencePicture,
    landmarks_for_orbit,
    pictures_for_orbit,
)
from boresight.estimators.craters.matching.preliminary import couples_at_same_place
from boresight.estimators.craters.matching.transfer import joint_covariance
from boresight.estimators.craters.navigation.rounds import StageFiles, reject_small_matches
from boresight.estimators.craters.navigation.trajectory import (
    AprioriShape,
    Exposure,
    NavigationTask,
    Trajectory,
    images_along_trajectory,
)
from boresight.scenarios.dynamics.field import UniformRotation
from boresight.scenarios.dynamics.propagation import PiecewiseAcceleration, propagate_states
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Ellipses, Pose
from boresight.scenarios.orbits.draw import draw_knowledge
from boresight.scenarios.orbits.true_orbit import state_at_epoch
from boresight.scenarios.sequences.ground import MeshGround

SHIFT_M = np.array([3.0, -2.0, 5.0])
ROTATION = UniformRotation(Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix(), 1e-4)


def _rims(count, rng):
    return Ellipses(rng.uniform(0, 400, (count, 2)), np.sort(rng.uniform(5, 30, (count, 2)))[:, ::-1], np.zeros(count))


def test_detections_are_read_back_as_they_were(tmp_path):
    rng = np.random.default_rng(1)
    found = CraterDetections(_rims(4, rng), np.array([0.9, 0.5, 0.5, 1.0 / 3.0]))
    write_detections(tmp_path / "a", ImageDetections(7, 1234.5, found))
    again = read_detections(tmp_path / "a")
    assert (again.number, again.time_s, again.reason) == (7, 1234.5, "")
    np.testing.assert_array_equal(again.detections.ellipses.centre_px, found.ellipses.centre_px)
    np.testing.assert_array_equal(again.detections.ellipses.semi_axes_px, found.ellipses.semi_axes_px)
    np.testing.assert_array_equal(again.detections.confidence, found.confidence)
    write_detections(tmp_path / "b", ImageDetections(8, 0.0, CraterDetections.none(), "the image is black"))
    assert read_detections(tmp_path / "b").reason == "the image is black"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("crater 7 1", "crater 7 2"), r"a:4: row 2 of image 7, not 1 of 7"),
        (("crater 7 0", "crater 6 0"), r"a:3: row 0 of image 6, not 0 of 7"),
        (("image 7", "image x"), r"a:2: field 1 of the image is 'x'"),
        (("image 7 1.0 -\n", ""), r"a: a file of craters has one image"),
    ],
)
def test_a_wrong_file_of_craters_is_refused_with_its_line(tmp_path, change, message):
    found = CraterDetections(_rims(2, np.random.default_rng(1)), np.ones(2))
    write_detections(tmp_path / "a", ImageDetections(7, 1.0, found))
    (tmp_path / "a").write_text((tmp_path / "a").read_text().replace(*change))
    with pytest.raises(BoresightError, match=message):
        read_detections(tmp_path / "a")


def test_matches_are_read_back_and_a_pair_that_stands_twice_is_refused(tmp_path):
    some = PairMatches(0, 3, CraterMatches(np.array([[1, 4], [2, 0]]), np.array([0.97, 1.0 / 3.0])))
    none = PairMatches(1, 2, CraterMatches.none("image 2 has no crater"))
    write_matches(tmp_path / "a", [some, none])
    first, second = read_matches(tmp_path / "a")
    np.testing.assert_array_equal(first.matches.pairs, some.matches.pairs)
    np.testing.assert_array_equal(first.matches.score, some.matches.score)
    assert (second.first, second.second, second.matches.reason) == (1, 2, "image 2 has no crater")
    write_matches(tmp_path / "b", [some, some])
    with pytest.raises(BoresightError, match=r"b:5: images 0 and 3 are listed twice"):
        read_matches(tmp_path / "b")


def _database(rng):
    """Make two pictures with the same landmark, in axes whose origin is off the centre of mass."""
    times, points = [100.0, 5000.0], rng.uniform(-200, 200, (3, 3)) + SHIFT_M
    attitudes = Rotation.from_rotvec(rng.normal(size=(2, 3))).as_matrix()
    turns = ROTATION.at(np.array(times))
    pictures = []
    for number, (time, attitude, turn) in enumerate(zip(times, attitudes, turns, strict=True)):
        rotation = attitude @ turn.T
        pose = Pose(rotation, -rotation @ (turn @ np.array([3000.0, 0.0, 100.0]) + SHIFT_M))
        shown = np.array([0, 2 - number])
        pictures.append(SequencePicture(number, time, CAMERA, pose, np.array([0.0, 0.0, -1.0]), shown, _rims(2, rng)))
    spread = np.tile(np.diag([9.0, 4.0, 14.0]), (3, 1, 1))
    landmarks = Landmarks(
        np.arange(3), points, np.tile([0.0, 0.0, 1.0], (3, 1)), np.ones(3), spread, np.array([2, 1, 1])
    )
    return CraterDatabase(tuple(pictures), landmarks), attitudes


def test_orbit_determination_reads_a_data_base_about_the_centre_of_mass(tmp_path):
    made, attitudes = _database(np.random.default_rng(2))
    made.save(tmp_path)
    database = CraterDatabase.load(tmp_path)
    pictures, places = (
        pictures_for_orbit(database.pictures, CAMERA, ROTATION),
        landmarks_for_orbit(database.landmarks, SHIFT_M),
    )
    np.testing.assert_allclose(pictures.R_cam_inertial, attitudes, atol=1e-14)
    assert pictures.image.tolist() == [0, 0, 1, 1]
    assert pictures.landmark.tolist() == [0, 2, 0, 1]
    np.testing.assert_array_equal(places.positions_body_m, made.landmarks.position_body_m - SHIFT_M)
    np.testing.assert_allclose(places.sigma_m, 3.0)
    # A sight line is the same in both axes: through the pixel, from the camera to the landmark.
    pose, turn = database.pictures[1].T_cam_body, ROTATION.at(np.array([5000.0]))[0]
    by_database = pose.transform(made.landmarks.position_body_m[0])
    by_orbit = pictures.R_cam_inertial[1] @ (turn.T @ places.positions_body_m[0] - np.array([3000.0, 0.0, 100.0]))
    np.testing.assert_allclose(by_orbit, by_database, atol=1e-9)


def test_a_number_that_stands_twice_no_picture_and_another_camera_are_refused(tmp_path):
    made, _ = _database(np.random.default_rng(2))
    made.save(tmp_path)
    text = (tmp_path / LANDMARKS).read_text()
    (tmp_path / LANDMARKS).write_text(text.replace("landmark 1 ", "landmark 0 "))
    with pytest.raises(BoresightError, match=r"landmarks.txt:3: landmark 0 is listed twice"):
        CraterDatabase.load(tmp_path)
    (tmp_path / LANDMARKS).write_text(text)
    shown = (tmp_path / PICTURES).read_text()
    (tmp_path / PICTURES).write_text(shown.replace("sighting 0 2", "sighting 0 0"))
    with pytest.raises(BoresightError, match=r"pictures.txt:4: landmark 0 is listed twice in picture 0"):
        CraterDatabase.load(tmp_path)
    with pytest.raises(BoresightError, match="no picture"):
        pictures_for_orbit((), CAMERA, ROTATION)
    with pytest.raises(BoresightError, match="picture 0 is of another camera"):
        pictures_for_orbit(made.pictures, replace(CAMERA, fx_px=1.0), ROTATION)


def test_a_stage_is_made_once_and_a_failure_leaves_nothing(tmp_path):
    stages, calls = StageFiles(tmp_path), []

    def make(path):
        calls.append(path)
        path.write_text("x")

    def fail(path):
        raise RuntimeError("on purpose")

    for _ in range(2):
        assert stages.cached("a", "one", make, lambda path: path.read_text()) == "x"
    assert len(calls) == 1
    with pytest.raises(RuntimeError, match="on purpose"):
        stages.cached("b", "two", fail, lambda path: path.read_text())
    assert set(stages.seconds()) == {"one"}


def _placed(world, knowledge, times):
    """Make two images without craters, with prior poses from the a priori orbit."""
    ground = MeshGround(world.onboard.shape.mesh())
    task = NavigationTask(knowledge, AprioriShape(ground, SHIFT_M, 1.0), None, times)
    pixels, rims = np.zeros((2, 2), np.float32), CraterDetections.none()
    ones = [Exposure(i, t, np.eye(3), np.array([0.0, 0.0, -1.0]), pixels, rims) for i, t in enumerate(times)]
    return images_along_trajectory(ones, Trajectory.a_priori(knowledge, times), task)


def _carried(known, times):
    """Covariance (6, 6) of both translations by the errors of the a priori orbit, by central differences."""
    sigma = np.repeat([known.position_sigma_m, known.velocity_sigma_m_s], 3)
    harmonics, none = known.field.harmonics, PiecewiseAcceleration.none(float(times[-1]))

    def positions(off):
        field = replace(known.field, harmonics=replace(harmonics, gm_m3_s2=harmonics.gm_m3_s2 * (1 + 0.01 * off[6])))
        return propagate_states(field, known.state + sigma * off[:6], times, none)[:, :3].ravel()

    by = np.array([(positions(off) - positions(-off)) / 0.2 for off in 0.1 * np.eye(7)])
    return by.T @ by


def test_errors_that_images_share_go_together_as_the_a_priori_orbit_carries_them():
    world = orbit_world(knowledge={"position_m": 30.0, "gm_sigma": 0.01})
    state, times = state_at_epoch(world.spec.arc, world.spec.asteroid.gm_m3_s2), np.array([40_000.0, 41_800.0])
    known = draw_knowledge(world, state, 1, 0)
    images, expected, rows = _placed(world, known, times), _carried(known, times), np.r_[3:6, 9:12]
    found = joint_covariance(*images)[np.ix_(rows, rows)] - _by_turn(images, known)
    np.testing.assert_allclose(found, expected, atol=0.01 * expected.max())


@pytest.mark.long
def test_errors_that_images_share_go_together_as_in_draws_of_the_a_priori_orbit():
    world = orbit_world(knowledge={"position_m": 30.0, "gm_sigma": 0.01})
    state, times = state_at_epoch(world.spec.arc, world.spec.asteroid.gm_m3_s2), np.array([40_000.0, 41_800.0])
    known, rng = draw_knowledge(world, state, 1, 0), np.random.default_rng(3)
    images = _placed(world, known, times)
    covariance = joint_covariance(*images)
    np.testing.assert_allclose(covariance, covariance.T)
    assert np.linalg.eigvalsh(covariance).min() > -1e-6 * covariance.max()
    sigma = np.repeat([known.position_sigma_m, known.velocity_sigma_m_s], 3)
    none, shifts = PiecewiseAcceleration.none(float(times[-1])), []
    nominal = propagate_states(known.field, known.state, times, none)[:, :3]
    for _ in range(400):
        harmonics = replace(known.field.harmonics, gm_m3_s2=known.field.harmonics.gm_m3_s2 * (1 + 0.01 * rng.normal()))
        moved = propagate_states(
            replace(known.field, harmonics=harmonics), known.state + sigma * rng.normal(size=6), times, none
        )
        shifts.append((nominal - moved[:, :3]).ravel())  # R_cam_inertial is the identity: the translation moves by -dr
    drawn = np.cov(np.array(shifts).T)
    rows = np.r_[3:6, 9:12]
    mounting = covariance[np.ix_(rows, rows)] - _by_turn(images, known)
    np.testing.assert_allclose(mounting, drawn, atol=0.25 * drawn.max())
    apart, alone = np.diag(drawn[:3, :3] + drawn[3:, 3:] - 2 * drawn[:3, 3:]), np.diag(drawn[:3, :3] + drawn[3:, 3:])
    assert apart.sum() < 0.1 * alone.sum()


def _by_turn(images, known):
    """Return (6, 6) the effect of camera rotations on both translations: common misalignment, independent attitudes."""
    lever = [np.cross(np.eye(3), image.frame.prior_T_cam_body.translation_m) for image in images]
    mounting, attitude = known.misalignment_sigma_rad**2, known.attitude_sigma_rad**2
    both = mounting * np.vstack([one.T for one in lever]) @ np.hstack(lever)
    both[:3, :3] += attitude * lever[0].T @ lever[0]
    both[3:, 3:] += attitude * lever[1].T @ lever[1]
    return both


def test_places_that_move_together_are_told_apart_by_their_difference():
    points = np.array([[0.0, 0.0, 0.0], [30.0, 0.0, 0.0], [0.0, 4.0, 0.0]])
    shared = np.tile(100.0 * np.eye(3), (3, 1, 1))
    own = np.tile(4.0 * np.eye(3), (3, 1, 1))
    together = own + shared @ np.swapaxes(shared, 1, 2)
    assert couples_at_same_place(points, together, 3.0).tolist() == [[0, 1], [0, 2], [1, 2]]
    assert couples_at_same_place(points, together, 3.0, shared).tolist() == [[0, 2]]
    assert couples_at_same_place(points[:1], together[:1], 3.0, shared[:1]).tolist() == []


def test_pairs_with_too_few_matches_are_not_believed():
    few = PairMatches(0, 1, CraterMatches(np.array([[0, 0], [1, 1]]), np.ones(2)))
    enough = PairMatches(0, 2, CraterMatches(np.array([[0, 0], [1, 1], [2, 2]]), np.ones(3)))
    none = PairMatches(1, 2, CraterMatches.none("nothing in common"))
    found = reject_small_matches([few, enough, none], 3)
    assert [len(pair.matches.pairs) for pair in found] == [0, 3, 0]
    assert found[0].matches.reason == "2 matches are fewer than the 3 that have to agree"
    assert found[2].matches.reason == "nothing in common"

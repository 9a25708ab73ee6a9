"""The chain from planned images to an orbit: drawn detections, resumed, scored by hand, and what goes wrong."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from orbit_worlds import orbit_world

from boresight.campaign.kinds.crater_navigation import CraterNavigationTrials, match_counts, told_apart
from boresight.campaign.kinds.crater_navigation.images import DrawnSights, NavigationTrial
from boresight.estimators.craters.contract import CraterDetections, CraterMatches
from boresight.estimators.craters.database.landmarks import Numbering, PairMatches
from boresight.estimators.craters.navigation.rounds import (
    CraterNavigation,
    NavigationOptions,
    NavigationRound,
    StageFiles,
)
from boresight.estimators.orbit.contract import OrbitEstimate
from boresight.reports.schema.tables import TABLES
from boresight.scenarios.craters.simulated import NO_CRATER, draw_plane_craters
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Pose, TriangleMesh
from boresight.scenarios.observation import Frame
from boresight.scenarios.orbits.true_orbit import imaging_of
from boresight.scenarios.sequences.ground import MeshGround

SHIFT_M = np.array([7.0, -4.0, 11.0])
IMAGING = {
    "epochs": 30,
    "detections": "drawn",
    "craters": {"count": 500, "min_diameter_m": 9.0, "max_diameter_m": 60.0},
    "errors": {"height_m": 0.5, "least_radius_px": 5.0},
}


def _world(**changes):
    """Build the small world; its shape's axes have their origin off the centre of mass."""
    world = orbit_world(
        arc={"days": 1.0},
        knowledge={"position_m": 15.0, "shape_degree": 8, **changes.pop("knowledge", {})},
        imaging={**IMAGING, **changes.pop("imaging", {})},
        **changes,
    )
    return replace(world, asteroid=replace(world.asteroid, centre_m=SHIFT_M))


class _Lost(DrawnSights):
    """Some images show nothing, one a single crater, and one has a detector that sees nothing at all."""

    def drawn(self, view, address):
        found, crater = super().drawn(view, address)
        kept = {2: 0, 3: 1}.get(address.image, len(crater))
        return CraterDetections(found.ellipses[:kept], found.confidence[:kept]), crater[:kept]


def _trials(tmp_path, world, navigators=None, sights=DrawnSights):
    mesh = world.asteroid.mesh
    ground = MeshGround(TriangleMesh(mesh.vertices_m + SHIFT_M, mesh.faces))
    spec = imaging_of(world)
    drawn = sights(spec, ground, draw_plane_craters(ground, spec.craters))
    navigators = navigators or {"vote": CraterNavigation.from_options({"matcher": "vote"})}
    return CraterNavigationTrials(
        scenario="small", methods=navigators, seed=5, world=world, sights=drawn, folder=tmp_path
    )


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    folder = tmp_path_factory.mktemp("chain")
    trials = _trials(folder, _world())
    return folder, trials, trials.run(range(1))


def test_the_chain_comes_to_an_orbit_that_is_far_better_than_the_a_priori_one(done):
    _, _, records = done
    (row,), (orbit,), (chain,) = records["rows"], records["orbits"], records["navigation"]
    assert row["status"] == "ok", row["reason"]
    assert orbit["arc_rms_m"] < 3.0
    assert 0.05 < orbit["epoch_nees"] < 4.0
    assert chain["n_wrong"] < 0.05 * chain["n_correct"]
    assert chain["n_correct"] > 0.6 * chain["n_common"]
    assert chain["n_numbered"] <= chain["n_detections"]
    assert len(records["navigated_images"]) == chain["n_images"] <= 30
    assert sum(line["hits"] for line in records["navigated_landmarks"]) == chain["n_numbered"]
    for table, lines in records.items():
        wanted = {column.name for column in TABLES[table]}
        assert all(set(line) <= wanted for line in lines), table


def test_an_interrupted_chain_goes_on_and_comes_to_the_same(done):
    folder, trials, records = done
    kept = {path: path.stat().st_mtime_ns for path in folder.rglob("*.txt")}
    lost = [path for path in kept if path.name == "landmarks.txt" or path.stem in ("00007", "pairs-00001")]
    assert len(lost) == 3
    for path in lost:
        path.unlink()
    again = trials.run(range(1))
    assert {name: lines for name, lines in again.items() if name != "timings"} == {
        name: lines for name, lines in records.items() if name != "timings"
    }
    untouched = [path for path in kept if path not in lost and path.name != "pictures.txt"]
    assert all(path.stat().st_mtime_ns == kept[path] for path in untouched)


def test_images_without_a_crater_and_with_one_do_not_stop_it(tmp_path):
    records = _trials(tmp_path, _world(imaging={"epochs": 10}), sights=_Lost).run(range(1))
    assert [line["n_detections"] for line in records["navigated_images"]][2:4] == [0, 1]
    assert records["rows"][0]["status"] == "ok"


@pytest.mark.parametrize(("position_m", "count"), [(150.0, 1), (2900.0, 2)])
def test_an_a_priori_orbit_that_is_far_off_is_solved_or_fails_with_its_reason(tmp_path, position_m, count):
    """As 10 km are to 200 km, and into the body: the run goes on either way."""
    far = _world(knowledge={"position_m": position_m}, imaging={"epochs": 14})
    records = _trials(tmp_path, far).run(range(count))
    assert [row["trial"] for row in records["rows"]] == list(range(count))
    assert all(row["status"] == "ok" or (row["status"] == "failed" and row["reason"]) for row in records["rows"])
    for orbit in records.get("orbits", []):
        assert orbit["arc_rms_m"] < 20.0


def test_two_images_that_show_different_ground_fail_with_a_reason(tmp_path):
    two = _world(imaging={"epochs": 2}, asteroid={"rotation_h": 24.0})
    records = _trials(tmp_path, two).run(range(1))
    assert records["rows"][0]["reason"] == "0 sightings are too few: at least 20 are needed"
    assert (records["navigation"][0]["n_images"], records["navigation"][0]["n_pairs"]) == (2, 0)


@pytest.mark.parametrize(
    ("share", "message"),
    [(0.0, "the image is black: no crater can be seen in it"), (0.9, "is saturated at 4095"), (1.0, "4095 all over")],
)
def test_a_black_and_a_saturated_image_have_no_craters_and_a_reason(tmp_path, share, message):
    world = _world(imaging={"epochs": 2})
    taken = NavigationTrial.take(world, _trials(tmp_path, world).sights, 5, 0, StageFiles(tmp_path))
    pixels = np.zeros((world.camera.height_px, world.camera.width_px), dtype=np.float32)
    pixels[: round(share * len(pixels))] = 4095.0
    frame = Frame(pixels, np.array([0.6, 0.0, -0.8]), Pose(np.eye(3), np.zeros(3)), np.eye(6))
    found, reason = CraterNavigation.from_options({}).detect(frame, taken.task)
    assert len(found.ellipses) == 0
    assert message in reason


def test_exposures_have_the_sun_of_their_attitude_and_the_shape_is_where_its_model_is(tmp_path):
    world, stages = _world(imaging={"epochs": 2}), StageFiles(tmp_path)
    taken = NavigationTrial.take(world, _trials(tmp_path, world).sights, 5, 0, stages)
    searched = taken.search(CraterNavigation.from_options({"matcher": "vote"}), taken.task)
    sun = np.array(world.spec.light.sun_dir) / np.linalg.norm(world.spec.light.sun_dir)
    assert len(searched) == 2
    for image, planned in zip(searched, taken.plan, strict=True):
        np.testing.assert_allclose(image.exposure.sun_dir_cam, planned.actual_R_cam_inertial @ sun, atol=1e-9)
    mesh = taken.task.shape.ground.mesh
    middle = trimesh.Trimesh(mesh.vertices_m, mesh.faces, process=False).center_mass
    assert np.linalg.norm(middle - SHIFT_M) < 0.1 * np.linalg.norm(SHIFT_M)


def test_no_craters_at_all_fail_with_a_reason(tmp_path):
    bare = _world(imaging={"errors": {"least_radius_px": 1e3}})
    (row,) = _trials(tmp_path, bare).run(range(1))["rows"]
    assert (row["status"], row["reason"]) == ("failed", "0 sightings are too few: at least 20 are needed")


class _DoubtsOnce(CraterNavigation):
    """Rejects its first orbit whatever it is, and keeps the images of every round as they were placed."""

    def __init__(self, options):
        super().__init__(options)
        self.placed = []

    def _round(self, images, task, wanted_s, stages):
        self.placed.append(images)
        found = super()._round(images, task, wanted_s, stages)
        if len(self.placed) > 1:
            return found
        return replace(found, estimate=replace(found.estimate, status="failed", reason="rejected: on purpose"))


def test_a_rejected_orbit_begins_again_with_images_placed_by_it(tmp_path):
    navigator, world = _DoubtsOnce(NavigationOptions(matcher="vote")), _world(imaging={"epochs": 10})
    trials = _trials(tmp_path, world, {"vote": navigator})
    records = trials.run(range(1))
    (row,), (chain,) = records["rows"], records["navigation"]
    assert (row["status"], chain["rounds"]) == ("ok", 2)
    true = [view.T_cam_body.camera_position_m for view in NavigationTrial.take(
        world, trials.sights, 5, 0, StageFiles(tmp_path / "again")
    ).views]  # fmt: skip
    first, second = (
        np.linalg.norm([image.frame.prior_T_cam_body.camera_position_m for image in placed] - np.array(true), axis=1)
        for placed in navigator.placed
    )
    assert second.max() < first.min()


class _Raises(CraterNavigation):
    def navigate(self, exposures, task, stages):
        raise RuntimeError("on purpose")


def test_a_fault_of_one_chain_leaves_the_others(tmp_path):
    good = CraterNavigation.from_options({"matcher": "vote"})
    world = _world(imaging={"epochs": 8})
    records = _trials(tmp_path, world, {"raises": _Raises(good.options), "vote": good}).run(range(1))
    assert records["rows"][0]["status"] == "error"
    assert "on purpose" in records["tracebacks"][0]["traceback"]
    assert [row["estimator"] for row in records["rows"]] == ["raises", "vote"]
    assert records["rows"][1]["status"] != "error"


def test_two_false_detections_are_never_the_same_crater():
    crater = [np.array([4, NO_CRATER, 6]), np.array([NO_CRATER, 4, 9])]
    told = told_apart(crater)
    assert len(np.intersect1d(told[0], told[1])) == 1
    matches = CraterMatches(np.array([[0, 1], [1, 0], [2, 2]]), np.ones(3))
    numbering = Numbering((np.array([0, 1, 2]), np.array([1, 0, 2])), 0)
    once = NavigationRound((PairMatches(0, 1, matches),), numbering, None, OrbitEstimate("failed", None, "x"))
    assert match_counts(once, crater) == (1, 2, 1)


def test_a_wrong_matcher_is_refused():
    with pytest.raises(BoresightError, match="nonsense"):
        CraterNavigation.from_options({"matcher": "nonsense"})

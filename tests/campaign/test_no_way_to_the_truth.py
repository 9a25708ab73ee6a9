"""Nothing that a method is given leads to the truth, the seed or a folder of the run, and it is the method's own."""

from __future__ import annotations

import inspect
import types
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from orbit_worlds import orbit_world
from test_crater_navigation import _trials, _world
from test_image_tracks import SCENE as IMAGES
from third_party import install_answers
from tiny_campaign import SCENE, Heard, write_campaign

from boresight.campaign.handles import Handle, own_copy
from boresight.campaign.imaging.image_store import Imager, ImageStore
from boresight.campaign.imaging.world import TrialImage, World
from boresight.campaign.kinds import single_image
from boresight.campaign.kinds.orbit_determination import OrbitTrials
from boresight.campaign.kinds.sequence.images import OrbitImages, Watch
from boresight.campaign.products import BuiltAssets
from boresight.campaign.runs.execute import run_campaign
from boresight.campaign.runs.manifest import RunRequest
from boresight.campaign.runs.resolve import resolve
from boresight.campaign.store import RunFolder
from boresight.campaign.trial import runner
from boresight.campaign.trial.runner import require_built
from boresight.estimators.craters.matching.vote import VoteMatcher
from boresight.estimators.registry import estimator_class
from boresight.renderers.mitsuba3 import choose_variant
from boresight.scenarios.cache import default_cache
from boresight.scenarios.craters import CraterTruth
from boresight.scenarios.craters.simulated import CraterPair, CraterView, LabelledDetections
from boresight.scenarios.draw import Stream, estimator_generator, generator
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.orbits.draw import OrbitTruth
from boresight.scenarios.orbits.true_orbit import TrueOrbit
from boresight.scenarios.orbits.world import Asteroid, OrbitWorld
from boresight.scenarios.sequences import CameraTrajectory, SequenceTruth

SEED = 987654321
BEFORE_AFTER = Path(__file__).parents[1] / "before_after" / "campaigns"
PACKAGES = ("campaign", "estimators", "renderers", "scenarios")
INPUTS = (
    *(
        "boresight.scenarios.observation",
        "boresight.scenarios.observation",
        "boresight.scenarios.orbits.data",
        "boresight.estimators.craters.contract",
    ),
    *(
        "boresight.scenarios.geometry.camera",
        "boresight.scenarios.geometry.pose",
        "boresight.scenarios.geometry.ellipse",
    ),
)
"""Modules of the classes of what methods are given."""

TRUTH = (
    *(TrialImage, World, LoadedScenario, ImageStore, Imager, BuiltAssets, RunFolder, Path, OrbitImages),
    *(Watch, SequenceTruth, CameraTrajectory, CraterTruth, CraterPair, CraterView, LabelledDetections, OrbitTruth),
    *(OrbitWorld, Asteroid, TrueOrbit),
)


def attributes(thing: object) -> Iterator[object]:
    """Yield what can be read off an object without a call: attributes, items, and what functions and iterators hold."""
    if isinstance(thing, Mapping):
        yield from (*thing.keys(), *thing.values())
    elif isinstance(thing, (list, tuple, set, frozenset)):
        yield from thing
    elif isinstance(thing, types.MethodType):
        yield from (thing.__self__, thing.__func__)
    elif isinstance(thing, partial):
        yield from (thing.func, thing.args, thing.keywords)
    elif isinstance(thing, types.FunctionType):
        yield from (cell.cell_contents for cell in thing.__closure__ or ())
        yield from (thing.__defaults__, thing.__kwdefaults__, getattr(thing, "__wrapped__", None))
    elif isinstance(thing, types.GeneratorType):
        yield from (inspect.getgeneratorlocals(thing), thing.gi_yieldfrom)
    elif isinstance(thing, property):
        yield from (thing.fget, thing.fset, thing.fdel)
    elif isinstance(thing, np.ndarray):
        yield from (thing.base, getattr(thing, "filename", None))
        return
    if isinstance(thing, type) and not thing.__module__.startswith(
        ("campaign", "estimators", "renderers", "scenarios")
    ):
        return
    yield from getattr(thing, "__dict__", {}).values()
    for kind in type(thing).__mro__:
        for name in np.atleast_1d(vars(kind).get("__slots__", ())).tolist():
            if name != "__weakref__" and hasattr(thing, name):
                yield getattr(thing, name)
    if isinstance(thing, Handle):
        yield from (getattr(thing, name) for name, one in inspect.getmembers(type(thing)) if isinstance(one, property))
    yield type(thing)


def reached(*things: object) -> list[object]:
    """All objects that are reached from some; modules, and with them the names that functions use, are not followed."""
    found: dict[int, object] = {}
    waiting = list(things)
    while waiting:
        one = waiting.pop()
        if id(one) not in found and not isinstance(one, types.ModuleType):
            found[id(one)] = one
            waiting.extend(attributes(one))
    return list(found.values())


def ways_to_the_truth(run: Path, *things: object) -> list[object]:
    """Everything reached that holds the truth, the seed, or the name of a folder of the run or of the cache."""
    folders = (str(run), str(default_cache().root))
    found = []
    for one in reached(*things):
        tells = isinstance(one, str) and any(folder in one for folder in folders)
        counts = isinstance(one, (int, np.integer)) and int(one) == SEED
        seeds = isinstance(one, np.ndarray) and one.dtype.kind in "iu" and bool((one == SEED).any())
        if isinstance(one, TRUTH) or tells or counts or seeds:
            found.append(one)
    return found


def test_the_walker_finds_what_the_leaks_were():
    trial = TrialImage(np.zeros((1, 1), np.float32), None, {})

    def by_closure():
        return trial

    def by_default(one=trial):
        return one

    def by_variable():
        kept = trial
        yield kept

    begun = by_variable()
    next(begun)
    of_a_class = type("Kept", (), {"__module__": "campaign", "kept": trial})
    for way in (
        by_closure,
        by_default,
        begun,
        partial(print, trial),
        of_a_class(),
        {"x": [(trial,)]},
        lambda: by_closure,
    ):
        assert trial in ways_to_the_truth(Path("/no/run"), way), way
    mapped = np.memmap("/dev/zero", np.uint8, "r", shape=(4,))[1:]
    assert ways_to_the_truth(Path("/dev/zero"), mapped)
    assert ways_to_the_truth(Path("/no/run"), np.array([1, SEED]))


def numbers_of(rng: np.random.Generator) -> set[int]:
    """What a generator shows of what it began with."""
    seeds = rng.bit_generator.seed_seq
    entropy = seeds.entropy if isinstance(seeds.entropy, (list, tuple)) else [seeds.entropy]
    state = rng.bit_generator.state["state"]
    return {int(number) for number in (*entropy, *seeds.spawn_key, *state.values())}


def test_the_generator_of_an_estimator_does_not_show_the_seed():
    assert SEED in numbers_of(generator(SEED, Stream.TRUTH, 5))  # what an estimator could read before
    shown = numbers_of(estimator_generator(SEED, 5))
    assert not shown & {SEED, 5, int(Stream.ESTIMATOR)}
    truth = generator(SEED, Stream.TRUTH, 5).random(4)
    for entropy in shown:
        for trial in (0, 5):
            assert not np.array_equal(generator(entropy, Stream.TRUTH, trial).random(4), truth)


def test_the_generator_of_an_estimator_is_its_address():
    draws = {estimator_generator(seed, trial).random() for seed in (0, 1, SEED) for trial in range(50)}
    assert len(draws) == 150
    assert estimator_generator(SEED, 3).random() == estimator_generator(SEED, 3).random()


class Recorder:
    """Keeps a method with all that it is given, and passes it on."""

    def __init__(self, method, given):
        self._method, self._given = method, given

    def __getattr__(self, name):
        attribute = getattr(self._method, name)
        if not callable(attribute):
            return attribute

        def call(*arguments, **named):
            self._given.append((self._method, *arguments, *named.values()))
            return attribute(*arguments, **named)

        return call


def all_that_is_given(monkeypatch, file, out, trials=1):
    """Run a campaign; return, for each call of a method, the method and what it was given."""
    given: list[tuple[object, ...]] = []
    monkeypatch.setattr(runner, "require_built", lambda method: Recorder(require_built(method), given))
    # The one kind whose methods get assets when they are built.
    monkeypatch.setattr(single_image, "estimator_class", lambda name: Recorder(estimator_class(name), given))
    campaign = resolve(str(file), seed=SEED, variant=choose_variant().name)
    run_campaign(campaign, RunRequest(out, trials, 1), Heard())
    rows = RunFolder(out).table("rows")
    assert not rows.loc[rows["status"] == "error", "reason"].tolist()
    return given


def guided(folder: Path) -> Path:
    text = "experiment: sequence\nscenarios: [scene]\nestimators: [dead-reckoning, ekf-slam]\ntrials: 1\nseed: 5\n"
    return write_campaign(folder, text, IMAGES.replace("carry: patch", "guided: true, carry: feature"))


def of_products(folder: Path) -> Path:
    text = """\
scenarios: [scene]
estimators:
  - prior
  - whole-image: {database: {images: 40, min_observations: 6, clusters: {seed_radius_m: 15, sigma_floor_m: 0.1}}}
  - landmark-orb: {database: {images: 10}}
  - lmaps: {maplets: {spacing_m: 15, side: 15}}
trials: 1
seed: 5
"""
    return write_campaign(folder, text, SCENE)


def approaching(folder: Path) -> Path:
    text = (
        "experiment: approach-orbit\nscenarios: [approach-orbit]\nset: {orbit: {imaging: {epochs: 4}}}\n"
        "estimators: [prior, centroid]\ntrials: 1\nseed: 5\n"
    )
    return write_campaign(folder, text, SCENE)


def stored(name: str, folder: Path) -> Path:
    del folder
    return BEFORE_AFTER / f"{name}.yaml"


CASES = {
    "single image": of_products,
    "approach": approaching,
    "guided sequence": guided,
    "sequence": partial(stored, "sequence"),
    "detection": partial(stored, "detection"),
    "matching": partial(stored, "matching"),
}


@pytest.mark.parametrize("case", CASES)
def test_what_a_method_is_given_leads_to_no_truth_and_is_its_own(case, tmp_path, monkeypatch):
    out = tmp_path / "run"
    given = all_that_is_given(monkeypatch, CASES[case](tmp_path / "campaign"), out)
    assert len(given) > 1
    assert len(reached(*given)) > 50
    assert ways_to_the_truth(out, *given) == []
    check_apart(*(arguments for _, *arguments in given))


def check_apart(*several: object) -> None:
    """No array, nor any other object that could be changed, is in what two methods are given."""
    parts = [
        {id(one): one for one in reached(some) if isinstance(one, np.ndarray) or type(one).__module__ in INPUTS}
        for some in several
    ]
    for number, own in enumerate(parts):
        for other in parts[number + 1 :]:
            assert not [own[key] for key in own.keys() & other.keys()]


class Stops:
    """A method that keeps what it is given."""

    def __init__(self, given):
        self.given = given

    def determine(self, *arguments):
        self.given.append(arguments)
        raise InterruptedError("seen enough")


def test_what_an_estimator_of_orbits_is_given_leads_to_no_truth_and_is_its_own(tmp_path):
    given = []
    records = OrbitTrials(
        scenario="small", methods={"a": Stops(given), "b": Stops(given)}, seed=SEED, world=orbit_world()
    ).trial(0)
    assert all("InterruptedError" in row["reason"] for row in records["rows"])
    assert len(reached(*given)) > 50
    assert ways_to_the_truth(tmp_path, *given) == []
    check_apart(*given)


def test_what_a_matcher_of_the_navigation_chain_is_given_leads_to_no_truth(tmp_path, monkeypatch):
    given = []

    def match(self, *arguments):
        given.append((self, *arguments))
        raise InterruptedError("seen enough")

    monkeypatch.setattr(VoteMatcher, "match", match)
    records = _trials(tmp_path / "run", _world(imaging={"epochs": 8})).run(range(1))
    assert "InterruptedError" in records["rows"][0]["reason"]
    assert len(reached(*given)) > 50
    assert ways_to_the_truth(tmp_path / "run", *given) == []


def test_a_front_end_gives_the_same_frames_again(tmp_path, monkeypatch):
    given = all_that_is_given(monkeypatch, guided(tmp_path / "campaign"), tmp_path / "run")
    front_end = given[0][1].front_end
    again = list(front_end.frames(lambda frame: None))
    assert len(again) == len(given[0][1].frames)
    assert all(len(frame.tracks) for frame in again)
    begun = front_end.frames(lambda frame: None)
    first = next(begun)
    assert ways_to_the_truth(tmp_path / "run", begun) == []
    np.testing.assert_array_equal(first.uv_px, again[0].uv_px)


def test_a_copy_keeps_values_layout_and_flags():
    across, seen = np.arange(6.0).reshape(2, 3).T, np.arange(3)
    seen.setflags(write=False)
    one, two = own_copy((across, seen))
    assert one.flags.f_contiguous
    assert one.flags.writeable
    assert not two.flags.writeable
    two.setflags(write=True)
    two[:], one[:] = 7, 7
    assert seen.tolist() == [0, 1, 2]
    assert across.max() == 5.0


CHEATS = """
import json
import numpy as np
from boresight.campaign.imaging.world import open_world
from boresight.estimators.contract import Estimate
from boresight.renderers.mitsuba3 import choose_variant
from boresight.scenarios.geometry import Pose

def from_assets(self, observation):
    assets = self.assets
    seed = json.loads((assets._folder.parent / "manifest.json").read_text())["seed"]
    return open_world(assets._true_scenario, choose_variant().name).source.view(seed, self.trial).T_cam_body

def far_prior(self, observation):
    prior = observation.frame.prior_T_cam_body
    object.__setattr__(prior, "translation_m", prior.translation_m + 1e6)
    observation.frame.image.setflags(write=True)
    observation.frame.image[:] = 0.0
    return Pose(prior.rotation, prior.translation_m - 1e6)

ANSWERS = {
    "from-assets": from_assets,
    "far-prior": far_prior,
    "as-prior": lambda self, observation: observation.frame.prior_T_cam_body,
}

class Method:
    version, trial = 1, -1
    @classmethod
    def from_options(cls, options, assets):
        self = cls()
        self.assets = assets
        return self
    def estimate(self, observation, *, rng):
        self.trial += 1
        light = float(observation.frame.image.sum())
        return Estimate("ok", pose=ANSWERS[self.name](self, observation), diagnostics={"light": light})
"""


def test_an_estimator_can_neither_read_the_truth_nor_change_what_the_next_one_gets(cache, tmp_path, monkeypatch):
    install_answers(tmp_path, "estimators", CHEATS, monkeypatch)
    text = "scenarios: [scene]\nestimators: [far-prior, from-assets, as-prior, prior]\ntrials: 3\nseed: 5\n"
    campaign = resolve(str(write_campaign(tmp_path / "c", text, SCENE)), variant=choose_variant().name)
    run_campaign(campaign, RunRequest(tmp_path / "run", 3, 1), Heard())
    rows = {name: own.reset_index() for name, own in RunFolder(tmp_path / "run").table("rows").groupby("estimator")}
    assert (rows["from-assets"]["status"] == "error").all()
    assert rows["from-assets"]["reason"].str.contains("'EstimatorAssets' object has no attribute '_folder'").all()
    error = rows["as-prior"]["position_error_m"]
    assert error.between(1.0, 1e3).all()
    for name in ("far-prior", "prior"):
        np.testing.assert_allclose(rows[name]["position_error_m"], error, rtol=1e-6)
        np.testing.assert_array_equal(rows[name]["prior_position_error_m"], rows["as-prior"]["prior_position_error_m"])
    light = RunFolder(tmp_path / "run").table("diagnostics").groupby("estimator")["value"].apply(list)
    assert light["as-prior"] == light["far-prior"]
    assert min(light["as-prior"]) > 0.0


PEEKS = """
import numpy as np
from boresight.estimators.slam.contract import FrameEstimate, SequenceEstimate

NONE = np.zeros(0, np.int64), np.zeros((0, 3)), 0.0

def by_closure(sequence):
    return sequence.front_end.frames.__closure__[0].cell_contents

def by_generator(sequence):
    return sequence.front_end.frames(lambda frame: None).gi_frame.f_locals["self"]

ANSWERS = {
    "by-closure": by_closure,
    "by-generator": by_generator,
}

class Method(Base):
    def follow(self, sequence):
        for _ in sequence.front_end.frames(lambda frame: None):
            pass
        poses = ANSWERS[self.name](sequence).path.poses
        return SequenceEstimate("ok", tuple(FrameEstimate(pose.camera_position_m, None, *NONE) for pose in poses))
"""


def test_an_estimator_cannot_read_the_path_off_its_front_end(cache, tmp_path, monkeypatch):
    names = install_answers(tmp_path, "sequence_estimators", PEEKS, monkeypatch)
    file = guided(tmp_path / "c")
    file.write_text(file.read_text().replace("dead-reckoning, ekf-slam", ", ".join(names)))
    run_campaign(resolve(str(file), variant=choose_variant().name), RunRequest(tmp_path / "run", 1, 1), Heard())
    rows = RunFolder(tmp_path / "run").table("rows")
    assert rows["status"].eq("error").all(), rows["position_error_m"].tolist()
    assert rows["reason"].str.contains("raised TypeError|raised AttributeError").all(), rows["reason"].tolist()

"""Nothing that an estimator is handed shows the campaign's seed, or an object that holds the truth."""

from __future__ import annotations

import types
from collections.abc import Iterator

import numpy as np
import pytest
from test_image_tracks import SCENE, ground_of

from campaign.kinds.sequence.images import OrbitImages
from campaign.kinds.sequence.tracks import ImageTracks
from renderers.mitsuba3 import choose_variant
from scenarios.draw import Stream, estimator_generator, generator
from scenarios.load import load_scenario
from scenarios.sequences import CameraTrajectory, SequenceTruth

SEED = 987654321


def attributes(thing: object) -> Iterator[object]:
    """Yield what can be read off an object by its attributes and items, methods' owners included."""
    if isinstance(thing, dict):
        yield from thing.values()
    elif isinstance(thing, (list, tuple, set, frozenset)):
        yield from thing
    elif isinstance(thing, types.MethodType):
        yield thing.__self__
    names = [*getattr(thing, "__dict__", {})]
    names += [name for kind in type(thing).__mro__ for name in np.atleast_1d(getattr(kind, "__slots__", ())).tolist()]
    for name in names:
        if hasattr(thing, name):
            yield getattr(thing, name)


def reached(thing: object) -> list[object]:
    """All objects that are reached from one by attributes and items."""
    found: dict[int, object] = {}
    waiting = [thing]
    while waiting:
        one = waiting.pop()
        if id(one) in found or isinstance(one, (str, bytes, np.ndarray, type, types.ModuleType, types.FunctionType)):
            continue
        found[id(one)] = one
        waiting.extend(attributes(one))
    return list(found.values())


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


@pytest.fixture(scope="module")
def sequence(tmp_path_factory):
    file = tmp_path_factory.mktemp("images") / "scene.yaml"
    file.write_text(SCENE.replace("carry: patch", "guided: true, carry: feature"))
    scenario = load_scenario(str(file))
    images = OrbitImages.open(scenario, choose_variant().name, SEED)
    tracks = ImageTracks(scenario.spec.sequence, ground_of(scenario), images)
    return tracks.watch(SEED, 0).sequence


def test_the_eye_of_a_guided_sequence_shows_no_path_and_no_seed(sequence):
    assert sequence.front_end is not None
    everything = reached(sequence)
    assert len(everything) > 10
    assert not [
        one for one in everything if isinstance(one, (CameraTrajectory, SequenceTruth, OrbitImages, ImageTracks))
    ]
    assert SEED not in [one for one in everything if isinstance(one, int)]
    assert len(next(iter(sequence.front_end.frames(lambda frame: None))).tracks) > 0

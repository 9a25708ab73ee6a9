"""Train the network of the detector ``crater-learned``, and write it beside the detector.

Run as ``python -m training.crater_network``: the same seed gives the same weights on the same machine and
versions (sums of matrix products are rounded as the library's threads divide them).
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

import boresight.estimators.craters.learned as learned
from boresight.estimators.craters.detection.preparation import noise_level, prepare_image
from boresight.estimators.craters.learned.detector import WEIGHTS, CraterLearned, LearnedOptions
from boresight.estimators.craters.learned.network import SHAPES, Network, PatchSource
from boresight.estimators.craters.learned.proposals import propose
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Ellipses
from training.lessons import displaced, joined, lessons_of
from training.network_training import Lessons, Schedule, fresh_network, train
from training.sight import CAMERA, Lesson, draw_lesson

NOTE = "weights.json"
_PROPOSALS = 800  # of each picture: as dense as the detector takes them on images of its usual size


@dataclass(frozen=True, slots=True)
class Course:
    """All that decides the weights.

    Parameters
    ----------
    pictures
        How many are drawn.
    first
        Epochs on proposals of the templates and on displaced rims; what the network then makes of the proposals is
        learned from as well in ``Schedule.epochs``.
    spreads
        Standard deviations of displaced rims, in radii.
    """

    seed: int = 7
    pictures: int = 50
    first: int = 4
    spreads: tuple[float, ...] = (0.04, 0.12)
    schedule: Schedule = field(default_factory=Schedule)


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """A picture, and what the templates propose in it."""

    lesson: Lesson
    source: PatchSource
    proposals: Ellipses


def see(seed: int, number: int, options: LearnedOptions) -> Seen | None:
    """Draw a picture by its own stream; None where its ground lies in the dark."""
    lesson = draw_lesson(np.random.default_rng([seed, number]))
    try:
        picture = prepare_image(lesson.frame, CAMERA, options.window_px)
    except BoresightError:
        return None
    noise = noise_level(lesson.frame.image, picture.ground)
    source = PatchSource.of(lesson.frame.image, picture, lesson.frame.sun_dir_cam, noise)
    proposals = propose(picture, options.levels, options.merit_min, options.proposals).ellipses
    return Seen(lesson, source, proposals)


def lessons_from(seen: list[Seen], course: Course, rng: np.random.Generator, network: Network | None) -> Lessons:
    """Collect lessons of proposals, of displaced rims, and of the places where a network would put proposals."""
    parts = []
    for one in seen:
        rims, weight = one.lesson.rims, one.lesson.weight
        plain = rims[weight > 0.0]
        looks = [one.proposals, *(displaced(plain, one.source.sun_px, s, rng) for s in course.spreads)]
        if network is not None:
            detector = CraterLearned(LearnedOptions(rounds=1, mirror=False), network)
            looks.append(detector.refine_proposals(one.source, one.proposals)[0])
        parts += [lessons_of(one.source, look, rims, weight) for look in looks if len(look)]
    return joined(parts)


def run_course(course: Course, say: Callable[[str], None]) -> Network:
    """Draw pictures and train."""
    seen = []
    for number in range(course.pictures):
        one = see(course.seed, number, LearnedOptions(proposals=_PROPOSALS))
        seen += [] if one is None else [one]
        if number % 10 == 9:
            say(f"{number + 1} pictures")
    return learn(seen, course, say)


def learn(seen: list[Seen], course: Course, say: Callable[[str], None]) -> Network:
    """Train on pictures: first on what the templates propose, then on what the network makes of it, from the start."""
    rng = np.random.default_rng([course.seed, course.pictures])

    def told(epoch: int, loss: float, _: Network) -> None:
        say(f"epoch {epoch + 1}: loss {loss:.4f}")

    short = Schedule(epochs=course.first)
    network = train(fresh_network(rng), lessons_from(seen, course, rng, None), short, rng, told)
    lessons = lessons_from(seen, course, rng, network)
    say(f"{len(lessons.crater)} lessons, {100 * float(np.mean(lessons.crater)):.0f} % craters")
    return train(fresh_network(rng), lessons, course.schedule, rng, told)


def digest(network: Network) -> str:
    """Digest (hexadecimal SHA-256) of the weights as they are stored."""
    found = hashlib.sha256()
    for name in SHAPES:
        found.update(np.ascontiguousarray(network.weights[name].astype(np.float16)).tobytes())
    return found.hexdigest()


def write(network: Network, course: Course, seconds: float, folder: Path) -> None:
    """Write the weights, in half precision, and a note of how they were made."""
    np.savez_compressed(folder / WEIGHTS, **{name: network.weights[name].astype(np.float16) for name in SHAPES})  # type: ignore[arg-type]
    note = {
        "made by": "PYTHONPATH=tests python -m training.crater_network",
        "course": asdict(course),
        "numpy": np.__version__,
        "minutes of one core": round(seconds / 60.0, 1),
        "sha256": digest(network),
    }
    (folder / NOTE).write_text(json.dumps(note, indent=1) + "\n", encoding="utf-8")


def main(arguments: list[str] | None = None) -> int:
    """Train as the arguments say."""
    parser = argparse.ArgumentParser(prog="python -m training.crater_network", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(learned.__file__).parent, help="folder of the weights")
    parser.add_argument("--pictures", type=int, default=Course().pictures)
    parser.add_argument("--epochs", type=int, default=Schedule().epochs)
    parser.add_argument("--seed", type=int, default=Course().seed)
    told = parser.parse_args(arguments)
    course = Course(seed=told.seed, pictures=told.pictures, schedule=Schedule(epochs=told.epochs))
    started = time.process_time()

    def say(line: str) -> None:
        sys.stdout.write(line + "\n")

    with threadpool_limits(1):
        network = run_course(course, say)
    write(network, course, time.process_time() - started, told.out)
    sys.stdout.write(f"{told.out / WEIGHTS}: {digest(network)}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())

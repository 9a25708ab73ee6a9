"""Scores of crater navigation before the orbit: images, matches, numbers and landmarks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from boresight.campaign.kinds.crater_navigation.images import NavigationTrial, SearchedImage
from boresight.estimators.craters.navigation.rounds import NavigationResult, NavigationRound
from boresight.estimators.orbit.contract import OrbitEstimate
from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.craters.simulated import NO_CRATER
from boresight.scenarios.orbits.data import OrbitData
from boresight.scenarios.orbits.draw import OrbitTruth
from boresight.scenarios.orbits.true_orbit import DAY_S
from boresight.scenarios.orbits.world import OrbitWorld

Record = dict[str, object]


def told_apart(crater: Sequence[IndexArray]) -> list[IndexArray]:
    """Give each detection that is no crater a negative number of its own: two of them are never the same."""
    told, lowest = [], NO_CRATER
    for one in crater:
        own, none = one.copy(), np.flatnonzero(one == NO_CRATER)
        own[none] = lowest - np.arange(len(none))
        lowest -= len(none)
        told.append(own)
    return told


def match_counts(done: NavigationRound, crater: Sequence[IndexArray]) -> tuple[int, int, int]:
    """Count correct and wrong matches, and craters that two matched images have in common."""
    told, correct, wrong, common = told_apart(crater), 0, 0, 0
    for pair in done.found:
        here, there = told[pair.first], told[pair.second]
        same = here[pair.matches.pairs[:, 0]] == there[pair.matches.pairs[:, 1]]
        correct, wrong = correct + int(same.sum()), wrong + int((~same).sum())
        common += len(np.intersect1d(here, there))
    return correct, wrong, common


def sighted_craters(done: NavigationRound, crater: Sequence[IndexArray]) -> IndexArray:
    """(K,) true crater of each sighting of the data base, by its image and its number."""
    told = told_apart(crater)
    of = {
        (image, int(number)): int(true)
        for image, (numbers, own) in enumerate(zip(done.numbering.numbers, told, strict=True))
        for number, true in zip(numbers, own, strict=True)
        if number >= 0
    }
    seen = zip(done.data.pictures.image.tolist(), done.data.pictures.landmark.tolist(), strict=True)
    return np.array([of[one] for one in seen], dtype=np.int64)


def truth_of_sightings(
    world: OrbitWorld, trial: NavigationTrial, done: NavigationRound, crater: Sequence[IndexArray]
) -> OrbitTruth:
    """Put together what the score of an orbit asks for."""
    true = sighted_craters(done, crater)
    return OrbitTruth(
        states=trial.flown.wanted_states,
        image_states=trial.flown.image_states,
        crater=true,
        wrong=true < 0,
        points_body_m=np.zeros((0, 3)),
        gm_m3_s2=world.spec.asteroid.gm_m3_s2,
        light_m_s2=world.light_m_s2,
    )


def at_times(estimate: OrbitEstimate, data: OrbitData, wanted_s: FloatArray) -> tuple[OrbitEstimate, OrbitData]:
    """Leave out of an orbit the times that are not among (E,) wanted ones; all of these were asked for."""
    rows = np.searchsorted(data.wanted_s, wanted_s)
    orbit = estimate.orbit
    if orbit is not None:
        orbit = replace(
            orbit,
            positions_m=orbit.positions_m[rows],
            velocities_m_s=orbit.velocities_m_s[rows],
            position_covariances_m2=orbit.position_covariances_m2[rows],
        )
    return replace(estimate, orbit=orbit), replace(data, wanted_s=wanted_s)


def navigation_summary(navigation: NavigationResult, searched: Sequence[SearchedImage], epochs: int) -> Record:
    """Sum the chain up: the columns of the table ``navigation`` without its key."""
    crater, last = [image.crater for image in searched], navigation.rounds[-1]
    correct, wrong, common = match_counts(last, crater)
    numbers = last.numbering.numbers
    return {
        "rounds": len(navigation.rounds),
        "epochs": epochs,
        "n_images": len(searched),
        "n_blind": sum(bool(image.reason) for image in searched),
        "n_detections": sum(len(one) for one in crater),
        "n_false": sum(int((one == NO_CRATER).sum()) for one in crater),
        "n_pairs": len(last.found),
        "n_correct": correct,
        "n_wrong": wrong,
        "n_common": common,
        "n_conflicts": last.numbering.conflicts,
        "n_numbered": sum(int((one >= 0).sum()) for one in numbers),
        "n_landmarks": last.numbering.count,
    }


def image_records(trial: NavigationTrial, searched: Sequence[SearchedImage], last: NavigationRound) -> list[Record]:
    """List the images: the columns of the table ``navigated_images`` without its key."""
    records: list[Record] = []
    for planned, view, image, numbers in zip(trial.plan, trial.views, searched, last.numbering.numbers, strict=True):
        records.append(
            {
                "image": planned.number,
                "time_days": planned.time_s / DAY_S,
                "kind": planned.kind,
                "phase_deg": float(np.degrees(view.phase_angle_rad)),
                "n_detections": len(image.crater),
                "n_false": int((image.crater == NO_CRATER).sum()),
                "n_numbered": int((numbers >= 0).sum()),
                "reason": image.reason,
            }
        )
    return records


def landmark_records(data: OrbitData, crater: IndexArray, used: BoolArray | None) -> list[Record]:
    """List the landmarks of the data base: the columns of the table ``navigated_landmarks`` without its key.

    ``crater`` is (K,) the true one of each sighting; ``used`` (K,) tells which of them the orbit rests on, None without
    an orbit.
    """
    records: list[Record] = []
    times = data.pictures.times_s[data.pictures.image] / DAY_S
    for number in data.landmarks.numbers:
        rows = np.flatnonzero(data.pictures.landmark == number)
        craters, counts = np.unique(crater[rows], return_counts=True)
        records.append(
            {
                "landmark": int(number),
                "hits": len(rows),
                "crater": max(int(craters[np.argmax(counts)]), NO_CRATER),
                "n_other": len(rows) - int(counts.max()),
                "n_used": None if used is None else int(used[rows].sum()),
                "first_days": float(times[rows].min()),
                "last_days": float(times[rows].max()),
            }
        )
    return records

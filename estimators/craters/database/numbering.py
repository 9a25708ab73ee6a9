"""Numbering of craters: one number for one crater over all images, from the matches of pairs of images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from boresight.estimators.craters.contract import CraterMatches
from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.errors import BoresightError

NO_NUMBER = -1


@dataclass(frozen=True, slots=True, eq=False)
class PairMatches:
    """The matches of two images, given by their places in the sequence."""

    first: int
    second: int
    matches: CraterMatches


@dataclass(frozen=True, slots=True, eq=False)
class Numbering:
    """Numbers of the detections of all images.

    ``numbers`` has for each image the numbers of its detections, ``NO_NUMBER`` if a detection has no match. No number
    occurs twice in an image. They count from 0 in the order of the images. ``conflicts`` counts the matches that were
    refused, because they would have given two detections of an image one number.
    """

    numbers: tuple[IndexArray, ...]
    conflicts: int

    @property
    def count(self) -> int:
        """Return how many craters have a number."""
        return 1 + max((int(one.max(initial=NO_NUMBER)) for one in self.numbers), default=NO_NUMBER)

    def hits(self) -> IndexArray:
        """Return (count,) the number of images of each crater."""
        together = np.concatenate([*self.numbers, np.zeros(0, dtype=np.int64)])
        return np.bincount(together[together >= 0], minlength=self.count)


def number_craters(sizes: Sequence[int], found: Sequence[PairMatches]) -> Numbering:
    """Assign numbers to the craters of images with ``sizes`` detections each.

    Matches are joined into groups in the order of reliability: first those confirmed by most other images (both
    detections matched with the same third one), among equals those with the higher score. A match that would bring two
    detections of an image into one group is a conflict: it is refused and counted. Raise BoresightError if a match
    refers to an image or a detection that does not exist.
    """
    starts = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    edges, scores = _all_pairs(starts, found)
    image_of = np.repeat(np.arange(len(sizes)), np.diff(starts))
    # The row is the last key, so that the order is the same on every machine.
    order = np.lexsort((np.arange(len(edges)), -scores, -_confirmations(edges, len(image_of))))
    groups, conflicts = _join_groups(edges[order], image_of)
    numbers = _numbers_of_groups(groups)
    return Numbering(tuple(numbers[a:b] for a, b in pairwise(starts)), conflicts)


def _all_pairs(starts: IndexArray, found: Sequence[PairMatches]) -> tuple[IndexArray, FloatArray]:
    """Return all matches as pairs (e, 2) of detections counted over all images, and their scores (e,)."""
    sizes, parts = np.diff(starts), [np.zeros((0, 2), dtype=np.int64)]
    for one in found:
        images = np.array([one.first, one.second])
        if images.min() < 0 or images.max() >= len(sizes) or one.first == one.second:
            raise BoresightError(f"matches of images {one.first} and {one.second}: there are {len(sizes)} images")
        pairs = one.matches.pairs
        if len(pairs) and (pairs.min() < 0 or (pairs >= sizes[images]).any()):
            raise BoresightError(f"matches of images {one.first} and {one.second} name a detection that there is not")
        parts.append(pairs + starts[images])
    return np.concatenate(parts), np.concatenate([np.zeros(0), *(one.matches.score for one in found)])


def _confirmations(edges: IndexArray, count: int) -> IndexArray:
    """Return (e,) the number of third detections with which both ends of each match are matched."""
    # A wrong match is rarely repeated in a third image: triangles of matches are the more reliable ones.
    others: list[set[int]] = [set() for _ in range(count)]
    for a, b in edges.tolist():
        others[a].add(b)
        others[b].add(a)
    return np.array([len(others[a] & others[b]) for a, b in edges.tolist()], dtype=np.int64)


def _join_groups(edges: IndexArray, image_of: IndexArray) -> tuple[list[list[int]], int]:
    """Join detections into groups in the order of the matches; return the groups and the number of refused matches."""
    group_of = list(range(len(image_of)))
    members = [[k] for k in range(len(image_of))]
    images = [{int(image)} for image in image_of]
    conflicts = 0
    for a, b in edges.tolist():
        one, other = group_of[a], group_of[b]
        if one == other:
            continue
        # A crater is seen at most once in an image.
        if images[one] & images[other]:
            conflicts += 1
            continue
        # Union by size: each detection changes its group at most log2(n) times.
        if len(members[one]) < len(members[other]):
            one, other = other, one
        for k in members[other]:
            group_of[k] = one
        members[one] += members[other]
        images[one] |= images[other]
        members[other] = []
    return members, conflicts


def _numbers_of_groups(groups: Sequence[Sequence[int]]) -> IndexArray:
    """Assign numbers to the groups of two and more in the order of their first detection."""
    numbers = np.full(sum(map(len, groups)), NO_NUMBER, dtype=np.int64)
    # In the order of their first detections, whatever the order in which groups were joined.
    matched = sorted((sorted(group) for group in groups if len(group) > 1), key=lambda group: group[0])
    for number, group in enumerate(matched):
        numbers[group] = number
    return numbers

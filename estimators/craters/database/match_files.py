"""The file of image pairs and of the craters that they have in common: text, one record a line.

::

    # boresight crater matches 1
    pair FIRST SECOND REASON
    match FIRST SECOND ROW ROW SCORE

Images are told by their places in the sequence, craters by their rows in the images' files of craters. ``REASON`` says
why a pair was rejected, its words joined by underscores; ``-`` where it was not. Matches follow their pair.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from estimators.craters.contract import CraterMatches
from estimators.craters.database.numbering import PairMatches
from estimators.craters.database.records import Record, read_records, words, write_records

_HEAD = "boresight crater matches 1"


def write_matches(path: Path, found: Sequence[PairMatches]) -> None:
    """Write what a matcher said of pairs of images, whole or not at all."""
    lines = []
    for pair in found:
        images = (pair.first, pair.second)
        lines.append(words("pair", *images, "_".join(pair.matches.reason.split()) or "-"))
        for (here, there), score in zip(pair.matches.pairs.tolist(), pair.matches.score, strict=True):
            lines.append(words("match", *images, here, there, score))
    write_records(path, _HEAD, lines)


def read_matches(path: Path) -> tuple[PairMatches, ...]:
    """Read what a matcher said of pairs of images.

    Raises
    ------
    BoresightError
        With file and line: a record is malformed, a match does not follow its pair, or a pair stands twice.
    """
    heads: list[Record] = []
    rows: list[list[Record]] = []
    seen: set[tuple[int, int]] = set()
    for record in read_records(path, _HEAD, {"pair": 3, "match": 5}):
        images = (record.integer(0), record.integer(1))
        if record.kind == "pair":
            if images in seen:
                raise record.wrong(f"images {images[0]} and {images[1]} stand twice")
            seen.add(images)
            heads.append(record)
            rows.append([])
        elif not heads or (heads[-1].integer(0), heads[-1].integer(1)) != images:
            raise record.wrong(f"a match of images {images[0]} and {images[1]} does not follow that pair")
        else:
            rows[-1].append(record)
    return tuple(_pair(head, own) for head, own in zip(heads, rows, strict=True))


def _pair(head: Record, rows: Sequence[Record]) -> PairMatches:
    pairs = np.array([[row.integer(2), row.integer(3)] for row in rows], dtype=np.int64).reshape(-1, 2)
    score = np.array([row.numbers(4, 5)[0] for row in rows], dtype=np.float64)
    reason = "" if head.fields[2] == "-" else head.fields[2].replace("_", " ")
    return PairMatches(head.integer(0), head.integer(1), CraterMatches(pairs, score, reason))

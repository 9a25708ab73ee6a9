"""What is fuzzed: a reader, small valid files to begin with, and words that hurt it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Target:
    """One reader.

    Parameters
    ----------
    read
        Takes the content of a file and an empty folder to lay it in; whatever the reader returns is used a little, as
        the next step of a run would.
    seeds
        Makes small valid files.
    words
        What is put in beside the common words of `mutations`.
    cost
        By how much fewer inputs the fast tests give it than others, as each takes long.
    """

    read: Callable[[bytes, Path], object]
    seeds: Callable[[], tuple[bytes, ...]]
    words: tuple[bytes, ...] = ()
    cost: int = 1

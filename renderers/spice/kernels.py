"""The kernel pool of SPICE, which is one for the whole process: lent to one image set at a time."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import spiceypy
from numpy.typing import NDArray
from spiceypy.utils.exceptions import NotFoundError, SpiceyError

from renderers.spice.daf import check_binary
from scenarios.errors import BoresightError
from scenarios.limits import LARGEST_NUMBER

SPICE_ERRORS = (SpiceyError, NotFoundError)
_POOL = threading.Lock()


@contextmanager
def loaded(paths: Sequence[Path]) -> Iterator[None]:
    """Load kernels in the order given, where a later one overrides an earlier; unload them whatever happens.

    The pool is locked meanwhile: another thread waits, and another process has a pool of its own. What SPICE
    complains about inside becomes a `BoresightError` of one line.

    Raises
    ------
    BoresightError
        If a kernel is missing or is none, or SPICE signals an error inside.
    """
    with _POOL:
        done: list[Path] = []
        try:
            for path in paths:
                _load(path)
                done.append(path)
            yield
        except SPICE_ERRORS as error:
            raise BoresightError(f"SPICE: {complaint(error)}") from error
        finally:
            for path in reversed(done):
                spiceypy.unload(str(path))


def _load(path: Path) -> None:
    if not path.is_file():
        raise BoresightError(f"{path}: no such kernel")
    if path.suffix.lower() == ".tm":
        raise BoresightError(
            f"{path}: name the kernels themselves instead of this meta-kernel, whose paths start where a program runs"
        )
    try:
        check_binary(path)
    except (OSError, ValueError) as error:
        raise BoresightError(f"{path}: not a kernel that SPICE reads: {error}") from error
    try:
        spiceypy.furnsh(str(path))
    except SpiceyError as error:
        raise BoresightError(f"{path}: not a kernel that SPICE reads: {complaint(error)}") from error


def complaint(error: Exception) -> str:
    """Return what SPICE has to say as one line."""
    parts = (getattr(error, "short", ""), getattr(error, "long", ""))
    said = " ".join(" ".join(str(part).split()) for part in parts if part)
    return said or " ".join(str(error).split())


@dataclass(frozen=True, slots=True)
class Constants:
    """Constants of an instrument in the loaded pool.

    Parameters
    ----------
    kernel_id
        NAIF's number of the instrument.
    """

    kernel_id: int

    def numbers(self, name: str, count: int) -> NDArray[np.float64]:
        """Return the ``count`` numbers under ``INS<id>_<name>``.

        Raises
        ------
        BoresightError
            If no loaded kernel has them, they are not so many, or one of them is far too large.
        """
        key = f"INS{self.kernel_id}_{name}"
        try:
            values = np.array(spiceypy.gdpool(key, 0, 100), dtype=np.float64)
        except SPICE_ERRORS as error:
            raise BoresightError(f"{key}: not in the kernels: name the instrument kernel and its addendum") from error
        if len(values) != count or not (np.abs(values) <= LARGEST_NUMBER).all():
            said = "one number" if count == 1 else f"{count} numbers"
            raise BoresightError(f"{key}: {values.tolist()} is not {said} of any use: check the instrument kernel")
        return values

    def number(self, name: str) -> float:
        """Return the one number under ``INS<id>_<name>``."""
        return float(self.numbers(name, 1)[0])

    def above_zero(self, name: str) -> float:
        """Return the one number under ``INS<id>_<name>``, which must be above 0.

        Raises
        ------
        BoresightError
            If it is not.
        """
        value = self.number(name)
        if not value > 0.0:
            raise BoresightError(f"INS{self.kernel_id}_{name}: {value:g} is not above 0: check the instrument kernel")
        return value

"""Validation of results before they are scored: types, shapes, and finite numbers of a possible size.

Scoring must not fail on what passes here, and what it works out must be finite: its own faults are no estimator's.
Types are exact: the methods of a subclass could read the truth while scoring compares it with the answer.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

MOST = 1e15
"""No answer has a larger length, velocity or pixel (SI): beyond it squares and their sums could overflow."""

_LONGEST_REASON = 2000
_LONGEST_NAME = 200
_SYMMETRIC = 1e-3
"""Halves of a covariance differ by rounding at most, as a share of its largest number."""

_SEMIDEFINITE = 1e-6
"""No eigenvalue of a correlation matrix is below minus this: n times the rounding of single precision (7e-7 for n = 6),
in which a method may compute."""


def check_type(answer: object, kind: type) -> None:
    """Refuse what is no ``kind``, or of a subclass of it.

    All checks here raise `ValueError` with what is wrong.
    """
    if type(answer) is not kind:
        raise ValueError(f"a {type(answer).__name__} is no {kind.__name__}")


def check_status(status: object, reason: object) -> None:
    """Refuse a status that is none, a failure without a reason, and a success with one."""
    if status not in ("ok", "failed"):
        raise ValueError(f"status is {status!r}, not ok or failed")
    check_reason(reason)
    if (status == "failed") != bool(reason):
        raise ValueError(f"a{'n' * (status == 'ok')} {status} estimate gives as its reason {reason!r}")


def check_reason(reason: object) -> None:
    """Refuse a reason that is no text, or a book."""
    if not isinstance(reason, str) or len(reason) > _LONGEST_REASON:
        shown = reason if not isinstance(reason, str) else f"{len(reason)} characters"
        raise ValueError(f"the reason is {shown!r}, not a line of text")


def check_name(what: str, name: object) -> None:
    """Refuse a name that is not one short line of printable text: it goes into tables, pages and the terminal."""
    if not isinstance(name, str) or not name.isprintable() or not 0 < len(name) <= _LONGEST_NAME:
        raise ValueError(f"{what} has the name {repr(name)[:_LONGEST_NAME]}, not a short line of printable text")


def check_array(what: str, array: object, shape: tuple[int, ...], most: float = MOST) -> None:
    """Refuse an array of another shape, or one that does not hold finite real numbers up to ``most``."""
    given = _array(what, array)
    if given.shape != shape or given.dtype.kind not in "biuf" or not np.isfinite(given).all():
        raise ValueError(f"{what} of shape {given.shape} is not {shape} of finite numbers")
    if given.size and np.abs(given.astype(np.float64)).max() > most:
        raise ValueError(f"{what} has a number beyond {most:g}")


def check_covariance(what: str, array: object, size: int) -> None:
    """Refuse what is no symmetric positive semidefinite array (size, size) of finite numbers, but for rounding."""
    check_array(what, array, (size, size), MOST**2)
    matrix = np.asarray(array, dtype=np.float64)
    if np.abs(matrix - matrix.T).max() > _SYMMETRIC * np.abs(matrix).max():
        raise ValueError(f"{what} is not symmetric")
    check_semidefinite(what, matrix[None])


def check_semidefinite(what: str, matrices: NDArray[np.float64]) -> None:
    """Refuse symmetric (n, size, size) matrices of which one has a negative variance or eigenvalue, but for rounding.

    Eigenvalues are those of the correlations: units of one covariance may differ by orders of magnitude.
    """
    variances = np.diagonal(matrices, axis1=1, axis2=2)
    if variances.min(initial=0.0) < 0.0:
        raise ValueError(f"{what} has a negative variance: {variances.min():g}")
    # What is known perfectly has no variance, and no covariance with anything else.
    scale = 1.0 / np.sqrt(np.where(variances > 0.0, variances, 1.0))
    correlations = 0.5 * (matrices + np.swapaxes(matrices, 1, 2)) * scale[:, :, None] * scale[:, None, :]
    least = np.linalg.eigvalsh(correlations).min(initial=0.0)
    if least < -_SEMIDEFINITE:
        raise ValueError(f"{what} is not positive semidefinite: its correlations have the eigenvalue {least:.3g}")


def check_several(what: str, answer: object) -> None:
    """Refuse what is neither a tuple nor a list: it could end, or be another, when it is asked again."""
    if type(answer) not in (tuple, list):
        raise ValueError(f"{what} are a {type(answer).__name__}, not a tuple")


def check_names(what: str, answer: object) -> None:
    """Refuse what is no mapping by names."""
    if not isinstance(answer, Mapping) or not all(isinstance(name, str) for name in answer):
        raise ValueError(f"{what} of type {type(answer).__name__} have no names")
    for name in answer:
        check_name(what, name)


def check_indices(what: str, array: object, shape: tuple[int, ...]) -> None:
    """Refuse what is no array of whole numbers of a shape."""
    given = _array(what, array)
    if given.shape != shape or (given.dtype.kind not in "iu" and given.size):
        raise ValueError(f"{what} of shape {given.shape} and type {given.dtype} is not {shape} of whole numbers")


def _array(what: str, array: object) -> NDArray[np.generic]:
    if type(array) is not np.ndarray:
        raise ValueError(f"{what} is a {type(array).__name__}, not an array")
    return array


def check_numbers(
    numbers: Mapping[str, float | int | str], what: str, texts: bool = False, least: float = -MOST
) -> None:
    """Refuse a table of numbers by name in which one is not from ``least`` to `MOST` or, where it may be, a text."""
    check_names(what, numbers)
    for name, value in numbers.items():
        if texts and isinstance(value, str):
            continue
        _check_number(f"{what}: {name}", value, least)


def check_seconds(seconds: Mapping[str, float], what: str) -> None:
    """Refuse times in which one is no number, or negative: the clock that they are taken with does not go back."""
    check_numbers(seconds, what, least=0.0)


def _check_number(what: str, value: float | int | str, least: float) -> None:
    try:
        number = None if isinstance(value, str) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = None
    if number is None:
        raise ValueError(f"{what} is {type(value).__name__}, not a number")
    if not np.isfinite(number):
        raise ValueError(f"{what} is {value}")
    if not least <= number <= MOST:
        raise ValueError(f"{what} is {number:g}, not a number from {least:g} to {MOST:g}")

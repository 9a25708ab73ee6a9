"""The images of a data base, spread over worker processes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from campaign.machine import use_threads
from campaign.pool.workers import in_order

T = TypeVar("T")

IN_THIS_PROCESS = 0
"""In place of a number of jobs, where this is a worker that has its threads already."""

_CHUNK_IMAGES = 10


def over_images(jobs: int, images: int, function: Callable[..., list[T]], *arguments: object) -> list[T]:
    """Return what ``function(*arguments, numbers)`` makes of the images of each list of numbers, all in order.

    Parameters
    ----------
    jobs
        Workers, or ``IN_THIS_PROCESS``.
    images
        Their count; numbers begin at 0.
    function
        A function of a module, so that it can be sent to a worker; it returns as many results as it gets numbers.
    arguments
        Its first ones, the same for all.
    """
    chunks = [range(i, min(i + _CHUNK_IMAGES, images)) for i in range(0, images, _CHUNK_IMAGES)]
    if jobs == IN_THIS_PROCESS:
        return [result for chunk in chunks for result in function(*arguments, chunk)]
    calls = ((jobs, function, arguments, chunk) for chunk in chunks)
    return [result for chunk in in_order(jobs, _in_worker, calls) for result in chunk]


def _in_worker(
    jobs: int, function: Callable[..., list[T]], arguments: tuple[object, ...], numbers: Sequence[int]
) -> list[T]:
    use_threads(jobs)
    return function(*arguments, numbers)

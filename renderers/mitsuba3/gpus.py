"""NVIDIA's GPUs: how many there are, and which a process is to use."""

from __future__ import annotations

import ctypes
import os

CHOSEN = "CUDA_VISIBLE_DEVICES"
"""The variable by which NVIDIA's driver is told which GPUs a process may use."""


def nvidia_gpus() -> tuple[int, str]:
    """Count NVIDIA's GPUs by asking the driver; with 0, why there is none."""
    count = ctypes.c_int(0)
    try:
        driver = ctypes.CDLL("libcuda.so.1")
        ctypes.CDLL("libnvoptix.so.1")
    except OSError as error:
        return 0, f"no NVIDIA driver with OptiX ({error})"
    if driver.cuInit(0) != 0 or driver.cuDeviceGetCount(ctypes.byref(count)) != 0 or count.value == 0:
        return 0, "the NVIDIA driver finds no GPU"
    return count.value, ""


def gpu_names() -> tuple[str, ...]:
    """Name the GPUs as the driver's variable does: those that it leaves to this process, or else all."""
    chosen = os.environ.get(CHOSEN)
    if chosen is not None:
        return tuple(name.strip() for name in chosen.split(",") if name.strip())
    return tuple(str(number) for number in range(nvidia_gpus()[0]))


def gpu_of_worker(place: int) -> dict[str, str]:
    """Return what a worker's environment has to say for it to render on a GPU of its own; nothing of a single GPU.

    Dr.Jit takes the first GPU that it is shown, so that without this all workers would share that one.

    Parameters
    ----------
    place
        Number of the worker among those at work, from 0; with more workers than GPUs they take turns.
    """
    names = gpu_names()
    return {CHOSEN: names[place % len(names)]} if len(names) > 1 else {}

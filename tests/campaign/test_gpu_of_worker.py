"""Each worker renders on a GPU of its own, told by the driver's own variable."""

from __future__ import annotations

import os
import time

import pytest

from boresight.campaign import threads
from boresight.campaign.machine import cores
from boresight.campaign.pool import workers as parallel
from boresight.campaign.threads import workers
from boresight.renderers.mitsuba3 import variant
from boresight.renderers.mitsuba3.variant import CUDA, LLVM


def told(wait_s: float) -> tuple[int, str | None]:
    time.sleep(wait_s)
    return os.getpid(), os.environ.get(variant.VISIBLE_GPUS)


@pytest.mark.parametrize(
    ("chosen", "expected"), [("0,3", {"0", "3"}), pytest.param("2", {"2"}, marks=pytest.mark.long)]
)
def test_workers_share_the_gpus_out(monkeypatch, chosen, expected):
    rested = parallel._IdleWorkers()
    monkeypatch.setattr(parallel, "_idle_workers", lambda: rested)
    monkeypatch.setenv(variant.VISIBLE_GPUS, chosen)
    found = set(parallel.in_order(2, told, [(0.05,)] * 8))
    again = set(parallel.in_order(2, told, [(0.05,)] * 8))
    for worker in rested.taken(2):
        worker.close(kill=True)
    assert len(found) == 2, "two processes, each with one answer throughout"
    assert {name for _, name in found} == expected
    assert again == found, "they rest, and go on with the GPU that they have"


def test_there_are_as_many_workers_as_gpus_or_cores(monkeypatch):
    monkeypatch.setenv(variant.VISIBLE_GPUS, "0, 1,2")
    assert workers(None, CUDA) == 3
    assert workers(None, LLVM) == cores()
    assert workers(7, CUDA) == 7
    monkeypatch.delenv(variant.VISIBLE_GPUS)
    monkeypatch.setattr(variant, "nvidia_gpus", lambda: (2, ""))
    assert variant.gpu_names() == ("0", "1")
    assert [variant.gpu_of_worker(place)[variant.VISIBLE_GPUS] for place in range(3)] == ["0", "1", "0"]
    monkeypatch.setattr(variant, "nvidia_gpus", lambda: (0, "the NVIDIA driver finds no GPU"))
    assert variant.gpu_of_worker(0) == {}
    assert threads.workers(None, CUDA) == 1

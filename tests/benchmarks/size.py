"""The largest report and the making and opening of a large body, with the memory that they take at most."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

from stored_grids import store_thousand

from benchmarks.ratio import Absent, Ratio
from benchmarks.scene import SpeedScene, speed_body
from benchmarks.timing import YARDSTICK, Settings, timed, yardstick
from boresight.campaign.runs.benchmark import one_core
from boresight.renderers.mitsuba3 import choose_variant, limit_threads
from boresight.reports.pages.build import write_report
from boresight.scenarios.bodies import Body, load_body
from boresight.scenarios.cache import Cache

REPORT_WORK = "report of 1,000 scenarios and 50 methods"
_STATUS = Path("/proc/self/status")
_PEAK = "VmHWM:"
_REPORT_AIM, _BODY_AIM = "2 GiB", "4 GiB at 21 M facets"
_WARM_FACETS, _CACHE_BYTES, _YARDSTICKS = 20_000, 10**12, 5


def size_ratios(settings: Settings) -> Iterator[Ratio | Absent]:
    """Do each work once, in a process of its own on one core, between several yardsticks.

    The body is made into an empty cache, after a small one for which kernels are compiled, and opened from there: read,
    and the tree of its facets built for the renderer.
    """
    if not _STATUS.is_file():
        yield Absent("size", f"the peak of a process's memory is read from {_STATUS}, which is not there")
        return
    with tempfile.TemporaryDirectory(prefix="boresight-bench-") as place, one_core():
        cache = Path(place, "cache")
        yield _ratio(REPORT_WORK, partial(write_report, store_thousand(Path(place, "run"))), _REPORT_AIM)
        _in_a_process(partial(_make, _WARM_FACETS, cache))
        body = f"body of {settings.facets / 1e6:g} M facets"
        yield _ratio(f"{body}, made", partial(_make, settings.facets, cache), _BODY_AIM)
        yield _ratio(f"{body}, opened", partial(_open, settings.facets, cache), _BODY_AIM)


def _make(facets: int, folder: Path) -> Body:
    return load_body(speed_body(facets), (), Cache(folder, _CACHE_BYTES))


def _open(facets: int, folder: Path) -> None:
    limit_threads(1)
    SpeedScene(_make(facets, folder).mesh, ()).renderer(choose_variant())


def _ratio(work: str, do: Callable[[], object], aim: str) -> Ratio:
    ours_s, yardstick_s, peak_gib = _in_a_process(do)
    note = f"resident memory up to {peak_gib:.2f} GiB, aim {aim}; one round"
    return Ratio(work, YARDSTICK, "cpu", ours_s, yardstick_s, agreement=note)


def _in_a_process(do: Callable[[], object]) -> tuple[float, float, float]:
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(_measured, do).result()


def _measured(do: Callable[[], object]) -> tuple[float, float, float]:
    """Return the processor time of a work and the least of the yardstick, s, and the peak of resident memory, GiB.

    The peak that getrusage has is at least that of the process that started this one.
    """
    fixed = [yardstick().cpu for _ in range(_YARDSTICKS)]
    ours = timed(do)()
    peak = next(line for line in _STATUS.read_text(encoding="ascii").splitlines() if line.startswith(_PEAK))
    fixed += [yardstick().cpu for _ in range(_YARDSTICKS)]
    return ours.cpu, min(fixed), int(peak.split()[1]) / 2**20

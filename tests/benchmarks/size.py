"""The largest report, and the largest body in the largest image, with the memory that they take at most."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

from stored_grids import store_thousand

from benchmarks.ratio import Absent, Ratio
from benchmarks.timing import YARDSTICK, Settings, timed, yardstick
from boresight.campaign.imaging.world import open_world
from boresight.campaign.runs.benchmark import one_core
from boresight.renderers.mitsuba3 import choose_variant, limit_threads
from boresight.reports.pages.build import write_report
from boresight.scenarios.bodies import load_body
from boresight.scenarios.load import load_scenario

REPORT_WORK = "report of 1,000 scenarios and 50 methods"
_STATUS = Path("/proc/self/status")
_PEAK = "VmHWM:"
_REPORT_GIB, _BODY_GIB = 2.0, 4.0
_YARDSTICKS = 5
_LARGE = """
name: large
description: A ball of 21 million facets in a camera of 4096 x 4096 pixels.
body:
  shape: sphere
  expected_diameter_m: [1, 10000]
  detail:
    facets: 20000000
    boulders: {count: 3000, min_diameter_m: 3, max_diameter_m: 40}
    roughness: {rms_m: 0.8, max_wavelength_m: 100, min_wavelength_m: 4}
camera: {width_px: 4096, height_px: 4096, fov_deg: 18.3}
viewpoint: {range_m: 2000}
lighting: {phase_deg: 40}
pose_error: {position_cam_m: {normal: [5, 5, 5]}}
"""


def size_ratios(settings: Settings) -> Iterator[Ratio | Absent]:
    """Do each work once, in a process of its own on one core, between several yardsticks.

    The body is made into an empty cache and rendered from there.
    """
    if not _STATUS.is_file():
        yield Absent("size", f"the peak of a process's memory is read from {_STATUS}, which is not there")
        return
    with tempfile.TemporaryDirectory(prefix="boresight-bench-") as place, one_core():
        yield memory_ratio(REPORT_WORK, partial(write_report, store_thousand(Path(place, "run"))), _REPORT_GIB)
        yield memory_ratio("21 M facets, made and rendered, 4096 x 4096", partial(render_large, Path(place)), _BODY_GIB)


def render_large(folder: Path) -> None:
    """Make a body of 21 million facets in an empty folder, and render an image of 16.8 megapixels."""
    limit_threads(1)
    os.environ["BORESIGHT_CACHE"] = str(folder / "cache")
    (folder / "large.yaml").write_text(_LARGE, encoding="utf-8")
    scenario = load_scenario(str(folder / "large.yaml"))
    if (facets := len(load_body(scenario.spec.body, scenario.search_dirs).mesh.faces)) < 20e6:
        raise ValueError(f"the body has {facets} facets")
    if (lit := (open_world(scenario, choose_variant().name).source.trial_image(1, 0).image > 0).sum()) < 1e6:
        raise ValueError(f"{lit} pixels are lit")


def memory_ratio(work: str, do: Callable[[], object], most_gib: float) -> Ratio:
    """Do a work once, in a process of its own, between several yardsticks."""
    ours_s, yardstick_s, peak_gib = measured_in_a_process(do)
    note = f"resident memory up to {peak_gib:.2f} GiB, aim {most_gib:g} GiB; one round"
    over = f"{peak_gib:.2f} GiB of resident memory, {most_gib:g} GiB are aimed at" if peak_gib > most_gib else ""
    return Ratio(work, YARDSTICK, "cpu", ours_s, yardstick_s, agreement=note, over=over)


def measured_in_a_process(do: Callable[[], object]) -> tuple[float, float, float]:
    """Return the processor time of a work and the least of the yardstick, s, and the peak of resident memory, GiB."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(_measured, do).result()


def _measured(do: Callable[[], object]) -> tuple[float, float, float]:
    # The peak that getrusage has is at least that of the process that started this one.
    fixed = [yardstick().cpu for _ in range(_YARDSTICKS)]
    ours = timed(do)()
    peak = next(line for line in _STATUS.read_text(encoding="ascii").splitlines() if line.startswith(_PEAK))
    fixed += [yardstick().cpu for _ in range(_YARDSTICKS)]
    return ours.cpu, min(fixed), int(peak.split()[1]) / 2**20

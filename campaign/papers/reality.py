"""What real images and tracks give next to what was simulated of them: one table over the campaigns on real data."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from boresight.campaign.papers.page import FinishedRun, Paper
from boresight.reports.schema.grid import Grid
from boresight.reports.statistics.reality import levels_of, reality_grid, reality_rows

_IMAGES = {"compare-navcam67p": "67P, 60 images", "bennu-real": "Bennu, one image"}
_TRACKS, _SIMULATED = "vesta-real-slam", "vesta-simulated-slam"


def _rows(found: Mapping[str, FinishedRun]) -> Iterator[dict[str, str]]:
    for name, seen in _IMAGES.items():
        if name in found:
            run = found[name].data
            (seen_real,), (rendered,) = (levels_of(run, {"images": level}).values() for level in ("real", "rendered"))
            yield from reality_rows(seen, (run, seen_real), (run, rendered))
    if _TRACKS in found and _SIMULATED in found:
        real, simulated = found[_TRACKS].data, found[_SIMULATED].data
        scenarios = levels_of(real, {})
        for errors in ("white", "fit-1-32", "fit-33-65"):
            for (tracks, every), scenario in levels_of(simulated, {"errors": errors}).items():
                ranges = "one range" if every == "0" else f"a range every {every} frames"
                seen = f"Vesta, {tracks} tracks, {ranges}; simulated: {errors}"
                yield from reality_rows(seen, (real, scenarios[tracks, every]), (simulated, scenario), shared=True)


def _table(found: Mapping[str, FinishedRun]) -> list[Grid]:
    rows = list(_rows(found))
    return [reality_grid(rows)] if rows else []


PAPER = Paper(
    title="Real images and tracks next to simulated ones",
    campaigns=(*_IMAGES, _TRACKS, _SIMULATED),
    methods=(),
    figures=(),
    grids=lambda run: [],
    table=_table,
)

"""Epochs of single images in the scale of the files to which they are exported."""

from __future__ import annotations

from typing import Literal

from boresight.scenarios.spec.scenario import ScenarioSpec

Scale = Literal["utc", "tdb"]
_J2000 = 2451545.0
_S_PER_DAY = 86400.0


def scale_of(spec: ScenarioSpec) -> Scale | None:
    """Return the scale of a scenario's epochs: TDB of kernels, UTC of SUM files; None of tables, which do not say."""
    if spec.images is not None and spec.images.sumfiles is not None:
        return "utc"
    flown = None if spec.viewpoint is None else spec.viewpoint.trajectory
    return "tdb" if any(one is not None and one.spice is not None for one in (spec.images, flown)) else None


def converted_s(time_s: float, of: Scale, to: Scale) -> float:
    """Convert seconds past 2000-01-01 12:00 of one scale, in UTC without leap seconds, to those of another."""
    from astropy.time import Time  # takes a second

    found = getattr(Time(_J2000, time_s / _S_PER_DAY, format="jd", scale=of), to)
    return float((found.jd1 - _J2000) * _S_PER_DAY + found.jd2 * _S_PER_DAY)

"""The depth gauge of BA-SLAM: one landmark whose distance from the oldest view is held, equation (5)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.slam.following import LostError
from estimators.slam.journal import Journal
from estimators.slam.options import BundleOptions
from estimators.slam.state import Distances


@dataclass(frozen=True, slots=True)
class Gauge:
    """The distance of a landmark from a view, and its standard deviation, m."""

    view: int
    track: int
    range_m: float
    sigma_m: float


def measured_gauge(journal: Journal, view: int) -> Gauge:
    """Return the range measured at ``view`` with the smallest error.

    Raises
    ------
    LostError
        If there is none: the scale is unobservable.
    """
    ranges = journal.frames[view].ranges
    if not ranges:
        raise LostError("no range is measured at the first frame: the scale is unobservable")
    best = min(ranges, key=lambda item: (item.sigma_m, item.track))
    return Gauge(view, best.track, best.range_m, best.sigma_m)


def gauge_rows(journal: Journal, gauge: Gauge, views: Sequence[int], tracks: Sequence[int]) -> Distances:
    """Return what holds the scale of a window: the ranges that its leading view measured, or else the gauge."""
    lead = journal.distances(views[-1:], tracks)
    if len(lead.view):
        return replace(lead, view=lead.view + len(views) - 1)
    return Distances(
        np.array([views.index(gauge.view)], dtype=np.int64),
        np.array([tracks.index(gauge.track)], dtype=np.int64),
        np.array([gauge.range_m]),
        np.array([gauge.sigma_m]),
    )


def estimated_anew(journal: Journal, gauge: Gauge, sigma_m: float) -> Gauge:
    """Return a gauge with its present estimate, as after an adjustment to a range that was measured later."""
    distance = float(np.linalg.norm(journal.points_m[gauge.track] - journal.positions_m[gauge.view]))
    return Gauge(gauge.view, gauge.track, distance, sigma_m)


def handed_over(
    journal: Journal, gauge: Gauge, views: Sequence[int], seen: Mapping[int, Sequence[int]], options: BundleOptions
) -> Gauge:
    """Return the gauge for a window of ``views``, the oldest first; ``seen`` tells which of them saw each track.

    The old one serves while its view is the oldest and "as long as the connectivity with the last acquired view can be
    maintained": while the leading view sees its landmark; with ``connected: whole-window`` while any other view does.
    Otherwise a landmark of the oldest view takes over, at the distance that was measured to it from there, or else at
    the estimated one: of those that the leading view sees that which most views see, for one with a short track loses
    the scale.

    Raises
    ------
    LostError
        If no landmark that the oldest view sees has a known distance and is seen twice.
    """
    oldest, lead = views[0], views[-1]
    by = seen.get(gauge.track, ())
    held = lead in by if options.connected == "last-two" else len(by) >= 2
    if gauge.view == oldest and held:
        return gauge
    measured = {item.track: item for item in journal.frames[oldest].ranges}
    known = measured.keys() | (journal.points_m.keys() - journal.guessed)
    candidates = [
        track
        for track in journal.frames[oldest].tracks.tolist()
        if track in known and len(seen[track]) >= 2 and (lead in seen[track] or len(seen[track]) > 2)
    ]
    if not candidates:
        raise LostError("no landmark can take the depth gauge over: the scale is unobservable")
    best = min(candidates, key=lambda track: (track not in measured, lead not in seen[track], -len(seen[track]), track))
    if best in measured:
        return Gauge(oldest, best, measured[best].range_m, measured[best].sigma_m)
    distance = float(np.linalg.norm(journal.points_m[best] - journal.positions_m[oldest]))
    return Gauge(oldest, best, distance, options.gauge_sigma_m)

"""Keyframe management of BA-SLAM (section 3.2): the views of the sliding window, and its depth gauge, equation (5)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from boresight.estimators.slam.adjustment.problem import Distances
from boresight.estimators.slam.adjustment.slam_map import SlamMap
from boresight.estimators.slam.contract import LostError
from boresight.estimators.slam.following import check_connected
from boresight.estimators.slam.options import BundleOptions


@dataclass(frozen=True, slots=True)
class DepthGauge:
    """The distance of a landmark from a view, and its standard deviation, m."""

    view: int
    track: int
    range_m: float
    sigma_m: float


def gauge_distances(slam_map: SlamMap, gauge: DepthGauge, views: Sequence[int], tracks: Sequence[int]) -> Distances:
    """Return the distances that fix the scale of a window: the leading view's measured ranges, or else the gauge."""
    lead = slam_map.distances(views[-1:], tracks)
    if len(lead.view):
        # They were numbered within the one leading view; it is the last of the window.
        return replace(lead, view=lead.view + len(views) - 1)
    # The last row of eq. (5): d - d_hat(l_1, T_1, x).
    return Distances(
        np.array([views.index(gauge.view)], dtype=np.int64),
        np.array([tracks.index(gauge.track)], dtype=np.int64),
        np.array([gauge.range_m]),
        np.array([gauge.sigma_m]),
    )


def hand_over_gauge(
    slam_map: SlamMap,
    gauge: DepthGauge,
    views: Sequence[int],
    seen: Mapping[int, Sequence[int]],
    options: BundleOptions,
) -> DepthGauge:
    """Return the depth gauge of a window of ``views``, the oldest first; ``seen`` lists the views of each track.

    The old gauge stays while its view is the oldest and "as long as the connectivity with the last acquired view can be
    maintained": while the leading view sees its landmark; with ``connected: whole-window`` while any other view does.
    Otherwise it is handed over to a landmark of the oldest view, at the distance measured there, or else at the
    estimated one: of the landmarks in the leading view the one with the most views, since a gauge on a short track
    loses the scale. Raise LostError if no landmark of the oldest view has a known distance and is seen twice.
    """
    oldest, lead = views[0], views[-1]
    by = seen.get(gauge.track, ())
    held = lead in by if options.connected == "last-two" else len(by) >= 2
    if gauge.view == oldest and held:
        return gauge
    measured = {item.track: item for item in slam_map.frames[oldest].ranges}
    # A guessed distance must not become the scale.
    known = measured.keys() | (slam_map.points_m.keys() - slam_map.guessed)
    candidates = [
        track
        for track in slam_map.frames[oldest].tracks.tolist()
        # A landmark of the oldest view and one other would connect the scale with that view alone, unless it is the
        # leading one.
        if track in known and len(seen[track]) >= 2 and (lead in seen[track] or len(seen[track]) > 2)
    ]
    if not candidates:
        raise LostError("no landmark can take the depth gauge over: the scale is unobservable")
    best = min(candidates, key=lambda track: (track not in measured, lead not in seen[track], -len(seen[track]), track))
    if best in measured:
        return DepthGauge(oldest, best, measured[best].range_m, measured[best].sigma_m)
    # The estimated distance has an error, which biases the scale until the next handover (section 3.2: drift like a
    # random walk).
    distance = float(np.linalg.norm(slam_map.points_m[best] - slam_map.positions_m[oldest]))
    return DepthGauge(oldest, best, distance, options.gauge_sigma_m)


class SharedLandmarks(Protocol):
    """Count of landmarks that two frames share: that of a `SlamMap`, or of an `OutlierGate` with refused pixels."""

    def shared(self, first: int, second: int) -> int:
        """Count the landmarks that two views share."""
        ...


def trailing_views(
    slam_map: SlamMap, tracks: SharedLandmarks, trailing: Sequence[int], lead: int, options: BundleOptions
) -> list[int]:
    """Second strategy: the trailing views stay while they are connected with the leading one.

    The paper shifts the window "when the distance between the two last frames cannot ensure a proper landmark
    connectivity": the oldest view is dropped, and the leading view of the step before becomes the last of the trailing
    ones. "The window size gets reduced before growing again": the oldest views of the shifted window that share too few
    landmarks with the leading one are dropped, since the gauge of the oldest view is valid only "as long as the
    connectivity with the last acquired view can be maintained". With ``connected: whole-window``, which is not the
    paper's, the window is shifted as soon as the leading view is no longer connected with the oldest one.

    While the window grows, which the paper does not detail, views are added at equal ratios of shared landmarks, so
    that the full window spans just the connectivity. Raise LostError if the leading view shares too few landmarks with
    every trailing view and with the frame before.
    """
    views = list(trailing)
    if len(views) < options.views - 1:
        held = tracks.shared(views[-1], views[-1])
        # The first and the leading view of a full window, views - 1 steps apart, then share just the connectivity.
        share = (options.connectivity / held) ** (1.0 / (options.views - 1))
        near = tracks.shared(views[-1], lead) >= share * held
        grown = views if near or views[-1] == lead - 1 else [*views, lead - 1]
        return _connected_part(tracks, grown, lead, options)
    # Shared landmarks are counted with the last trailing view, as in the paper, or with the oldest; the angle of table
    # 2 is between consecutive views, so with the last one in both cases.
    base = views[-1] if options.connected == "last-two" else views[0]
    a, b = slam_map.positions_m[views[-1]], slam_map.positions_m[lead]
    # The arc tangent is accurate for small angles, where the arc cosine loses half of the digits.
    angle = float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))
    if tracks.shared(base, lead) >= options.connectivity and angle <= np.radians(options.angle_max_deg):
        return views
    # The shift of section 3.2: T1 := T2, T2 := T3, T3 := T4, where T4 was the leading view of the step before.
    return _connected_part(tracks, [*views[1:], lead - 1] if views[-1] != lead - 1 else views[1:], lead, options)


def offset_views(tracks: SharedLandmarks, lead: int, options: BundleOptions) -> list[int]:
    """First strategy: a constant offset, counted in frames, between the views; fewer at the beginning."""
    # The paper's offset is an angle; frames of equal anomaly steps (section 4) make it a number of frames.
    back = [lead - options.offset_frames * step for step in range(1, options.views)]
    views = sorted(view for view in back if view >= 0) or [0]
    return _connected_part(tracks, views, lead, options)


def _connected_part(tracks: SharedLandmarks, views: list[int], lead: int, options: BundleOptions) -> list[int]:
    """Drop the oldest views until the leading one is connected with the first remaining one."""
    while views and tracks.shared(views[0], lead) < options.connectivity:
        views = views[1:]
    if views:
        return views
    # No trailing view is connected: start again from the frame before, which is the best connected one.
    check_connected(tracks.shared(lead - 1, lead), options.connectivity)
    return [lead - 1]

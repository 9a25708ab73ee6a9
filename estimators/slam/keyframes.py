"""Which views the window of BA-SLAM holds: the two strategies of section 3.2."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from estimators.slam.following import LostError
from estimators.slam.journal import Journal
from estimators.slam.options import BundleOptions


class Tracks(Protocol):
    """Counts landmarks that two frames share: those of a journal, or of frames as they came."""

    def shared(self, first: int, second: int) -> int:
        """Count the landmarks that two views share."""
        ...


def trailing_views(
    journal: Journal, tracks: Tracks, trailing: Sequence[int], lead: int, options: BundleOptions
) -> list[int]:
    """Second strategy: the trailing views stay as long as they are connected with the leading one.

    The paper shifts the window "when the distance between the two last frames cannot ensure a proper landmark
    connectivity": the oldest view is dropped, and the leading view of the step before becomes the last of the trailing
    ones. "The window size gets reduced before growing again": of the shifted window the oldest views go that share too
    few landmarks with the leading one, for the gauge of the oldest view serves only "as long as the connectivity with
    the last acquired view can be maintained". With ``connected: whole-window``, which is not the paper's, the window
    is shifted as soon as the leading view loses the oldest one.

    While the window grows, which the paper does not detail, views enter it at equal ratios of shared landmarks, so that
    the window spans just the connectivity when it is full.

    Raises
    ------
    LostError
        If the leading view shares too few landmarks with every view that it could build on.
    """
    views = list(trailing)
    if len(views) < options.views - 1:
        return _grown(tracks, views, lead, options)
    base = views[-1] if options.connected == "last-two" else views[0]
    if _connected(journal, tracks, base, views[-1], lead, options):
        return views
    return _connected_part(tracks, [*views[1:], lead - 1] if views[-1] != lead - 1 else views[1:], lead, options)


def offset_views(tracks: Tracks, lead: int, options: BundleOptions) -> list[int]:
    """First strategy: a constant offset, counted in frames, between the views; fewer at the beginning."""
    back = [lead - options.offset_frames * step for step in range(1, options.views)]
    views = sorted(view for view in back if view >= 0) or [0]
    return _connected_part(tracks, views, lead, options)


def _grown(tracks: Tracks, views: list[int], lead: int, options: BundleOptions) -> list[int]:
    """Let the view before the leading one in when the leading one has moved far enough from the last."""
    held = tracks.shared(views[-1], views[-1])
    share = (options.connectivity / held) ** (1.0 / (options.views - 1))
    near = tracks.shared(views[-1], lead) >= share * held
    candidate = views if near or views[-1] == lead - 1 else [*views, lead - 1]
    return _connected_part(tracks, candidate, lead, options)


def _connected(journal: Journal, tracks: Tracks, oldest: int, last: int, lead: int, options: BundleOptions) -> bool:
    shared = tracks.shared(oldest, lead) >= options.connectivity
    return shared and _angle(journal, last, lead) <= np.radians(options.angle_max_deg)


def _connected_part(tracks: Tracks, views: list[int], lead: int, options: BundleOptions) -> list[int]:
    """Drop the oldest views until the leading one is connected with the first that remains."""
    while views and tracks.shared(views[0], lead) < options.connectivity:
        views = views[1:]
    if views:
        return views
    if tracks.shared(lead - 1, lead) >= options.connectivity:
        return [lead - 1]
    raise LostError(
        f"tracks are lost: {tracks.shared(lead - 1, lead)} landmarks are shared with the frame before,"
        f" {options.connectivity} are needed"
    )


def _angle(journal: Journal, first: int, second: int) -> float:
    """Angle between two camera positions at the centre of the body, rad."""
    a, b = journal.positions_m[first], journal.positions_m[second]
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))

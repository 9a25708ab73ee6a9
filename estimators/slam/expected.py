"""Where a new frame is expected to see landmarks: those of an adjustment, and those seen once, of guessed distance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimators.slam.journal import Journal
from estimators.slam.residuals import bearing_jacobians, distance_jacobians
from estimators.slam.state import Adjustment, State

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

DEPTH_SIGMA = 0.3
"""Relative standard deviation of a guessed distance."""

_FIXED = 1e12
"""Information, 1/m^2, that stands for a view that is not free."""


@dataclass(frozen=True, slots=True, eq=False)
class Expected:
    """Lines from the new camera to landmarks that it may see.

    Parameters
    ----------
    rows
        (n,) of the frame.
    lines_m
        (n, 3) landmark less camera, body axes.
    by_all
        (n, 3, m) derivative of a line by what is uncertain in common.
    covariance
        (m, m) of that: views and landmarks of the adjustment, and the last motion.
    own_m2
        (n, 3, 3) covariance that a line shares with no other.
    known
        (n,): of the map; the others have a guessed distance.
    """

    rows: IndexArray
    lines_m: FloatArray
    by_all: FloatArray
    covariance: FloatArray
    own_m2: FloatArray
    known: BoolArray

    def joined(self, other: Expected) -> Expected:
        """Take two together that are uncertain by the same."""
        return Expected(
            np.concatenate([self.rows, other.rows]),
            np.concatenate([self.lines_m, other.lines_m]),
            np.concatenate([self.by_all, other.by_all]),
            self.covariance,
            np.concatenate([self.own_m2, other.own_m2]),
            np.concatenate([self.known, other.known]),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Common:
    """What is uncertain when a frame comes: slots of ``views`` by number, landmarks, the motion; and its covariance.

    ``slots`` tells where a view stands among the 3 m columns; the motion has the last three.
    """

    covariance: FloatArray
    slots: dict[int, int]
    points: int

    @classmethod
    def of(
        cls, adjusted: tuple[Adjustment, State] | None, views: Sequence[int], motion_covariance_m2: FloatArray
    ) -> Common:
        """Put the covariance of an adjustment and that of the motion after it together."""
        if adjusted is None:
            return cls(motion_covariance_m2.copy(), {}, 0)
        before = joint_covariance(*adjusted)
        size = len(before)
        covariance = np.zeros((size + 3, size + 3))
        covariance[:size, :size] = before
        covariance[size:, size:] = motion_covariance_m2
        return cls(covariance, {view: 3 * slot for slot, view in enumerate(views)}, 3 * len(views))

    def by_camera(self, view: int) -> FloatArray:
        """(3, m) derivative of the new camera's position by all: the view before, and the motion."""
        rows = np.zeros((3, len(self.covariance)))
        rows[:, -3:] = np.eye(3)
        return rows + self.by_view(view - 1)

    def by_view(self, view: int) -> FloatArray:
        """(3, m) derivative of a view's position; zero where it is not among the views of the adjustment."""
        rows = np.zeros((3, len(self.covariance)))
        if view in self.slots:
            rows[:, self.slots[view] : self.slots[view] + 3] = np.eye(3)
        return rows


def mapped_landmarks(
    common: Common, state: State, places: tuple[IndexArray, IndexArray], view: int, position_m: FloatArray
) -> Expected:
    """Landmarks of the adjustment, at (rows of the frame, places in the state), from where ``view`` is expected."""
    rows, points = places
    by_all = np.tile(-common.by_camera(view), (len(rows), 1, 1))
    columns = common.points + 3 * points[:, None] + np.arange(3)
    by_all[np.arange(len(rows))[:, None], np.arange(3), columns] += 1.0
    lines = state.points_m[points] - position_m
    own = np.zeros((len(rows), 3, 3))
    return Expected(rows, lines, by_all, common.covariance, own, np.ones(len(rows), dtype=np.bool_))


def guessed_landmarks(
    common: Common, journal: Journal, places: tuple[IndexArray, Sequence[tuple[int, int]]], depth_m: float, view: int
) -> Expected:
    """Landmarks at (rows of the frame, (view, track) that saw them once): as far as their range, or at a guess.

    Its own covariance has the pixel's noise across the first ray, and 30 % of the distance along it.
    """
    rows, sights = places
    n = len(sights)
    depths, sigmas = np.full(n, depth_m), np.full(n, DEPTH_SIGMA * depth_m)
    for k, (other, track) in enumerate(sights):
        for item in journal.frames[other].ranges:
            if item.track == track:
                depths[k], sigmas[k] = item.range_m, item.sigma_m
    rays = np.array([journal.ray(other, track) for other, track in sights]).reshape(n, 3)
    noise = np.array([journal.frames[other].sigma_px for other, _ in sights]) / journal.camera.fx_px * depths
    along = rays[:, :, None] * rays[:, None, :]
    own = (sigmas**2)[:, None, None] * along + (noise**2)[:, None, None] * (np.eye(3) - along)
    anchors = np.array([journal.positions_m[other] for other, _ in sights]).reshape(n, 3)
    at = journal.positions_m[view - 1] + journal.frames[view].motion_m
    by_all = np.array([common.by_view(other) - common.by_camera(view) for other, _ in sights])
    return Expected(
        rows,
        anchors + depths[:, None] * rays - at,
        by_all.reshape(n, 3, len(common.covariance)),
        common.covariance,
        own,
        np.zeros(n, dtype=np.bool_),
    )


def joint_covariance(problem: Adjustment, state: State) -> FloatArray:
    """(3 (V + L), 3 (V + L)) covariance of all views and landmarks of an adjustment at its minimum, m^2.

    Raises
    ------
    numpy.linalg.LinAlgError
        If they are not determined.
    """
    views, size = len(state.positions_m), len(state.positions_m) + len(state.points_m)
    blocks = np.zeros((size, size, 3, 3))
    for measured, by_point in (
        (problem.sightings, bearing_jacobians(problem, state)),
        (problem.distances, distance_jacobians(problem, state)),
    ):
        square = np.swapaxes(by_point, 1, 2) @ by_point
        point = views + measured.point
        np.add.at(blocks, (measured.view, measured.view), square)
        np.add.at(blocks, (point, point), square)
        np.add.at(blocks, (measured.view, point), -square)
        np.add.at(blocks, (point, measured.view), -square)
    moved = problem.motions
    for one, other, sign in ((0, 0, 1.0), (1, 1, 1.0), (0, 1, -1.0), (1, 0, -1.0)):
        ends = (moved.start, moved.end)
        np.add.at(blocks, (ends[one], ends[other]), sign * moved.information)
    fixed = np.flatnonzero(~problem.free_views)
    blocks[fixed, fixed] += _FIXED * np.eye(3)
    information = blocks.transpose(0, 2, 1, 3).reshape(3 * size, 3 * size)
    if problem.prior is not None:
        place = np.concatenate([problem.prior.views, views + problem.prior.points])
        rows = (3 * place[:, None] + np.arange(3)).ravel()
        information[np.ix_(rows, rows)] += problem.prior.information
    return np.asarray(np.linalg.inv(information), dtype=np.float64)

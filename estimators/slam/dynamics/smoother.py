"""A fixed-lag smoother of positions, velocities, gravity parameter and solar radiation pressure."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from estimators.options import parse_options
from estimators.slam.contract import FrameEstimate, SequenceEstimate
from estimators.slam.dynamics.problem import DynamicAdjustment, DynamicPrior, DynamicState, gather
from estimators.slam.dynamics.solver import (
    DynamicOrdering,
    covariance_of,
    dynamic_cost,
    dynamic_equations,
    minimise_dynamic,
)
from estimators.slam.dynamics.window import DynamicWindow
from estimators.slam.following import LostError, check_scale, follow
from estimators.slam.marginal import constrained_points, departing_part, eliminate_rows
from estimators.slam.options import DynamicOptions
from estimators.slam.solver import StoppingRule
from scenarios.tracks import TrackFrame, TrackSequence

FloatArray = NDArray[np.float64]

IndexArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


def marginalise_dynamic(problem: DynamicAdjustment, state: DynamicState, view: int, lost: BoolArray) -> DynamicPrior:
    """Marginalise a view with its velocity, and the landmarks marked in ``lost`` (L,), all linearised at ``state``.

    The quadratic is about all other views, the parameters, and the landmarks that something departing speaks of.

    Raises
    ------
    numpy.linalg.LinAlgError
        If what goes is not determined.
    """
    part = _departing_part(problem, view, lost)
    rows = DynamicOrdering.of(part)
    matrix, right, _ = dynamic_equations(part, state, rows).reduced()
    views = np.flatnonzero(np.arange(len(problem.R_body_inertial)) != view)
    points = np.flatnonzero(part.vision.free_points & ~lost)
    kept = rows.of_prior(views, points)
    staying = np.zeros(rows.count, dtype=np.bool_)
    staying[kept[kept >= 0]] = True
    information, gradient = eliminate_rows(matrix, -right, ~staying)
    place = np.append(np.cumsum(staying) - 1, -1)[kept]  # what is fixed keeps rows of zeros
    padded = np.zeros((len(information) + 1, len(information) + 1))
    padded[:-1, :-1] = information
    return DynamicPrior(
        views, points, gather(state, views, points), padded[np.ix_(place, place)], np.append(gradient, 0.0)[place]
    )


def _departing_part(problem: DynamicAdjustment, view: int, lost: BoolArray) -> DynamicAdjustment:
    """Return the part of ``problem`` that goes; of its landmarks only those that it speaks of are free."""
    vision = departing_part(problem.vision, view, lost)
    joined = np.zeros(len(lost), dtype=np.bool_)
    if problem.prior is not None:
        joined[problem.prior.points] = True
    told = constrained_points(vision) | joined
    vision = replace(vision, free_points=vision.free_points & told, kept_points=told & (joined | ~lost))
    return replace(problem, vision=vision, arcs=problem.arcs.of_view(view))


class InnovationTest:
    """Holds by how much new frames raise the minimum of the cost against what chance lets expect.

    Twice the rise is chi-square of as many degrees of freedom as there are new measurements beyond new unknowns: the
    squared normalised innovation of a filter that iterates.
    """

    def __init__(self, frames: int, limit: float) -> None:
        self.limit = limit
        self.recent: deque[tuple[float, int]] = deque(maxlen=frames)
        self.total = 0.0
        self.measurements = 0

    def diagnostics(self) -> dict[str, float]:
        """Return the mean over all frames so far, of which 1 is expected, and its degrees of freedom."""
        if not self.measurements:
            return {}
        return {"innovation": self.total / self.measurements, "innovation_degrees": float(self.measurements)}

    def add(self, rise: float, measurements: int) -> None:
        """Take the next frame's rise in; raise LostError where the last frames are far above expectation."""
        self.total += 2.0 * rise
        self.measurements += measurements
        self.recent.append((2.0 * rise, measurements))
        count = sum(item[1] for item in self.recent)
        if len(self.recent) < (self.recent.maxlen or 0) or count <= 0:
            return
        mean = sum(item[0] for item in self.recent) / count
        if mean > self.limit:
            raise LostError(
                f"the smoother diverges: the squared normalised innovation of {len(self.recent)} frames is {mean:.3g};"
                " forces or tracks are not what they are said to be"
            )


def measurements_beyond_unknowns(problem: DynamicAdjustment) -> int:
    """Count measurements less unknowns of landmarks; a view adds as many unknowns as its arc tells."""
    vision = problem.vision
    return 2 * len(vision.pixels.view) + len(vision.distances.view) - 3 * len(vision.free_points)


class DynamicSmoother:
    """Adjusts the last views, joined by their motion about the body; older ones and lost landmarks are marginalised.

    The motion is that of equation (6) of Delpech et al. (2015): gravity of a point whose parameter is estimated, solar
    radiation pressure up to a factor that is estimated, and an unknown acceleration in each interval. It takes the
    place of the predicted displacements, which are not used. It ties the path to the centre of mass, which bearings
    and ranges alone do not see.
    """

    name: ClassVar[str] = "dynamic-smoother"
    version: ClassVar[int] = 4

    def __init__(self, options: DynamicOptions) -> None:
        self.options = options

    @classmethod
    def from_options(cls, options: Mapping[str, object]) -> Self:
        """Build from a campaign's options; raise BoresightError on a wrong one."""
        return cls(parse_options(DynamicOptions, options, cls.name))

    def follow(self, sequence: TrackSequence) -> SequenceEstimate:
        """Estimate the camera position at every frame from the frames up to it."""
        return follow(sequence, _Smoother(sequence, self.options))


class _Smoother:
    """The window at work on one sequence."""

    def __init__(self, sequence: TrackSequence, options: DynamicOptions) -> None:
        self.options = options
        self.sequence = sequence
        self.window: DynamicWindow | None = None
        self.parameter_sigmas_m: FloatArray = np.zeros(2)
        self.innovation = InnovationTest(options.innovation_frames, options.innovation_max)
        self.before: tuple[float, int] = (0.0, 0)
        self.iterations = 0
        self.count = 0

    def diagnostics(self) -> dict[str, float]:
        if self.window is None:
            return {}
        forces, length = self.window.forces, self.window.field.length_m
        gm, radiation = forces.gm_m3_s2, float(np.linalg.norm(forces.radiation_m_s2))
        ratio, factor = (self.window.parameters_m / length).tolist()
        ratio_sigma, factor_sigma = (self.parameter_sigmas_m / length).tolist()
        return {
            **self.innovation.diagnostics(),
            "iterations_per_frame": self.iterations / max(self.count - 1, 1),
            "gm_m3_s2": ratio * gm,
            "gm_sigma_m3_s2": ratio_sigma * gm,
            "radiation_m_s2": factor * radiation,
            "radiation_sigma_m_s2": factor_sigma * radiation,
        }

    def advance(self, frame: TrackFrame) -> FrameEstimate:
        number, self.count = self.count, self.count + 1
        if self.window is None:
            return self._begin()
        window = self.window
        window.slam_map.frames[number] = frame
        window.views.append(number)
        self._check_connected(window, number)
        window.predict(number)
        tracks = window.tracks()
        problem = window.problem(tracks, first_estimates=self.options.first_estimates)
        rule = StoppingRule(self.options.tolerance * window.slam_map.median_depth(number - 1), self.options.iterations)
        solution = minimise_dynamic(problem, window.state(tracks), rule)
        self.iterations += solution.iterations
        if not np.isfinite(solution.cost):
            raise LostError("a landmark is behind a camera that sees it")
        self._test(solution.cost, problem)
        window.keep(solution.state, tracks)
        estimate = self._estimate(problem, solution.state, tracks)
        if len(window.views) > self.options.lag:
            self._marginalise(window, problem, solution.state, tracks)
        return estimate

    def _begin(self) -> FrameEstimate:
        """Place the first view, and all landmarks provisionally at the distance that was measured."""
        sequence = self.sequence
        if sequence.forces is None:
            raise LostError("the sequence tells no forces: dynamic-smoother needs a scenario with a propagated orbit")
        window = self.window = DynamicWindow(sequence, sequence.forces)
        window.begin(sequence)
        self.parameter_sigmas_m = window.field.sigmas(sequence.forces)
        slam_map = window.slam_map
        slam_map.guess(0, slam_map.median_depth(0))
        ranged = sorted(item.track for item in sequence.frames[0].ranges if item.track in slam_map.points_m)
        points = slam_map.state((), ranged).points_m
        covariance = sequence.position_covariance_m2.copy()
        return FrameEstimate(sequence.position_m.copy(), covariance, np.array(ranged, dtype=np.int64), points, 0.0)

    def _check_connected(self, window: DynamicWindow, number: int) -> None:
        shared = window.slam_map.shared(number - 1, number)
        if shared < self.options.connectivity:
            raise LostError(
                f"tracks are lost: {shared} landmarks are shared with the frame before,"
                f" {self.options.connectivity} are needed"
            )

    def _test(self, cost: float, problem: DynamicAdjustment) -> None:
        """Hold the new frame against what was known before it."""
        measurements = measurements_beyond_unknowns(problem)
        self.innovation.add(cost - self.before[0], measurements - self.before[1])
        self.before = cost, measurements

    def _estimate(self, problem: DynamicAdjustment, state: DynamicState, tracks: list[int]) -> FrameEstimate:
        rows = DynamicOrdering.of(problem)
        wanted = np.concatenate([rows.position[-1], rows.parameters])
        try:
            joint = covariance_of(problem, state, wanted, rows)
        except np.linalg.LinAlgError as error:
            raise LostError("the scale is unobservable: the reduced system has not full rank") from error
        self.parameter_sigmas_m = np.sqrt(np.maximum(np.diag(joint)[3:], 0.0))
        vision, covariance = state.vision, joint[:3, :3]
        position = vision.positions_m[-1]
        check_scale(covariance, vision.points_m, position, self.options.uncertainty_max)
        return FrameEstimate(position, covariance, np.array(tracks, dtype=np.int64), vision.points_m, 0.0)

    def _marginalise(
        self, window: DynamicWindow, problem: DynamicAdjustment, state: DynamicState, tracks: list[int]
    ) -> None:
        """Drop the oldest view, and the landmarks that it saw and that are lost; keep what they tell."""
        number = np.array(tracks, dtype=np.int64)
        oldest = np.isin(number, window.slam_map.frames[window.views[0]].tracks)
        if problem.prior is not None:
            oldest[problem.prior.points] = True
        lost = oldest & ~np.isin(number, window.slam_map.frames[window.views[-1]].tracks)
        try:
            prior = marginalise_dynamic(problem, state, 0, lost)
        except np.linalg.LinAlgError as error:
            raise LostError("the scale is unobservable: the oldest view is not determined") from error
        window.pass_on(prior, state, tracks, lost)
        left = window.tracks()
        rest = window.problem(left, first_estimates=self.options.first_estimates)
        self.before = dynamic_cost(rest, window.state(left)), measurements_beyond_unknowns(rest)

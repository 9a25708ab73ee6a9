"""EKF-SLAM of Delpech et al. (2015), section 3.3, with an iterated and a consistent variant."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import ClassVar, TypeVar

import numpy as np

from boresight.estimators.slam.adjustment.global_map import planned_covariance
from boresight.estimators.slam.association.gating import gate_pixels
from boresight.estimators.slam.contract import FrameEstimate, LostError
from boresight.estimators.slam.filters.ekf_pose import PoseState
from boresight.estimators.slam.filters.ekf_state import FilterState
from boresight.estimators.slam.filters.ekf_update import FrameMeasurements, iterated_update, kalman_update
from boresight.estimators.slam.following import ConfiguredEstimator, Follower, InnovationTest, check_scale
from boresight.estimators.slam.options import ConsistentFilterOptions, FilterOptions, Gate, IteratedFilterOptions
from boresight.scenarios.arrays import BoolArray, FloatArray
from boresight.scenarios.observation import Prediction, TrackFrame, TrackSequence

Update = Callable[[FilterState, FrameMeasurements], tuple[FilterState, float]]
Options = TypeVar("Options", bound=FilterOptions)

_KNOWN = 0.1
"""Relative standard deviation of an inverse distance below which the distance counts as known, for the gate."""

_FEWEST = 3
"""Landmarks of known distance below which all are gated at once."""

_MAX_REFUSED_SHARE = 0.5
"""Share of refused pixels above which the filter counts as diverging."""


class _PredictedFilter(ConfiguredEstimator[Options]):
    """Base of the filters, with their prediction."""

    def predict(self, sequence: TrackSequence, positions_m: FloatArray, points_m: FloatArray) -> FloatArray | None:
        """Predict by all frames at once, see `SequenceEstimator`: a linear filter has used the same measurements.

        The weak prior of a new landmark's distance is not in it. None with ``camera: pose``, whose attitude is unknown.
        """
        if self.options.camera == "pose":
            return None
        return planned_covariance(sequence, positions_m, points_m)


class EkfSlam(_PredictedFilter[FilterOptions]):
    """EKF-SLAM of Delpech et al. (2015): Kalman filter of the camera and of the landmarks in view, in inverse depth.

    The state of the camera is its position, with known attitude, or with ``camera: pose`` all 13 elements of the paper.

    Use it when
    -----------
    The method of the paper is wanted. Otherwise use ``consistent-ekf-slam`` or ``fixed-lag``. Errors that add up along
    tracks are not of the paper, and are modelled if they are stated (``walk_px``, ``contraction``
    and ``drift_px`` of ``sequence.knowledge``).

    It fails when
    -------------
    No range is measured at the first frame, too few landmarks are left, or the filter diverges: an inverse distance is
    not positive, a landmark is behind the camera, or the innovations are too large. It is overconfident: in
    ``delpech2015-comparison`` 96, 100 and 100 of 100 runs of 10, 15 and 20 landmarks a frame ended, with a mean NEES of
    294, 226 and 198, 3 expected.

    Each update has one linearisation, at the predicted position. Where that is off along the line of sight, as in a
    descent, the filter soon takes the scale for known. In 13 steps of 20 m from 310 to 50 m above a sphere, with
    predicted motions off by half their length, the last position is off by 6.7 m at a standard deviation of 0.9 m;
    ``iterated-ekf-slam`` has 2.6 and 4.4 m (medians of 98 and 99 of 100 runs). With motions off by 2 % all filters
    have 0.6 m (24 runs).

    Cost
    ----
    0.26 s a revolution of ``apophis-sphere-sequence`` (181 frames).

    Source
    ------
    Delpech et al. (2015), section 3.3. Gates: one-point RANSAC of Civera et al. (2010).
    """

    name: ClassVar[str] = "ekf-slam"
    version: ClassVar[int] = 4
    options_model = FilterOptions

    def follower(self, sequence: TrackSequence) -> Follower:
        """Return the estimator at work on one sequence."""
        return _Filter(sequence, self.options, lambda state, measured: kalman_update(state, measured.innovation(state)))


class IteratedEkfSlam(_PredictedFilter[IteratedFilterOptions]):
    """``ekf-slam`` with iterated updates: each ends at the minimum of the cost of prediction and measurements.

    Use it when
    -----------
    To see which part of the error of ``ekf-slam`` comes from a single linearisation in each update.

    It fails when
    -------------
    As ``ekf-slam``. It is overconfident too, as derivatives are taken at estimates that change from frame to frame.

    Cost
    ----
    0.73 s a revolution of ``apophis-sphere-sequence`` (181 frames).

    Source
    ------
    Bell and Cathey (1993) for the update; the rest as ``ekf-slam``.
    """

    name: ClassVar[str] = "iterated-ekf-slam"
    version: ClassVar[int] = 3
    options_model = IteratedFilterOptions

    def follower(self, sequence: TrackSequence) -> Follower:
        """Return the estimator at work on one sequence."""
        return _Filter(sequence, self.options, partial(iterated_update, steps=self.options.iterations))


class ConsistentEkfSlam(_PredictedFilter[ConsistentFilterOptions]):
    """Iterated filter with first-estimates Jacobians, so that bearings give no information about the scale.

    Bearings do not depend on the scale. The filter's unobservable direction is the scale too if all derivatives by a
    landmark are taken at the same inverse distance and anchor. With derivatives at each frame's estimates the
    unobservable directions differ from frame to frame, and the filter becomes overconfident. The derivatives are fixed
    once an inverse distance is well known: the initial guess would make them wrong.

    Use it when
    -----------
    A filter is wanted whose covariance describes its errors. With ``camera: pose`` it also models a misaligned camera.
    Errors that add up along tracks are modelled if they are stated (``walk_px``, ``contraction``
    and ``drift_px`` of ``sequence.knowledge``).

    It fails when
    -------------
    As ``ekf-slam``. With attitude noise its covariance is too small unless ``camera: pose`` is set: in
    ``apophis-attitude`` the mean NEES with 0.03 deg of noise is 4.2 times what is expected, and 0.78 times with it (12
    runs). Where the scale is known to no better than ``settled_sigma``, derivatives are fixed at a wrong scale: lower
    it.

    Cost
    ----
    0.87 s a revolution of ``apophis-sphere-sequence`` (181 frames).

    Source
    ------
    Huang, Mourikis and Roumeliotis (2010), about translation and rotation; here attitude is measured, and a translation
    leaves anchored landmarks as they are.
    """

    name: ClassVar[str] = "consistent-ekf-slam"
    version: ClassVar[int] = 3
    options_model = ConsistentFilterOptions

    def follower(self, sequence: TrackSequence) -> Follower:
        """Return the estimator at work on one sequence."""
        update = partial(iterated_update, steps=self.options.iterations)
        return _Filter(sequence, self.options, update, self.options.settled_sigma)


class _Filter:
    """Filter on one sequence: (1) prediction, (2) update and (3) state management of section 3.3.

    It fails if it diverges: by its innovations, by the sign of an inverse distance, or by refused pixels. A gate hides
    a divergence from the innovation of the pixels that pass it, so that a filter that refuses more than half of the
    pixels, over as many frames as innovations are averaged over, counts as diverging too.
    """

    def __init__(
        self, sequence: TrackSequence, options: FilterOptions, update: Update, settled_sigma: float = 0.0
    ) -> None:
        self.options = options
        self.camera = sequence.camera
        self.update = update
        self.settled_sigma = settled_sigma
        self.first = (sequence.position_m, sequence.position_covariance_m2)
        self.state: FilterState | None = None
        self.innovation = InnovationTest(options.innovation_frames, options.innovation_max, "filter")
        self.gated: deque[tuple[int, int]] = deque(maxlen=options.innovation_frames)
        self.in_a_row: dict[int, int] = {}
        self.refused = 0

    def diagnostics(self) -> dict[str, float]:
        """Return the mean squared normalised innovation, its degrees of freedom, and how many pixels were refused."""
        return {**self.innovation.diagnostics(), "refused_pixels": float(self.refused)}

    def advance(self, frame: TrackFrame) -> FrameEstimate:
        before = self.state
        if before is not None:
            # (1) State prediction and covariance propagation; lost landmarks, part of (3), are dropped before the
            # update, which has no measurement of them.
            state = self._without_lost(before.predicted(self.camera, frame), frame)
            # (2) State and covariance update.
            state = self._updated(state, frame)
        elif self.options.camera == "position":
            state = FilterState.of_camera(*self.first, frame)
        else:
            state = PoseState.at_first(*self.first, frame, np.radians(self.options.turn_noise_deg))
        # (3) State management: new landmarks by equations (8) to (11), the first at the gauge's range.
        state = self.state = self._with_new(state, frame).with_fixed_linearisation(self.settled_sigma)
        position, covariance, points = state.estimate(self.camera)
        # Without a scale the filter still fits all pixels: only its covariance shows the drift.
        check_scale(covariance, points, position, self.options.uncertainty_max)
        velocity = None if before is None else state.velocity_m_s
        return FrameEstimate(position, covariance, state.tracks, points, 0.0, velocity)

    def predict(self, frame: TrackFrame) -> Prediction | None:
        """Predict the pixels of the state's landmarks in the next frame, with their covariance."""
        if self.state is None or not len(self.state.tracks):
            return None
        state = self.state.predicted(self.camera, frame)
        order = np.argsort(state.tracks)
        # With pixels of zero the residual is minus the prediction. The state is sorted by track because a `Prediction`
        # is.
        nowhere = replace(frame, tracks=state.tracks[order], uv_px=np.zeros((len(order), 2)), ranges=())
        measured = FrameMeasurements.of(self.camera, state, nowhere)
        innovation = measured.innovation(state)
        # H P H' without R: the matching adds the noise of the features.
        covariance = innovation.jacobian @ state.covariance @ innovation.jacobian.T
        return Prediction(
            state.tracks[measured.rows], -innovation.residual.reshape(-1, 2), covariance + measured.second_order(state)
        )

    def _without_lost(self, state: FilterState, frame: TrackFrame) -> FilterState:
        """Drop landmarks that are out of view."""
        lost = ~np.isin(state.tracks, frame.tracks)
        kept = int(np.count_nonzero(~lost))
        if kept < self.options.connectivity:
            raise LostError(f"tracks are lost: {kept} landmarks are left, {self.options.connectivity} are needed")
        return state.without(lost)

    def _updated(self, state: FilterState, frame: TrackFrame) -> FilterState:
        """Update with the pixels that pass the gate, and test the innovation."""
        measured = FrameMeasurements.of(self.camera, state, frame)
        try:
            if self.options.gate != "none":
                fit = self._gated(state, measured)
                self._count_refusals(state.tracks[measured.rows].tolist(), fit)
                measured = measured.subset(fit)
            if not np.isfinite(measured.residual(state)).all():
                raise LostError("the filter diverges: a landmark is behind the camera that sees it")
            state, squared = self.update(state, measured)
        except np.linalg.LinAlgError as error:
            raise LostError("the filter diverges: the innovation has no positive definite covariance") from error
        self.innovation.add(squared, len(measured.variance))
        if np.any(state.landmarks[:, 2] <= 0.0):
            raise LostError("the filter diverges: an inverse distance is not positive")
        # The landmark is more likely wrong than several pixels in a row; `_with_new` initialises it again from this
        # frame.
        wrong = [track for track, times in self.in_a_row.items() if times >= self.options.refusals_max]
        return state.without(np.isin(state.tracks, wrong))

    def _gated(self, state: FilterState, measured: FrameMeasurements) -> BoolArray:
        """(k,) which pixels pass the gate.

        The prediction of a landmark of unknown distance is uncertain and nonlinear if the camera's position is. As in
        one-point RANSAC (Civera et al. 2010), landmarks of known distance update the camera first, and the others are
        gated after this update.
        """
        gate, false_alarm = self.options.gate, self.options.false_alarm
        fit = _gate(state, measured, gate, false_alarm)
        known = state.inverse_sigmas[measured.rows] < _KNOWN
        first = fit & known
        if gate != "one-point" or known.all() or np.count_nonzero(first) < _FEWEST:
            return fit
        # A trial update, for the gate alone: the filter itself is updated once, with all pixels that pass.
        moved, _ = self.update(state, measured.subset(first))
        fit[~known] = _gate(moved, measured.subset(~known), "individual", false_alarm)
        return fit

    def _count_refusals(self, tracks: list[int], fit: BoolArray) -> None:
        """Count which tracks of a frame failed the gate, in a row too; raise LostError if too many did."""
        self.in_a_row = {
            track: self.in_a_row.get(track, 0) + 1 for track, good in zip(tracks, fit, strict=True) if not good
        }
        self.refused += len(self.in_a_row)
        self.gated.append((len(self.in_a_row), len(fit)))
        refused, seen = (sum(item[i] for item in self.gated) for i in (0, 1))
        if len(self.gated) == self.gated.maxlen and refused > _MAX_REFUSED_SHARE * seen:
            raise LostError(f"the filter diverges: {refused} of {seen} pixels of the last frames do not fit")

    def _with_new(self, state: FilterState, frame: TrackFrame) -> FilterState:
        """Add new tracks to the state: at their measured range, or at a guessed distance."""
        fresh = ~np.isin(frame.tracks, state.tracks)
        if not fresh.any():
            return state
        if len(state.tracks):
            lines = state.points(self.camera) - state.position_m
            # The mean of inverses, because rho is the variable with a Gaussian error.
            guess = float(np.mean(1.0 / np.linalg.norm(lines, axis=1)))
        elif frame.ranges:
            guess = float(np.mean([1.0 / item.range_m for item in frame.ranges]))
        else:
            raise LostError("no range is measured at the first frame: the scale is unobservable")
        tracks = frame.tracks[fresh]
        # u, v, rho of eq. (8), and the diagonal of eq. (11): R_y twice, R_rho. Attitude and anchor are added by
        # `augmented`.
        elements = np.column_stack([frame.uv_px[fresh], np.full(len(tracks), guess)])
        noise = np.tile(
            [frame.sigma_px**2, frame.sigma_px**2, (self.options.depth_sigma * guess) ** 2], (len(tracks), 1)
        )
        for item in frame.ranges:
            row = tracks == item.track
            # rho = 1 / d, so sigma_rho = sigma_d / d^2: the depth gauge of section 3.3, and later ranges of new
            # landmarks.
            elements[row, 2] = 1.0 / item.range_m
            noise[row, 2] = (item.sigma_m / item.range_m**2) ** 2
        return state.augmented(tracks, elements, noise)


def _gate(state: FilterState, measured: FrameMeasurements, gate: Gate, false_alarm: float) -> BoolArray:
    """(k,) which pixels pass one gate; a measured range is not gated, but goes with its pixel."""
    innovation = measured.innovation(state)
    size = measured.uv_px.size
    residual, H = innovation.residual[:size].reshape(-1, 2), innovation.jacobian
    S = H @ state.covariance @ H.T + np.diag(innovation.variance)
    covariance = 0.5 * (S + S.T)[:size, :size] + measured.second_order(state)
    # NaN: behind the camera.
    fit = np.asarray(np.isfinite(residual).all(axis=1), dtype=np.bool_)
    both = np.repeat(fit, 2)
    fit[fit] = gate_pixels(residual[fit], covariance[np.ix_(both, both)], gate, false_alarm)
    return fit

"""Orbit determination on an approach, from positions that an estimator of single images measures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from boresight.estimators.contract import Estimate
from boresight.estimators.orbit.batch_filter import BatchFilter, BatchState, DataArc
from boresight.estimators.orbit.contract import CentreInCamera, OrbitEstimate
from boresight.estimators.orbit.model import MeasurementModel
from boresight.estimators.orbit.parameters import ParameterLayout
from boresight.estimators.prior import shares_of_prior
from boresight.scenarios.arrays import FloatArray, Image, IndexArray
from boresight.scenarios.dynamics.propagation import OrbitLostError
from boresight.scenarios.geometry import Camera, Pose, View
from boresight.scenarios.geometry.pose import cross_matrix
from boresight.scenarios.observation import Frame, Observation
from boresight.scenarios.orbits.data import Knowledge, LandmarkFile, OrbitData, Pictures, PositionFixes, Radiometry

_LEAST_GAIN = 0.1
"""Share of the prior's variance by which an estimate reduces it in a direction, at least, to be a measurement of it."""
_LEAST_FIXES = 3


@dataclass(frozen=True, slots=True, eq=False)
class ApproachTask:
    """A priori data of an approach, without its images.

    The images (I) have times (I,), ascending, s, and reported attitudes (I, 3, 3). ``centre_of_mass_m`` (3,) is in the
    axes of the shape, and ``sun_dir`` (3,) a unit vector towards the Sun, inertial axes. ``wanted_s`` (E,) are the
    requested times of the orbit, s.
    """

    times_s: FloatArray
    R_cam_inertial: FloatArray
    knowledge: Knowledge
    centre_of_mass_m: FloatArray
    sun_dir: FloatArray
    radiometry: Radiometry | None
    wanted_s: FloatArray

    def data(self, count: int, fixes: PositionFixes, wanted_s: FloatArray) -> OrbitData:
        """Collect the data of the first ``count`` images, without landmarks, for an orbit at other times (E,)."""
        none = np.zeros(0, dtype=np.int64)
        pictures = Pictures(self.times_s[:count], self.R_cam_inertial[:count], none, none, np.zeros((0, 2)))
        landmarks = LandmarkFile(none, np.zeros((0, 3)), np.zeros(0))
        return OrbitData(self.knowledge, pictures, landmarks, self.radiometry, wanted_s, fixes)

    def frame(self, number: int, image: Image, centre: CentreInCamera) -> Frame:
        """Add the prior to an image, whose centre of mass the filter predicts.

        The position's error is that of all unknowns of the filter together, and of the image's attitude, which moves
        the body in the image. The rotation has the errors of attitude, mounting and spin. The prior has no covariance
        of the position with the rotation.
        """
        known, time_s = self.knowledge, float(self.times_s[number])
        attitude = centre.mounting @ self.R_cam_inertial[number]
        rotation = attitude @ known.field.rotation.at(np.array([time_s]))[0].T
        across = cross_matrix(centre.position_m)
        covariance = np.zeros((6, 6))
        spun_rad = known.spin_sigma * known.field.rotation.rate_rad_s * time_s
        covariance[:3, :3] = (known.attitude_sigma_rad**2 + known.pole_sigma_rad**2 + spun_rad**2) * np.eye(3)
        covariance[:3, :3] += centre.mounting_covariance_rad2
        covariance[3:, 3:] = centre.covariance_m2 + known.attitude_sigma_rad**2 * across @ across.T
        covariance = 0.5 * (covariance + covariance.T)
        prior = Pose(rotation, centre.position_m - rotation @ self.centre_of_mass_m)
        return Frame(image, attitude @ self.sun_dir, prior, covariance, time_s)


class ApproachNavigator:
    """Determines the orbit image by image: the orbit by the images before is the prior of the next one.

    Where an estimate contradicts its prior, or a fit is rejected, a fix is wrong, and not always the last one: that is
    left out for good without which the others fit best.
    """

    def __init__(self, task: ApproachTask, orbit: BatchFilter) -> None:
        self._task, self._filter = task, orbit
        self._fixes: list[tuple[int, FloatArray, Measured]] = []
        self._gated: list[int] = []
        self._failed = 0
        self._seconds = 0.0

    def frame(self, number: int, image: Image) -> Frame | None:
        """Add the prior to an image; None if the filter has no orbit that it accepts.

        The mounting and the focal length are those that the fixes before tell.
        """
        time_s = float(self._task.times_s[number])
        # Not at the times after this one: while the orbit is uncertain, it may lead into the body later.
        found = self._accepted(number + 1, np.unique([0.0, time_s]))
        centre = None if found.orbit is None else found.orbit.centre
        return None if found.status != "ok" or centre is None else self._task.frame(number, image, centre)

    def add(self, number: int, frame: Frame, estimate: Estimate) -> None:
        """Take what an estimate adds to the prior of an image as a fix; where the two contradict each other, drop one.

        Images must be added in turn, each with the frame by `frame`.
        """
        if estimate.status != "ok" or estimate.pose is None or estimate.covariance is None:
            self._failed += 1
            return
        centre_m, found_m = (
            pose.translation_m + pose.rotation @ self._task.centre_of_mass_m
            for pose in (frame.prior_T_cam_body, estimate.pose)
        )
        common_m = np.zeros(3) if estimate.common is None else estimate.common[3:]
        prior_m2, stated_m2 = frame.prior_covariance[3:, 3:], estimate.covariance[3:, 3:]
        fix = measurement_of(prior_m2, found_m - centre_m, stated_m2, common_m)
        if fix is None:
            self._failed += 1
            return
        self._fixes.append((number, centre_m + fix.moved_m, fix))
        if fix.contradicts(self._filter.options.edit_sigma):
            self._drop_one(number + 1, np.zeros(1))

    def result(self) -> tuple[OrbitEstimate, OrbitData]:
        """Determine the orbit of all images; also return the data that it rests on."""
        count = len(self._task.times_s)
        found = self._accepted(count, self._task.wanted_s)
        data = self._task.data(count, _collected(self._fixes), self._task.wanted_s)
        counts = {"fixes": len(self._fixes), "failed_images": self._failed, "gated_images": len(self._gated)}
        reason = found.reason
        if found.status == "ok" and len(self._fixes) < _LEAST_FIXES:
            reason = f"{len(self._fixes)} of {count} images have a fix: at least {_LEAST_FIXES} are needed"
            found = OrbitEstimate("failed", None)
        if reason and self._gated:
            numbers = ", ".join(str(number + 1) for number in sorted(self._gated))
            reason += f"; left out, as they contradict others: images {numbers}"
        diagnostics = {**found.diagnostics, **counts}
        return replace(found, reason=reason, diagnostics=diagnostics, seconds=self._seconds), data

    def _accepted(self, count: int, wanted_s: FloatArray) -> OrbitEstimate:
        """Determine the orbit at some times (E,) by the fixes of ``count`` images; drop fixes until it is accepted."""
        found = self._determined(count, wanted_s)
        while found.status != "ok" and self._fixes:
            found = self._drop_one(count, wanted_s)
        return found

    def _drop_one(self, count: int, wanted_s: FloatArray) -> OrbitEstimate:
        """Drop the fix without which the others have the least chi-square; return the orbit without it."""
        fixes, found = self._fixes, []
        for row in range(len(fixes)):
            self._fixes = [*fixes[:row], *fixes[row + 1 :]]
            found.append(self._determined(count, wanted_s))
        # A fit that diverged has none.
        best = int(np.argmin([one.diagnostics.get("chi_square_per_freedom", np.inf) for one in found]))
        self._gated.append(fixes[best][0])
        self._fixes = [*fixes[:best], *fixes[best + 1 :]]
        return found[best]

    def _determined(self, count: int, wanted_s: FloatArray) -> OrbitEstimate:
        found = self._filter.determine(self._task.data(count, _collected(self._fixes), wanted_s))
        self._seconds += found.seconds
        return found


def _collected(fixes: Sequence[tuple[int, FloatArray, Measured]]) -> PositionFixes:
    """Collect fixes: number of the image, position of the centre of mass in the camera, and what is measured of it."""
    rows: IndexArray = np.array([number for number, _, _ in fixes], dtype=np.int64)
    positions = np.array([one for _, one, _ in fixes], dtype=np.float64).reshape(-1, 3)
    information = np.array([one.information for _, _, one in fixes], dtype=np.float64).reshape(-1, 3, 3)
    common = np.array([one.common_m for _, _, one in fixes], dtype=np.float64).reshape(-1, 3)
    return PositionFixes(rows, positions, information, common)


def predict_orbit(
    task: ApproachTask,
    orbit: BatchFilter,
    camera: Camera,
    views: Sequence[View],
    predict: Callable[[Observation], Estimate | None],
) -> FloatArray | None:
    """Predict the covariance (6, 6) of the state at the epoch, m and m/s, from the views (I) of all images.

    ``predict`` gives the covariance of the estimate in a view, with the error that is common to all, or None where it
    has none. Derivatives are those at the a priori values of ``task``, whose orbit is the planned one: it is propagated
    once, and the images before give the covariance of the prior of the next. The result is None if there are too few
    fixes, or the orbit leads into the body.
    """
    fixes: list[tuple[int, FloatArray, Measured]] = []
    layout = ParameterLayout.of(task.data(len(views), _collected(fixes), task.wanted_s), orbit.options)
    x, nothing = np.zeros(layout.size), np.zeros((0, 0), dtype=np.float32)

    def by_first(count: int) -> MeasurementModel:
        data = task.data(count, _collected(fixes), task.wanted_s)
        start = BatchState.initial(data, layout)
        return DataArc.until(data, layout, orbit.options, start, float(task.times_s[count - 1])).model

    def covariance_by(model: MeasurementModel) -> FloatArray:
        by_shared = model.tracking(x, flown).by_shared
        covariance = np.asarray(np.linalg.inv(layout.information + by_shared.T @ by_shared), dtype=np.float64)
        return model.considered(x, flown, covariance)

    try:
        # The epochs of the first images are the first ones of all, so that the rows of one propagation serve them.
        flown = by_first(len(views)).propagate(x)
    except OrbitLostError:
        return None
    for number, view in enumerate(views):
        model = by_first(number + 1)
        centre = model.last_centre(x, flown, covariance_by(model))
        if centre is None:
            return None
        frame = task.frame(number, nothing, centre)
        pose, prior_m2 = view.T_cam_body, frame.prior_covariance[3:, 3:]
        sun_dir = pose.rotate(view.sun_dir_body)
        found = predict(Observation(camera, replace(frame, sun_dir_cam=sun_dir, prior_T_cam_body=pose)))
        if found is not None and found.covariance is not None:
            common_m = np.zeros(3) if found.common is None else found.common[3:]
            fix = measurement_of(prior_m2, np.zeros(3), found.covariance[3:, 3:], common_m)
            fixes += [] if fix is None else [(number, pose.transform(task.centre_of_mass_m), fix)]
    if len(fixes) < _LEAST_FIXES:
        return None
    scale = layout.state_sigma
    return np.asarray(covariance_by(by_first(len(views)))[:6, :6] * np.outer(scale, scale))


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """The measurement of a position that turned a prior into an estimate.

    ``moved_m`` (3,) is the measured position less that of the prior, and ``information`` (3, 3), 1/m^2, the inverse of
    its covariance; ``common_m`` (3,) is one standard deviation of the part of its error that all images share. They are
    0 in directions that are not measured. ``squared`` is the squared length of the innovation in its standard
    deviations, prior and measurement together, in the ``directions`` that are measured.
    """

    moved_m: FloatArray
    information: FloatArray
    common_m: FloatArray
    squared: float
    directions: int

    def contradicts(self, sigmas: float) -> bool:
        """Whether a chi-square test rejects the innovation, with a degree of freedom for each direction.

        It rejects right ones with the probability at which one normal number exceeds ``sigmas`` standard deviations.
        """
        return bool(chdtrc(self.directions, self.squared) < chdtrc(1, sigmas**2))


def measurement_of(
    prior_m2: FloatArray, step_m: FloatArray, stated_m2: FloatArray, common_m: FloatArray
) -> Measured | None:
    """Return the measurement that turned a prior into an estimate.

    An estimate that moves the prior's position by ``step_m`` (3,) and changes its covariance (3, 3) from ``prior_m2``
    to ``stated_m2`` is the prior with a linear measurement of the position: its information is the difference of the
    inverse covariances. ``common_m`` (3,) is what the error that all images share does to the estimate. Directions
    whose variance falls by less than a tenth are left out, as they would be differences of nearly equal numbers. The
    filter can so use the measurement without the prior, which rests on the same data.

    The result is None if no direction is measured, or if a covariance is not positive definite.
    """
    try:
        left, axes = shares_of_prior(stated_m2, prior_m2)
    except np.linalg.LinAlgError:
        return None
    measured = left < 1.0 - _LEAST_GAIN
    if not measured.any() or left[0] <= 0.0:
        return None
    left, axes = left[measured], axes[:, measured]
    # In these axes the prior has variance 1, the measurement v = left / (1 - left), and the step is y / (1 + v).
    innovation, common = (axes.T @ one / (1.0 - left) for one in (step_m, common_m))
    information = axes @ np.diag((1.0 - left) / left) @ axes.T
    squared = float(np.sum(innovation**2 * (1.0 - left)))
    back = prior_m2 @ axes
    return Measured(back @ innovation, 0.5 * (information + information.T), back @ common, squared, len(left))

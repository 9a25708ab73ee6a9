"""Residuals of sightings and radiometric data with their derivatives, for given values of the unknowns."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from boresight.estimators.orbit.contract import CentreInCamera
from boresight.estimators.orbit.parameters import ParameterLayout
from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.dynamics.propagation import OrbitPartials, propagate_partials
from boresight.scenarios.geometry.pose import cross_matrix
from boresight.scenarios.orbits.data import OrbitData, PositionFixes, Radiometry

_NEAREST_M = 1.0  # depths below it are held, so that a landmark behind the camera gives finite numbers
_FLIGHTS_KEPT = 2
_MEASURED = 1e-12  # of the largest information of a fix: directions with less are not measured
_SPIN_STEP = 0.1  # of an unknown of the spin, in its sigma, for differences


@dataclass(frozen=True, slots=True, eq=False)
class Unknowns:
    """Shared unknowns ``x`` (n,), pan and tilt of each image (I, 2) rad, landmarks (L, 3) m in body axes."""

    x: FloatArray
    tilts: FloatArray
    points: FloatArray


@dataclass(frozen=True, eq=False)
class Measurements:
    """The measurements of an arc of I images and ``count`` landmarks; its K sightings are sorted by landmark.

    The images have times (I,) and attitudes (I, 3, 3). ``image`` and ``point`` (K,) are rows of image and landmark of
    each sighting; ``point`` ascends. ``uv_px`` is (K, 2), and ``sigma_px`` (K,) that of one coordinate, with the effect
    of the camera's roll error, which is not estimated.
    """

    times_s: FloatArray
    R_cam_inertial: FloatArray
    image: IndexArray
    point: IndexArray
    uv_px: FloatArray
    sigma_px: FloatArray
    count: int
    radiometry: Radiometry | None
    fixes: PositionFixes | None = None

    @cached_property
    def begin(self) -> IndexArray:
        """Return (L + 1,) the first row of each landmark's sightings."""
        return np.searchsorted(self.point, np.arange(self.count + 1)).astype(np.int64)

    @cached_property
    def epochs_s(self) -> FloatArray:
        """Return the times at which the orbit is needed, ascending."""
        return np.unique(self.times_s if self.radiometry is None else np.r_[self.times_s, self.radiometry.times_s])

    @cached_property
    def image_epoch(self) -> IndexArray:
        """Return (I,) the row of each image's time in ``epochs_s``."""
        return np.searchsorted(self.epochs_s, self.times_s).astype(np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class SightingResiduals:
    """Residuals (observed minus predicted), px, and derivatives of the prediction, px per unit.

    ``residuals`` are (K, 2). ``by_image`` (K, 2, 7) is by the camera's inertial position, its rotation about its axes,
    and the relative focal length, and ``by_point`` (K, 2, 3) by the landmark's position in body axes. ``in_front`` (K,)
    is whether the landmark is in front of the camera.
    """

    residuals: FloatArray
    by_image: FloatArray
    by_point: FloatArray
    in_front: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class TrackingResiduals:
    """Residuals of ranges, range rates and fixes in sigmas, (M,), and derivatives of the prediction by ``x``, (M, n).

    The last ``fixes`` of them are those of fixes.
    """

    residuals: FloatArray
    by_shared: FloatArray
    fixes: int = 0


@dataclass(frozen=True, eq=False)
class MeasurementModel:
    """Predicts the measurements of an arc."""

    layout: ParameterLayout
    measured: Measurements

    @cached_property
    def directions(self) -> MeasuredDirections | None:
        """Return what the fixes measure; None without fixes."""
        return None if self.measured.fixes is None else measured_directions(self.measured.fixes, self.layout)

    def propagate(self, x: FloatArray) -> OrbitPartials:
        """Propagate the orbit over the arc."""
        return propagate_orbit(self.layout, x, self.measured.epochs_s)

    def shared(self, unknowns: Unknowns, flown: OrbitPartials) -> FloatArray:
        """Return (I, 7, n) derivatives of each camera's position, rotation and focal length by the shared unknowns."""
        layout, known = self.layout, self.layout.knowledge
        found = np.zeros((len(self.measured.times_s), 7, layout.size))
        found[:, :3] = state_derivatives(layout, unknowns.x, flown, slice(0, 3))[self.measured.image_epoch]
        mounting = layout.part("mounting")
        if mounting.stop > mounting.start:
            # A rotation w of the mounting is one of T w about the camera, as the tilt T is applied after it: T exp(w) =
            # exp(T w) T.
            found[:, 3:6, mounting] = known.misalignment_sigma_rad * _tilt_rotations(unknowns.tilts)
        found[:, 6, layout.part("focal")] = known.focal_sigma
        if not layout.spin_is_known:
            # A body turned by -w about its centre looks as if the camera at r were moved by w x r and turned by -w.
            turned = self._spin_derivatives(unknowns.x)
            positions = flown.states[self.measured.image_epoch, :3]
            found[:, :3, layout.spin] += np.swapaxes(np.cross(np.swapaxes(turned, 1, 2), positions[:, None]), 1, 2)
            found[:, 3:6, layout.spin] = -self.attitudes(unknowns) @ turned
        return found

    def _spin_derivatives(self, x: FloatArray) -> FloatArray:
        """Return (I, 3, s) rotations w of the inertial axes about the body, inertial axes, by the unknowns of the spin.

        R_inertial_body is exp(-w) times that at ``x``: the pole is turned in body axes at the epoch, and the angle of
        the rotation grows with the rate. The derivative by the pole leaves out products of its correction.
        """
        known, rotation, times = self.layout.knowledge, self.layout.rotation(x), self.measured.times_s
        to_inertial, parts = rotation.R_body_inertial.T, []
        if known.pole_sigma_rad > 0.0:
            parts.append(np.broadcast_to(known.pole_sigma_rad * to_inertial[:, :2], (len(times), 3, 2)))
        if known.spin_sigma > 0.0:
            angles = known.spin_sigma * self.layout.field.rotation.rate_rad_s * times
            parts.append(-angles[:, None, None] * to_inertial[:, 2:])
        return np.concatenate(parts, axis=2)

    def sightings(self, unknowns: Unknowns, flown: OrbitPartials) -> SightingResiduals:
        """Predict the pixel of each sighting."""
        measured, layout = self.measured, self.layout
        image, camera = measured.image, layout.knowledge.camera
        focal = 1.0 + layout.focal(unknowns.x)
        turns = self.attitudes(unknowns)
        positions = flown.states[measured.image_epoch, :3]
        R_body_inertial = layout.rotation(unknowns.x).at(measured.times_s)[image]
        inertial = np.einsum("kji,kj->ki", R_body_inertial, unknowns.points[measured.point]) - positions[image]
        x, y, z = np.einsum("kij,kj->ik", turns[image], inertial)
        in_front = z > _NEAREST_M
        # Held, so that the projection stays finite; such sightings have weight 0 in the step and a fixed cost.
        z = np.where(in_front, z, _NEAREST_M)
        across, down = focal * camera.fx_px * x / z, focal * camera.fy_px * y / z
        # u = f x / z, v = f y / z: du/dx = f / z and du/dz = -u / z.
        by_cam = np.zeros((len(z), 2, 3))
        by_cam[:, 0, 0], by_cam[:, 0, 2] = focal * camera.fx_px / z, -across / z
        by_cam[:, 1, 1], by_cam[:, 1, 2] = focal * camera.fy_px / z, -down / z
        by_inertial = by_cam @ turns[image]
        by_image = np.empty((len(z), 2, 7))
        # The point in the camera is R (landmark - position).
        by_image[:, :, :3] = -by_inertial
        # A rotation w on the left moves the camera coordinates p by w x p: d(uv)/dw = p x d(uv)/dp, row by row.
        by_image[:, :, 3:6] = np.cross(np.stack([x, y, z], -1)[:, None], by_cam)
        # The focal length has the factor 1 + df, so that the derivative by df is the offset at df = 0.
        by_image[:, 0, 6], by_image[:, 1, 6] = across / focal, down / focal
        # Body to inertial axes: the transpose of R_body_inertial.
        by_point = by_inertial @ np.swapaxes(R_body_inertial, 1, 2)
        seen = measured.uv_px - [camera.cx_px, camera.cy_px]
        return SightingResiduals(seen - np.stack([across, down], -1), by_image, by_point, in_front)

    def attitudes(self, unknowns: Unknowns) -> FloatArray:
        """Return (I, 3, 3) R_cam_inertial: own error of the image times misalignment times telemetered attitude."""
        mounting = Rotation.from_rotvec(self.layout.mounting(unknowns.x)).as_matrix()
        return np.asarray(_tilt_rotations(unknowns.tilts) @ mounting @ self.measured.R_cam_inertial)

    def tracking(self, x: FloatArray, flown: OrbitPartials) -> TrackingResiduals:
        """Predict what does not depend on landmarks: ranges and range rates, then fixes."""
        passes = self.passes(x, flown)
        if self.measured.fixes is None or self.directions is None:
            return passes
        fixed = self.fixed(self.measured.fixes, self.directions, x, flown)
        residuals = np.r_[passes.residuals, fixed.residuals]
        return TrackingResiduals(residuals, np.vstack([passes.by_shared, fixed.by_shared]), len(fixed.residuals))

    def fixed(
        self, fixes: PositionFixes, found: MeasuredDirections, x: FloatArray, flown: OrbitPartials
    ) -> TrackingResiduals:
        """Predict the measured positions of the body's centre of mass: those directions that are measured.

        The error of each attitude is part of the noise of its fix, and no unknown.
        """
        centre_m, by_shared = self.centres(x, flown, fixes.image[found.fix])
        residuals = np.einsum("ki,ki->k", found.rows, fixes.position_cam_m[found.fix] - centre_m)
        return TrackingResiduals(residuals, np.einsum("ki,kip->kp", found.rows, by_shared))

    def considered(self, x: FloatArray, flown: OrbitPartials, covariance: FloatArray) -> FloatArray:
        """Add what the error that all fixes share does to the unknowns to their covariance (n, n).

        The fixes are weighted as if their errors were independent, and the common one is considered: no unknown, as it
        is not quite constant. With c_i one standard deviation of it in fix i and H_i the derivatives, both whitened,
        s_i = P H_i^T c_i is what it does by that fix. P contains each s_i s_i^T, and the covariance is P + S S^T - sum
        of s_i s_i^T, S being the sum of the s_i.
        """
        fixes, found = self.measured.fixes, self.directions
        if fixes is None or found is None:
            return covariance
        common = np.einsum("ki,ki->k", found.rows, fixes.common_m[found.fix])
        moved = np.zeros((len(fixes.image), self.layout.size))
        np.add.at(moved, found.fix, self.fixed(fixes, found, x, flown).by_shared * common[:, None])
        moved = moved @ covariance
        total = moved.sum(axis=0)
        return covariance + np.outer(total, total) - moved.T @ moved

    def centres(self, x: FloatArray, flown: OrbitPartials, images: IndexArray) -> tuple[FloatArray, FloatArray]:
        """Predict where some images (K,) show the centre of mass (K, 3), m, camera axes, by the nominal focal length.

        Also return the derivatives (K, 3, n) by the shared unknowns.
        """
        layout, measured = self.layout, self.measured
        epochs = measured.image_epoch[images]
        mounting = Rotation.from_rotvec(layout.mounting(x)).as_matrix()
        turns = mounting @ measured.R_cam_inertial[images]
        centre_m = -np.einsum("kij,kj->ki", turns, flown.states[epochs, :3])
        by_shared = -turns @ state_derivatives(layout, x, flown, slice(0, 3))[epochs]
        # A rotation w of the mounting, on the left, moves p by w x p.
        part, known = layout.part("mounting"), layout.knowledge
        if part.stop > part.start:
            by_shared[:, :, part] -= known.misalignment_sigma_rad * cross_matrix(centre_m)
        # A longer focal length shows the body larger and farther off the axis, as from a smaller depth.
        by_shared[:, 2, layout.part("focal")] -= known.focal_sigma * centre_m[:, 2:]
        centre_m[:, 2] /= 1.0 + layout.focal(x)
        return centre_m, by_shared

    def last_centre(self, x: FloatArray, flown: OrbitPartials, covariance: FloatArray) -> CentreInCamera | None:
        """Return where the last image shows the centre of mass, by unknowns with a covariance (n, n).

        None without fixes.
        """
        if self.measured.fixes is None:
            return None
        last = np.array([len(self.measured.times_s) - 1])
        (centre_m,), (by_shared,) = self.centres(x, flown, last)
        sigma_rad, part = self.layout.knowledge.misalignment_sigma_rad, self.layout.part("mounting")
        of_mounting = sigma_rad**2 * covariance[part, part] if part.stop > part.start else np.zeros((3, 3))
        return CentreInCamera(
            position_m=centre_m,
            covariance_m2=by_shared @ covariance @ by_shared.T,
            mounting=Rotation.from_rotvec(self.layout.mounting(x)).as_matrix(),
            mounting_covariance_rad2=of_mounting,
        )

    def passes(self, x: FloatArray, flown: OrbitPartials) -> TrackingResiduals:
        """Predict ranges and range rates."""
        layout, radio = self.layout, self.measured.radiometry
        if radio is None:
            return TrackingResiduals(np.zeros(0), np.zeros((0, layout.size)))
        rows = np.searchsorted(self.measured.epochs_s, radio.times_s)
        states = flown.states[rows]
        motion = state_derivatives(layout, x, flown, slice(0, 6))[rows]
        # The Earth is so far that the range changes by -d . r, with d the direction to it.
        by_range = -np.einsum("i,nip->np", radio.earth_dir, motion[:, :3])
        by_rate = -np.einsum("i,nip->np", radio.earth_dir, motion[:, 3:])
        by_range[:, layout.part("bias")] = layout.bias_sigma_m
        ranges = radio.range_m - (layout.bias_m(x) - states[:, :3] @ radio.earth_dir)
        rates = radio.range_rate_m_s + states[:, 3:] @ radio.earth_dir
        residuals = np.r_[ranges / radio.range_sigma_m, rates / radio.range_rate_sigma_m_s]
        # Whitened: in units of their sigmas, as the residuals are.
        by = np.vstack([by_range / radio.range_sigma_m, by_rate / radio.range_rate_sigma_m_s])
        # Passes without a range or a rate hold NaN.
        there = np.isfinite(residuals)
        return TrackingResiduals(residuals[there], by[there])


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredDirections:
    """Fixes as M scalars of variance 1: ``rows`` (M, 3), 1/m, times the position, m, of the numbers ``fix`` (M,)."""

    fix: IndexArray
    rows: FloatArray


def measured_directions(fixes: PositionFixes, layout: ParameterLayout) -> MeasuredDirections:
    """Whiten the directions that fixes measure, with the error of the attitude of each image."""
    rows, fix = [np.zeros((0, 3))], []
    attitude = layout.knowledge.attitude_sigma_rad * cross_matrix(fixes.position_cam_m)
    for i, (information, turned) in enumerate(zip(fixes.information, attitude, strict=True)):
        values, vectors = np.linalg.eigh(information)
        known = values > _MEASURED * max(values[-1], 0.0)
        across = vectors[:, known].T
        noise = np.diag(1.0 / values[known]) + across @ turned @ turned.T @ across.T
        rows.append(np.linalg.solve(np.linalg.cholesky(noise), across))
        fix += [i] * int(known.sum())
    return MeasuredDirections(np.array(fix, dtype=np.int64), np.concatenate(rows))


def _tilt_rotations(tilts: FloatArray) -> FloatArray:
    """Return (I, 3, 3) rotations by pan and tilt."""
    vectors = np.column_stack([tilts, np.zeros(len(tilts))])
    return np.asarray(Rotation.from_rotvec(vectors).as_matrix())


def propagate_orbit(layout: ParameterLayout, x: FloatArray, times_s: FloatArray) -> OrbitPartials:
    """Propagate the orbit for given unknowns; one of the last propagations is returned if it is the same.

    Derivatives by the unknowns of the spin, if there are any, follow those by the field's parameters.
    """
    # Line search, splitting and editing need the same orbit again, and its propagation costs most.
    key = (x.tobytes(), times_s.tobytes())
    if key not in layout.flights:
        end = float(times_s[-1]) if len(times_s) else 1.0
        flown = propagate_partials(layout.field_at(x), layout.state(x), times_s, layout.pushes(x, end))
        if not layout.spin_is_known:
            flown = replace(flown, by_parameters=np.dstack([flown.by_parameters, _by_spin(layout, x, times_s, flown)]))
        if len(layout.flights) == _FLIGHTS_KEPT:
            del layout.flights[next(iter(layout.flights))]
        layout.flights[key] = flown
    return layout.flights[key]


def _by_spin(layout: ParameterLayout, x: FloatArray, times_s: FloatArray, flown: OrbitPartials) -> FloatArray:
    """Return (T, 6, s) derivatives of the states by the unknowns of the spin: gravity turns with the body."""
    end, found = float(times_s[-1]) if len(times_s) else 1.0, []
    for row in range(layout.spin.start, layout.spin.stop):
        moved = x.copy()
        moved[row] += _SPIN_STEP
        # The equations of variation have no such derivative; forward differences of fixed steps are smooth.
        there = propagate_partials(layout.field_at(moved), layout.state(x), times_s, layout.pushes(x, end))
        found.append((there.states - flown.states) / _SPIN_STEP)
    return np.stack(found, axis=2)


def state_derivatives(layout: ParameterLayout, x: FloatArray, flown: OrbitPartials, rows: slice) -> FloatArray:
    """Return the (T, rows, n) derivatives of the propagated state by the shared unknowns."""
    found = np.zeros((len(flown.states), rows.stop - rows.start, layout.size))
    found[:, :, layout.part("state")] = flown.by_state[:, rows] * layout.state_sigma
    by_forces = flown.by_parameters[:, rows][:, :, layout.forces]
    found[:, :, layout.part("forces")] = by_forces * layout.force_scale(x)
    found[:, :, layout.spin] = flown.by_parameters[:, rows, layout.field.parameters :]
    if layout.pieces:
        found[:, :, layout.part("pushes")] = flown.by_pushes[:, rows] * layout.knowledge.noise_m_s2
    return found


def measurements_until(
    data: OrbitData, until_s: float, numbering: IndexArray, kept: BoolArray, with_radiometry: bool
) -> tuple[Measurements, IndexArray]:
    """Take the measurements up to a time; also return the rows of ``data.pictures`` of the sightings.

    ``numbering`` (K,) is the row of the landmark of every sighting of the data, and ``kept`` (K,) which of them to
    take.
    """
    pictures, known = data.pictures, data.knowledge
    images = int(np.searchsorted(pictures.times_s, until_s, side="right"))
    rows = np.flatnonzero(kept & (pictures.image < images))
    # Sorted by landmark, as the kernels eliminate one landmark after another.
    rows = rows[np.argsort(numbering[rows], kind="stable")]
    off_axis = np.linalg.norm(pictures.uv_px[rows] - [known.camera.cx_px, known.camera.cy_px], axis=1)
    radio = data.radiometry if with_radiometry else None
    if radio is not None:
        n = int(np.searchsorted(radio.times_s, until_s, side="right"))
        radio = replace(
            radio, times_s=radio.times_s[:n], range_m=radio.range_m[:n], range_rate_m_s=radio.range_rate_m_s[:n]
        )
    times, fixes = pictures.times_s[:images], data.fixes
    if fixes is not None:
        n = int(np.searchsorted(fixes.image, images))
        fixes = PositionFixes(fixes.image[:n], fixes.position_cam_m[:n], fixes.information[:n], fixes.common_m[:n])
    return (
        Measurements(
            times_s=times,
            R_cam_inertial=pictures.R_cam_inertial[:images],
            image=pictures.image[rows],
            point=numbering[rows],
            uv_px=pictures.uv_px[rows],
            # The roll error displaces a pixel by its distance from the axis; a coordinate has half of its variance.
            sigma_px=np.hypot(known.noise_px, known.attitude_sigma_rad * off_axis / np.sqrt(2.0)),
            count=int(numbering.max(initial=-1)) + 1,
            radiometry=radio,
            fixes=fixes,
        ),
        rows,
    )

"""The state of the batch filter between its adjustments, and the data arc that each adjustment uses."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from boresight.estimators.orbit.kernels import consistent_rays
from boresight.estimators.orbit.model import MeasurementModel, Measurements, Unknowns, measurements_until
from boresight.estimators.orbit.parameters import OrbitOptions, ParameterLayout
from boresight.estimators.orbit.solve import GaussNewtonResult, HuberLoss, LandmarkPrior, StoppingCriteria, adjust
from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.geometry.triangulation import LinesOfSight, triangulation_equations
from boresight.scenarios.orbits.data import OrbitData

# Weight of the a priori position, against 1 for each line of sight: it fixes a point only where rays are parallel.
_ANCHOR_WEIGHT = 1e-4
_MIN_SIGHTINGS_OF_LANDMARK = 2
_MIN_SECOND_RAYS = 3


@dataclass(frozen=True, slots=True, eq=False)
class BatchState:
    """Estimates, and the assignment of sightings to landmarks, between two adjustments.

    ``x`` (n,) are shared unknowns, as `ParameterLayout` orders them, and ``tilts`` (I, 2) pan and tilt of all images,
    rad; 0 where they have not been estimated. ``points`` (L, 3) are landmarks, m, body axes; NaN where one has no
    position yet. There are more of them than landmark numbers once numbers have been split. ``numbering`` (K,) is the
    row of the landmark of each sighting; ``kept`` (K,) is False where a sighting was edited.
    """

    x: FloatArray
    tilts: FloatArray
    points: FloatArray
    numbering: IndexArray
    kept: BoolArray

    @classmethod
    def initial(cls, data: OrbitData, layout: ParameterLayout) -> BatchState:
        """Start from the a priori values; landmarks have no position until they are triangulated."""
        numbering = np.searchsorted(np.sort(data.landmarks.numbers), data.pictures.landmark)
        rows = np.argsort(data.landmarks.numbers)[numbering].astype(np.int64)
        nowhere = np.full((len(data.landmarks.numbers), 3), np.nan)
        kept = np.ones(len(rows), dtype=bool)
        return cls(np.zeros(layout.size), np.zeros((len(data.pictures.times_s), 2)), nowhere, rows, kept)


@dataclass(frozen=True, eq=False)
class DataArc:
    """The data up to an epoch, arranged for the adjustment.

    ``model`` predicts the measurements of the arc. ``rows`` (K',) are rows of ``data.pictures`` of its sightings, and
    ``landmarks`` (L',) rows of its landmarks in the state.
    """

    data: OrbitData
    layout: ParameterLayout
    options: OrbitOptions
    model: MeasurementModel
    rows: IndexArray
    landmarks: IndexArray

    @classmethod
    def until(
        cls, data: OrbitData, layout: ParameterLayout, options: OrbitOptions, solution: BatchState, end_s: float
    ) -> DataArc:
        """Take all kept sightings up to ``end_s`` of landmarks with at least two of them."""
        pictures = data.pictures
        here = solution.kept & (pictures.times_s[pictures.image] <= end_s)
        seen = np.bincount(solution.numbering[here], minlength=len(solution.points))
        # One line of sight leaves the depth of a free landmark undetermined, so that it says nothing on the orbit.
        here &= seen[solution.numbering] >= _MIN_SIGHTINGS_OF_LANDMARK
        landmarks = np.flatnonzero(seen >= _MIN_SIGHTINGS_OF_LANDMARK)
        compact = np.full(len(solution.points), -1, dtype=np.int64)
        compact[landmarks] = np.arange(len(landmarks))
        measured, rows = measurements_until(
            data, end_s, compact[solution.numbering], here, options.radiometry == "used"
        )
        return cls(data, layout, options, MeasurementModel(layout, measured), rows, landmarks)

    @property
    def measured(self) -> Measurements:
        """Return the measurements of the arc."""
        return self.model.measured

    def rays(self, x: FloatArray, tilts: FloatArray) -> LinesOfSight:
        """Convert the sightings to lines of sight in body axes."""
        measured, camera = self.measured, self.layout.knowledge.camera
        unknowns = Unknowns(x, tilts[: len(measured.times_s)], np.zeros((0, 3)))
        positions = self.model.propagate(x).states[measured.image_epoch, :3]
        seen = (measured.uv_px - [camera.cx_px, camera.cy_px]) / [camera.fx_px, camera.fy_px]
        # The estimated focal length is taken out of the observation: x / z = u / (f (1 + df)).
        rays = np.column_stack([seen / (1.0 + self.layout.focal(x)), np.ones(len(seen))])
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        turns = measured.R_body_inertial[measured.image]
        attitudes = self.model.attitudes(unknowns)[measured.image]
        # Camera to inertial by the transposed attitude, then inertial to body.
        directions = np.einsum("kij,klj,kl->ki", turns, attitudes, rays)
        return LinesOfSight(np.einsum("kij,kj->ki", turns, positions[measured.image]), directions)

    def unknowns(self, solution: BatchState) -> Unknowns:
        """Return the starting values of an adjustment; landmarks without a position are triangulated."""
        points = solution.points[self.landmarks].copy()
        new = np.isnan(points[:, 0])
        if new.any():
            rays = self.rays(solution.x, solution.tilts)
            anchors = np.zeros((len(self.data.landmarks.numbers), 3))
            anchors[:] = self.data.landmarks.positions_body_m
            anchor = anchors[np.minimum(self.landmarks, len(anchors) - 1)]
            prior = np.tile(_ANCHOR_WEIGHT * np.eye(3), (len(anchor), 1, 1)), _ANCHOR_WEIGHT * anchor
            matrix, right = triangulation_equations(rays, self.measured.point, prior)
            points[new] = np.linalg.solve(matrix, right[..., None])[new, :, 0]
        return Unknowns(solution.x, solution.tilts[: len(self.measured.times_s)], points)

    def prior(self) -> LandmarkPrior:
        """Return the prior of the landmarks: that of the landmark file, or none (information 0) if they are free."""
        listed = self.data.landmarks
        information = np.zeros(len(self.landmarks))
        points = np.zeros((len(self.landmarks), 3))
        old = np.flatnonzero(self.landmarks < len(listed.numbers))
        points[old] = listed.positions_body_m[self.landmarks[old]]
        if self.options.landmarks == "prior":
            information[old] = listed.sigma_m[self.landmarks[old]] ** -2.0
        return LandmarkPrior(points, information)

    def adjust(
        self, solution: BatchState, robust: HuberLoss, limits: StoppingCriteria
    ) -> tuple[BatchState, GaussNewtonResult]:
        """Adjust the state to the arc."""
        found = adjust(self.model, self.prior(), self.unknowns(solution), robust, limits)
        unknowns = found.linear.unknowns
        tilts, points = solution.tilts.copy(), solution.points.copy()
        tilts[: len(unknowns.tilts)] = unknowns.tilts
        points[self.landmarks] = unknowns.points
        return replace(solution, x=unknowns.x, tilts=tilts, points=points), found

    def split(self, solution: BatchState, scale: float) -> tuple[BatchState, int]:
        """Edit sightings whose ray misses the others of its landmark, and split numbers given to two craters.

        The largest set of rays that meet keeps the number; a second set that meets elsewhere becomes a new landmark.
        Also returns how many numbers were split.
        """
        measured, known = self.measured, self.layout.knowledge
        rays = self.rays(solution.x, solution.tilts)
        # Pixels to radians. The attitude error is added in full, although the estimated pan and tilt are applied: the
        # tolerance is on the safe side.
        sigma = np.hypot(measured.sigma_px * known.camera.pixel_angle_rad, known.attitude_sigma_rad)
        groups = consistent_rays(
            rays.origins_m, rays.directions, measured.begin, self.options.edit_sigma * scale * sigma, _MIN_SECOND_RAYS
        )
        numbering, kept = solution.numbering.copy(), solution.kept.copy()
        kept[self.rows[groups < 0]] = False
        second = np.flatnonzero(groups == 1)
        split, new = np.unique(measured.point[second], return_inverse=True)
        # New landmarks have rows after all others, so that those of the landmark file keep theirs.
        numbering[self.rows[second]] = len(solution.points) + new
        points = solution.points.copy()
        # Triangulated again in the next adjustment: their sightings are others now.
        points[self.landmarks] = np.nan
        points = np.vstack([points, np.full((len(split), 3), np.nan)])
        return replace(solution, numbering=numbering, kept=kept, points=points), len(split)

"""The state of a solution between the steps of the filter: which sightings count, under which landmark, and where."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimators.orbit.kernels import consistent_rays
from estimators.orbit.model import MeasurementModel, Measurements, Unknowns, measurements_until
from estimators.orbit.parameters import OrbitOptions, ParameterLayout
from estimators.orbit.solve import GaussNewtonResult, HuberLoss, LandmarkPrior, StoppingCriteria, adjust
from scenarios.geometry.triangulation import LinesOfSight, triangulation_equations
from scenarios.orbits.data import OrbitData

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

_MIN_SEEN = 2
_ANCHOR_WEIGHT = 1e-4
_MIN_SECOND = 3


@dataclass(frozen=True, slots=True, eq=False)
class BatchState:
    """What is believed so far.

    Parameters
    ----------
    x
        Shared unknowns.
    tilts
        (I, 2) of all images, 0 where they have not been estimated.
    points
        (L, 3) landmarks, body axes, NaN where one has no place yet; more of them than numbers after a split.
    numbering
        (K,) row of the landmark of every sighting.
    kept
        (K,) sightings that count.
    """

    x: FloatArray
    tilts: FloatArray
    points: FloatArray
    numbering: IndexArray
    kept: BoolArray

    @classmethod
    def initial(cls, data: OrbitData, layout: ParameterLayout) -> BatchState:
        """Believe what is known before; landmarks have no place until they are seen."""
        numbering = np.searchsorted(np.sort(data.landmarks.numbers), data.pictures.landmark)
        rows = np.argsort(data.landmarks.numbers)[numbering].astype(np.int64)
        nowhere = np.full((len(data.landmarks.numbers), 3), np.nan)
        kept = np.ones(len(rows), dtype=bool)
        return cls(np.zeros(layout.size), np.zeros((len(data.pictures.times_s), 2)), nowhere, rows, kept)


@dataclass(frozen=True, eq=False)
class DataArc:
    """The part of the data that ends at a time, laid out for the adjustment.

    Parameters
    ----------
    data, layout, options
        Of the whole problem.
    model
        Of the arc.
    rows
        (K',) rows of ``data.pictures`` that its sightings came from.
    landmarks
        (L',) rows of the solution's landmarks that it has.
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
        """Take all sightings that count of landmarks that are seen twice."""
        pictures = data.pictures
        here = solution.kept & (pictures.times_s[pictures.image] <= end_s)
        seen = np.bincount(solution.numbering[here], minlength=len(solution.points))
        here &= seen[solution.numbering] >= _MIN_SEEN
        landmarks = np.flatnonzero(seen >= _MIN_SEEN)
        compact = np.full(len(solution.points), -1, dtype=np.int64)
        compact[landmarks] = np.arange(len(landmarks))
        measured, rows = measurements_until(
            data, end_s, compact[solution.numbering], here, options.radiometry == "used"
        )
        return cls(data, layout, options, MeasurementModel(layout, measured), rows, landmarks)

    @property
    def measured(self) -> Measurements:
        """What is measured."""
        return self.model.measured

    def rays(self, x: FloatArray, tilts: FloatArray) -> LinesOfSight:
        """Turn sightings into lines in body axes."""
        measured, camera = self.measured, self.layout.knowledge.camera
        unknowns = Unknowns(x, tilts[: len(measured.times_s)], np.zeros((0, 3)))
        positions = self.model.propagate(x).states[measured.image_epoch, :3]
        seen = (measured.uv_px - [camera.cx_px, camera.cy_px]) / [camera.fx_px, camera.fy_px]
        rays = np.column_stack([seen / (1.0 + self.layout.focal(x)), np.ones(len(seen))])
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        turns = measured.R_body_inertial[measured.image]
        attitudes = self.model.attitudes(unknowns)[measured.image]
        directions = np.einsum("kij,klj,kl->ki", turns, attitudes, rays)
        return LinesOfSight(np.einsum("kij,kj->ki", turns, positions[measured.image]), directions)

    def unknowns(self, solution: BatchState) -> Unknowns:
        """Begin with the solution; landmarks that have no place yet get one by their lines of sight."""
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
        """Return what is known of the landmarks before, where that is to count."""
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
        """Adjust the solution to the arc."""
        found = adjust(self.model, self.prior(), self.unknowns(solution), robust, limits)
        unknowns = found.linear.unknowns
        tilts, points = solution.tilts.copy(), solution.points.copy()
        tilts[: len(unknowns.tilts)] = unknowns.tilts
        points[self.landmarks] = unknowns.points
        return replace(solution, x=unknowns.x, tilts=tilts, points=points), found

    def split(self, solution: BatchState, scale: float) -> tuple[BatchState, int]:
        """Leave out sightings that do not meet those of their number, and give a new one to those that meet elsewhere.

        Also returns how many numbers were split.
        """
        measured, known = self.measured, self.layout.knowledge
        rays = self.rays(solution.x, solution.tilts)
        sigma = np.hypot(measured.sigma_px * known.camera.pixel_angle_rad, known.attitude_sigma_rad)
        groups = consistent_rays(
            rays.origins_m, rays.directions, measured.begin, self.options.edit_sigma * scale * sigma, _MIN_SECOND
        )
        numbering, kept = solution.numbering.copy(), solution.kept.copy()
        kept[self.rows[groups < 0]] = False
        second = np.flatnonzero(groups == 1)
        split, new = np.unique(measured.point[second], return_inverse=True)
        numbering[self.rows[second]] = len(solution.points) + new
        points = solution.points.copy()
        points[self.landmarks] = np.nan
        points = np.vstack([points, np.full((len(split), 3), np.nan)])
        return replace(solution, numbering=numbering, kept=kept, points=points), len(split)

"""Simulated crater detections without images: projected rims with random errors, misses and false detections."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.geometry import Ellipses, View, project_circles
from boresight.scenarios.sequences.ground import MeshGround, faces_camera

NO_CRATER = -1


@dataclass(frozen=True, slots=True, eq=False)
class PlaneCraters:
    """Craters as circles in planes tangent to the shape: centres (n, 3), outward unit normals (n, 3) and radii (n,)."""

    centre_body_m: FloatArray
    normal_body: FloatArray
    radius_m: FloatArray

    def __len__(self) -> int:
        return len(self.radius_m)


@dataclass(frozen=True, slots=True)
class DetectionErrors:
    """Error model of a crater detector, by the keys of `DetectionErrorSpec`."""

    centre_px: float = 0.35
    centre_radii: float = 0.04
    axes_px: float = 0.0
    axes_ratio: float = 0.05
    recall: float = 0.8
    false_share: float = 0.05
    least_radius_px: float = 6.0
    height_m: float = 20.0


@dataclass(frozen=True, slots=True, eq=False)
class LabelledDetections:
    """n detected rims and the true crater of each, ``NO_CRATER`` for a detection of none that the truth lists.

    ``unlisted`` (n,) are detections of no listed crater that are smaller than the listed ones: whether there is a
    crater is not known. None where the truth lists craters of all sizes.
    """

    ellipses: Ellipses
    crater: IndexArray
    unlisted: BoolArray | None = None


def sample_plane_craters(
    ground: MeshGround, count: int, radii_m: tuple[float, float], slope: float, rng: np.random.Generator
) -> PlaneCraters:
    """Draw craters uniform over the area, with N(>r) proportional to r**-slope."""
    points, normals = ground.sample(count, rng)
    low, high = (radius ** (-slope) for radius in radii_m)
    return PlaneCraters(points, normals, (low + rng.uniform(size=count) * (high - low)) ** (-1.0 / slope))


def raise_craters(craters: PlaneCraters, height_m: float, rng: np.random.Generator) -> PlaneCraters:
    """Move craters along their normals by random height errors of the a priori shape."""
    height = rng.normal(0.0, height_m, len(craters))
    return PlaneCraters(
        craters.centre_body_m + height[:, None] * craters.normal_body, craters.normal_body, craters.radius_m
    )


def in_view(
    craters: PlaneCraters, ground: MeshGround, view: View, limits_deg: tuple[float, float, float]
) -> IndexArray:
    """Return the indices of the craters entirely in the frame, not occluded, with emission and incidence within limits.

    ``limits_deg`` are the largest emission, and the least and largest incidence.
    """
    position = view.T_cam_body.camera_position_m
    towards = position - craters.centre_body_m
    emission = _angle_deg(craters.normal_body, towards)
    incidence = _angle_deg(craters.normal_body, np.broadcast_to(view.sun_dir_body, towards.shape))
    seen = (emission < limits_deg[0]) & (incidence > limits_deg[1]) & (incidence < limits_deg[2])
    seen &= faces_camera(craters.centre_body_m, craters.normal_body, position)
    cam = view.T_cam_body.transform(craters.centre_body_m)
    radius_px = craters.radius_m / np.maximum(cam[:, 2], 1.0) / view.camera.pixel_angle_rad
    uv = view.camera.project(cam)
    size = np.array([view.camera.width_px, view.camera.height_px])
    with np.errstate(invalid="ignore"):
        seen &= ((uv > radius_px[:, None]) & (uv < size - radius_px[:, None])).all(axis=1)
    rows = np.flatnonzero(seen)
    lifted = craters.centre_body_m[rows] + 0.5 * craters.radius_m[rows, None] * craters.normal_body[rows]
    return rows[ground.in_sight(lifted, craters.normal_body[rows], position)]


def detect_simulated(
    craters: PlaneCraters, visible: IndexArray, view: View, errors: DetectionErrors, rng: np.random.Generator
) -> LabelledDetections:
    """Simulate detections of the visible craters with errors, and false ones of similar size anywhere in the frame."""
    rims = project_circles(
        view, craters.centre_body_m[visible], craters.normal_body[visible], craters.radius_m[visible]
    )
    found = (rng.uniform(size=len(visible)) < errors.recall) & (rims.radius_px > errors.least_radius_px)
    rims, crater = _disturbed(rims[found], errors, rng), visible[found]
    count = rng.poisson(len(crater) * errors.false_share / (1.0 - errors.false_share)) if len(crater) else 0
    like = rng.integers(0, max(len(crater), 1), count)
    false_centres = rng.uniform(size=(count, 2)) * [view.camera.width_px, view.camera.height_px]
    false_rims = Ellipses(false_centres, rims.semi_axes_px[like], rng.uniform(0.0, np.pi, count))
    order = rng.permutation(len(crater) + count)
    both = Ellipses.joined([rims, false_rims])
    return LabelledDetections(both[order], np.concatenate([crater, np.full(count, NO_CRATER)])[order])


def _disturbed(rims: Ellipses, errors: DetectionErrors, rng: np.random.Generator) -> Ellipses:
    sigma = np.hypot(errors.centre_px, errors.centre_radii * rims.radius_px)
    centre = rims.centre_px + sigma[:, None] * rng.normal(size=(len(rims), 2))
    axes = rims.semi_axes_px * np.exp(errors.axes_ratio * rng.normal(size=(len(rims), 2)))
    axes = np.maximum(axes + errors.axes_px * rng.normal(size=(len(rims), 2)), 0.5)
    swapped = axes[:, 1] > axes[:, 0]
    angle = np.where(swapped, rims.angle_rad + 0.5 * np.pi, rims.angle_rad) % np.pi
    return Ellipses(centre, np.where(swapped[:, None], axes[:, ::-1], axes), angle)


def _angle_deg(a: FloatArray, b: FloatArray) -> FloatArray:
    cross = np.linalg.norm(np.cross(a, b), axis=-1)
    return np.asarray(np.degrees(np.arctan2(cross, np.einsum("ni,ni->n", a, b))), dtype=np.float64)

"""A pose from an image, and a laser range along the boresight: section 6 of Rowell et al. (2015)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, JsonValue

from estimators.contract import Assets, Estimate, Estimator, Stage, Stopwatch
from estimators.landmark.database import LandmarkDatabase
from estimators.options import parse_options
from scenarios.errors import BoresightError
from scenarios.geometry import Pose, TriangleMesh
from scenarios.observation import Observation, RangeReading
from scenarios.spec.base import SpecModel

FloatArray = NDArray[np.float64]

_ROUNDS = 10
_SETTLED_M = 1e-3


@runtime_checkable
class HasLandmarkDatabase(Protocol):
    """What a base must have beside the contract: the data base whose mesh the range is measured against."""

    @property
    def database(self) -> LandmarkDatabase:
        """The landmarks that it looks for."""
        ...


class AltimeterOptions(SpecModel):
    """Options of the fusion."""

    base: str = Field("landmark-harris", description="The estimator on a landmark data base that finds the pose")
    options: Mapping[str, JsonValue] = Field(default_factory=dict, description="Options of the base")
    trust: Literal["adaptive", "reported"] = Field(
        "adaptive",
        description="adaptive: the covariance of a base that is too sure grows where the range contradicts it",
    )
    height_sigma_m: float | None = Field(
        None, gt=0, description="RMS error of the mesh's heights; worked out from the data base if left out"
    )


@dataclass(frozen=True, slots=True, eq=False)
class RangeUpdate:
    """A pose with a range taken into account.

    Parameters
    ----------
    T_cam_body, covariance
        The pose and its (6, 6) covariance, [rotation_rad, translation_m] in camera axes.
    information
        (6, 6) information of the range alone, in the same parameters.
    innovation_m
        Measured range less the predicted one, before the fusion.
    sigma_m
        Standard deviation of the range's error and the mesh's, along the boresight.
    inflation
        Factor on the covariance that the pose came with.
    normalised_innovation
        Size of the innovation in standard deviations, by what the pose and the range believed of themselves.
    """

    T_cam_body: Pose
    covariance: FloatArray
    information: FloatArray
    innovation_m: float
    sigma_m: float
    inflation: float
    normalised_innovation: float


def fuse_range(
    prior: tuple[Pose, FloatArray], reading: RangeReading, mesh: TriangleMesh, height_sigma_m: float, adaptive: bool
) -> RangeUpdate | None:
    """Find the pose that agrees best with its estimate and with a range: iterated Kalman update of one measurement.

    The range's variance is R = sigma^2 + (height_sigma / cos i)^2. An estimate from wrongly matched landmarks believes
    too much in itself. With ``adaptive`` its covariance P grows until the innovation nu is as large as it should be on
    average, by max(1, (nu^2 - R) / (H P H^T)): the fading factor of strong tracking (Zhou and Frank 1996).

    Parameters
    ----------
    prior
        T_cam_body and its (6, 6) covariance.
    reading
        The measured range.
    mesh
        What the range is predicted with.
    height_sigma_m
        RMS error of its heights.
    adaptive
        Whether the covariance may grow.

    Returns
    -------
    None where the boresight of the estimate misses the mesh.
    """
    start, covariance = prior
    first = _linearised(start, reading, mesh, height_sigma_m)
    if first is None:
        return None
    projected_m2 = float(first.gradient @ covariance @ first.gradient)
    excess = (first.innovation_m**2 - first.variance_m2) / projected_m2
    inflation = max(1.0, excess) if adaptive else 1.0
    grown = inflation * covariance
    step, pose, at = np.zeros(6), start, first
    for _ in range(_ROUNDS):
        previous, step = step, at.gain(grown) * (at.innovation_m + float(at.gradient @ step))
        pose = start.perturbed(step[:3], step[3:])
        there = _linearised(pose, reading, mesh, height_sigma_m)
        if there is None or np.linalg.norm((step - previous)[3:]) < _SETTLED_M:
            break
        at = there
    updated = grown - np.outer(at.gain(grown), at.gradient @ grown)
    return RangeUpdate(
        T_cam_body=pose,
        covariance=0.5 * (updated + updated.T),
        information=np.outer(at.gradient, at.gradient) / at.variance_m2,
        innovation_m=first.innovation_m,
        sigma_m=float(np.sqrt(first.variance_m2)),
        inflation=inflation,
        normalised_innovation=abs(first.innovation_m) / float(np.sqrt(projected_m2 + first.variance_m2)),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Linearised:
    """A reading at one pose: gradient (6,) of the predicted range, measured less predicted, and its variance R."""

    gradient: FloatArray
    innovation_m: float
    variance_m2: float

    def gain(self, covariance: FloatArray) -> FloatArray:
        """Kalman gain (6,) for a pose of this covariance."""
        carried: FloatArray = covariance @ self.gradient
        return carried / (float(self.gradient @ carried) + self.variance_m2)


def _linearised(pose: Pose, reading: RangeReading, mesh: TriangleMesh, height_sigma_m: float) -> _Linearised | None:
    predicted = boresight_range(mesh, pose)
    if predicted is None:
        return None
    variance_m2 = reading.sigma_m**2 + (height_sigma_m / predicted.cos_incidence) ** 2
    return _Linearised(predicted.gradient, reading.range_m - predicted.range_m, variance_m2)


@dataclass(frozen=True, slots=True, eq=False)
class MeshRange:
    """Where the boresight meets a mesh.

    Parameters
    ----------
    range_m
        Distance from the camera.
    gradient
        (6,) its derivative by [rotation_rad, translation_m] of the pose, perturbed on the left, camera axes.
    cos_incidence
        Cosine of the angle between the facet's normal and the direction to the camera, above 0.
    """

    range_m: float
    gradient: FloatArray
    cos_incidence: float


def boresight_range(mesh: TriangleMesh, T_cam_body: Pose) -> MeshRange | None:
    """Cast a ray along the boresight; None where it misses the mesh.

    With n the facet's normal and p a point of it in camera axes, the range is r = n.p / n_z. A shift d of the body
    moves it by n.d / n_z, a turn w by n.(w x a) / n_z, a being the point that is hit, seen from the body's origin.
    """
    found = _first_hit(mesh, T_cam_body.camera_position_m, T_cam_body.rotation[2])
    if found is None:
        return None
    range_m, facet = found
    normal_cam = T_cam_body.rotate(mesh.normals[facet])
    arm_m = np.array([0.0, 0.0, range_m]) - T_cam_body.translation_m
    gradient = np.concatenate([np.cross(arm_m, normal_cam), normal_cam]) / normal_cam[2]
    return MeshRange(range_m, gradient, float(-normal_cam[2]))


def _first_hit(mesh: TriangleMesh, origin_m: FloatArray, direction: FloatArray) -> tuple[float, int] | None:
    """Distance and facet of the first hit of a ray on a facet that it enters by (Moeller and Trumbore 1997)."""
    first = mesh.corners_m[:, 0]
    edge1, edge2 = mesh.corners_m[:, 1] - first, mesh.corners_m[:, 2] - first
    entering = mesh.area_vectors_m2 @ direction < 0.0
    p = np.cross(direction, edge2)
    determinant = np.where(entering, np.einsum("fi,fi->f", edge1, p), np.nan)
    offset = origin_m - first
    q = np.cross(offset, edge1)
    u = np.einsum("fi,fi->f", offset, p) / determinant
    v = q @ direction / determinant
    distance = np.einsum("fi,fi->f", edge2, q) / determinant
    hit = np.flatnonzero((u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (distance > 0.0))
    if not len(hit):
        return None
    nearest = int(hit[np.argmin(distance[hit])])
    return float(distance[nearest]), nearest


def mesh_height_sigma_m(database: LandmarkDatabase) -> float:
    """Estimate how far the landmark mesh is from the surface, RMS along the normal, from the data base alone.

    Two parts add up: the landmarks' own scatter along the normal, and the relief between them. Each landmark tells of
    the second by its height over the mean of its neighbours. Inside a facet the surface departs less from the mesh than
    a landmark does from a mesh without it: by a quarter where the surface is smooth and bends evenly, by all of it
    where it is rough at every scale. Half is taken.
    """
    mesh = database.mesh()
    normals = _vertex_normals(mesh)
    scatter_m2 = np.einsum("ni,nij,nj->n", normals, database.covariances_m2, normals)
    relief_m = np.einsum("ni,ni->n", normals, mesh.vertices_m - _neighbour_means(mesh))
    return float(np.sqrt(scatter_m2.mean() + np.mean((0.5 * relief_m) ** 2)))


def _vertex_normals(mesh: TriangleMesh) -> FloatArray:
    total = np.zeros_like(mesh.vertices_m)
    for corner in mesh.faces.T:
        np.add.at(total, corner, mesh.area_vectors_m2)
    normals: FloatArray = total / np.linalg.norm(total, axis=1, keepdims=True)
    return normals


def _neighbour_means(mesh: TriangleMesh) -> FloatArray:
    """Mean (V, 3) of the vertices that share an edge with each; every edge of a closed mesh lies in two facets."""
    total, count = np.zeros_like(mesh.vertices_m), np.zeros(len(mesh.vertices_m))
    for tail, head in ((0, 1), (1, 2), (2, 0)):
        np.add.at(total, mesh.faces[:, tail], mesh.vertices_m[mesh.faces[:, head]])
        np.add.at(count, mesh.faces[:, tail], 1.0)
    means: FloatArray = total / count[:, None]
    return means


class AltimeterEstimator:
    """Another estimator's pose, fused with the altimeter's range; where there is no reading, the pose as it is."""

    name: ClassVar[str] = "landmark-altimeter"
    version: ClassVar[int] = 2
    base: ClassVar[str] = "landmark-harris"
    sensors: ClassVar[frozenset[str]] = frozenset({"altimeter"})

    def __init__(self, base: Estimator, database: LandmarkDatabase, options: AltimeterOptions) -> None:
        self._base = base
        self._mesh = database.mesh()
        self._height_sigma_m = options.height_sigma_m or mesh_height_sigma_m(database)
        self._adaptive = options.trust == "adaptive"

    @classmethod
    def from_options(cls, options: Mapping[str, object], assets: Assets) -> Self:
        """Build from a campaign's options: the base first, by its name."""
        from estimators.registry import estimator_class  # the registry names this module

        parsed = parse_options(AltimeterOptions, options, cls.name)
        if parsed.base == cls.name:
            raise BoresightError(f"estimator {cls.name}: base: it cannot be its own: the range would count twice")
        base = estimator_class(parsed.base).from_options(parsed.options, assets)
        if not isinstance(base, HasLandmarkDatabase):
            raise BoresightError(
                f"estimator {cls.name}: base: {parsed.base} has no landmark data base to measure a range against:"
                " choose an estimator on landmarks"
            )
        return cls(base, base.database, parsed)

    def estimate(self, observation: Observation, *, rng: np.random.Generator) -> Estimate:
        """Let the base estimate, then fuse the range where there is one."""
        estimate = self._base.estimate(observation, rng=rng)
        if estimate.status != "ok" or estimate.pose is None:
            return estimate
        if estimate.covariance is None:
            return Estimate("failed", "the base gives no covariance to weigh the range with")
        clock = Stopwatch()
        with clock("range"):
            fused = self._fused(estimate.pose, estimate.covariance, observation.frame.altimeter)
        found = estimate if fused is None else _with_range(estimate, fused)
        return replace(
            found,
            stages=(*estimate.stages, Stage("range", estimate.pose if fused is None else fused.T_cam_body)),
            diagnostics={**estimate.diagnostics, **_diagnostics(fused)},
            timings_s={**estimate.timings_s, **clock.seconds},
        )

    def _fused(self, pose: Pose, covariance: FloatArray, reading: RangeReading | None) -> RangeUpdate | None:
        if reading is None:
            return None
        return fuse_range((pose, covariance), reading, self._mesh, self._height_sigma_m, self._adaptive)


def _with_range(estimate: Estimate, fused: RangeUpdate) -> Estimate:
    """Put the fused pose in place of the base's, and add the range's information to that of its observations."""
    bound = estimate.bound
    if bound is not None:
        bound = np.asarray(np.linalg.inv(np.linalg.inv(bound) + fused.information), dtype=np.float64)
    return replace(estimate, pose=fused.T_cam_body, covariance=fused.covariance, bound=bound)


def _diagnostics(fused: RangeUpdate | None) -> dict[str, float | int | str]:
    if fused is None:
        return {"range_used": 0}
    return {
        "range_used": 1,
        "range_innovation_m": fused.innovation_m,
        "range_contradiction": fused.normalised_innovation,
        "range_sigma_m": fused.sigma_m,
        "range_inflation": fused.inflation,
    }

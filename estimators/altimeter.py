"""Fuse a laser range along the boresight with the pose of another estimator: section 6 of Rowell et al. (2015)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import Field, JsonValue

from boresight.estimators.contract import Assets, Estimate, Estimator, Predictor, Stage, Stopwatch
from boresight.estimators.landmark.database import LandmarkDatabase
from boresight.estimators.options import parse_options
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Pose
from boresight.scenarios.observation import Observation, RangeReading
from boresight.scenarios.sequences.ground import MeshGround
from boresight.scenarios.spec.base import SpecModel

_ROUNDS = 10
_SETTLED_M = 1e-3


class AltimeterOptions(SpecModel):
    """Options of ``landmark-altimeter``."""

    base: str = Field("landmark-harris", description="The estimator on a landmark data base whose pose is updated")
    options: Mapping[str, JsonValue] = Field(default_factory=dict, description="Options of the base")
    trust: Literal["adaptive", "reported"] = Field(
        "adaptive",
        description="adaptive: the covariance of the base is inflated where the range contradicts it",
    )
    height_sigma_m: float | None = Field(
        None, gt=0, description="RMS error of the mesh's heights; estimated from the data base if left out"
    )


@dataclass(frozen=True, slots=True, eq=False)
class RangeUpdate:
    """A pose updated with a range, and its (6, 6) covariance, [rotation_rad, translation_m] in camera axes.

    ``information`` (6, 6) is that of the range alone, in the same parameters, ``innovation_m`` measured minus predicted
    range, before the update, and ``sigma_m`` the standard deviation of the range and of the mesh's heights together,
    along the boresight. ``inflation`` is the factor by which the covariance before the update was multiplied, and
    ``normalised_innovation`` the absolute innovation over its standard deviation, by the covariances of pose and range
    before inflation.
    """

    T_cam_body: Pose
    covariance: FloatArray
    information: FloatArray
    innovation_m: float
    sigma_m: float
    inflation: float
    normalised_innovation: float


def fuse_range(
    prior: tuple[Pose, FloatArray], reading: RangeReading, ground: MeshGround, height_sigma_m: float, adaptive: bool
) -> RangeUpdate | None:
    """Update a pose with a range by an iterated Kalman update with one scalar measurement.

    The variance of the range is R = sigma^2 + (height_sigma / cos i)^2, i being the angle of incidence. The covariance
    P of a pose from wrongly matched landmarks is too small. With ``adaptive`` it is multiplied by
    max(1, (nu^2 - R) / (H P H^T)), after which the innovation nu has the size that is expected of it: the fading
    factor of strong tracking (Zhou and Frank 1996).

    ``prior`` is T_cam_body and its (6, 6) covariance; ``height_sigma_m`` is the RMS error of the heights of ``ground``.
    None where the boresight at the prior pose misses the mesh.
    """
    start, covariance = prior
    first = boresight_range(ground, start)
    if first is None:
        return None

    def variance_m2(at: MeshRange) -> float:
        # An error of height along the normal changes the range by its size over cos i.
        return reading.sigma_m**2 + (height_sigma_m / at.cos_incidence) ** 2

    def gain(at: MeshRange, covariance: FloatArray) -> FloatArray:
        carried: FloatArray = covariance @ at.gradient
        return carried / (float(at.gradient @ carried) + variance_m2(at))  # P H^T / (H P H^T + R)

    innovation_m = reading.range_m - first.range_m
    projected_m2 = float(first.gradient @ covariance @ first.gradient)  # H P H^T
    # Inflation k at which nu^2 equals its expectation k H P H^T + R.
    excess = (innovation_m**2 - variance_m2(first)) / projected_m2
    inflation = max(1.0, excess) if adaptive else 1.0
    grown = inflation * covariance
    step, pose, at = np.zeros(6), start, first
    for _ in range(_ROUNDS):
        # The prediction is linearised at the pose of the previous step, the prior stays at the start.
        previous, step = step, gain(at, grown) * (reading.range_m - at.range_m + float(at.gradient @ step))
        pose = start.perturbed(step[:3], step[3:])
        there = boresight_range(ground, pose)
        if there is None or np.linalg.norm((step - previous)[3:]) < _SETTLED_M:
            break
        at = there
    # (I - K H) P at the last point of linearisation.
    updated = grown - np.outer(gain(at, grown), at.gradient @ grown)
    return RangeUpdate(
        T_cam_body=pose,
        covariance=0.5 * (updated + updated.T),
        information=np.outer(at.gradient, at.gradient) / variance_m2(at),
        innovation_m=innovation_m,
        sigma_m=float(np.sqrt(variance_m2(first))),
        inflation=inflation,
        normalised_innovation=abs(innovation_m) / float(np.sqrt(projected_m2 + variance_m2(first))),
    )


@dataclass(frozen=True, slots=True, eq=False)
class MeshRange:
    """The range along the boresight from the camera to a mesh.

    ``gradient`` (6,) is its derivative by [rotation_rad, translation_m] of the pose, perturbed on the left, camera
    axes, and ``cos_incidence`` the cosine of the angle between the facet's normal and the direction to the camera,
    above 0.
    """

    range_m: float
    gradient: FloatArray
    cos_incidence: float


def boresight_range(ground: MeshGround, T_cam_body: Pose) -> MeshRange | None:
    """Predict the range along the boresight with its gradient; None where the boresight misses the mesh.

    With n the facet's normal and p a point on it, both in camera axes, the range is r = n.p / n_z. A translation d of
    the body changes it by n.d / n_z, a rotation w by n.(w x a) / n_z, where a is the point hit, relative to the body's
    origin.
    """
    distances_m, facets = ground.first_met(T_cam_body.camera_position_m[None], T_cam_body.rotation[2][None])
    range_m, facet = float(distances_m[0]), int(facets[0])
    normal_cam = T_cam_body.rotate(ground.mesh.normals[facet])
    # From inside the mesh a facet is seen from behind: that is no range.
    if facet < 0 or normal_cam[2] >= 0.0:
        return None
    # The point hit lies on the boresight, the z axis of the camera; relative to the body's origin, about which
    # `Pose.perturbed` turns.
    arm_m = np.array([0.0, 0.0, range_m]) - T_cam_body.translation_m
    gradient = np.concatenate([np.cross(arm_m, normal_cam), normal_cam]) / normal_cam[2]
    return MeshRange(range_m, gradient, float(-normal_cam[2]))


def mesh_height_sigma_m(database: LandmarkDatabase) -> float:
    """Estimate the RMS distance of the landmark mesh from the surface, along the normal, from the data base alone.

    It is the root sum of squares of the landmarks' dispersion along the normal and of the relief between landmarks.
    The relief is measured by the height of each landmark above the mean of its neighbours. Inside a facet the surface
    departs from the mesh by a quarter of that height where it is smooth and evenly curved, and by all of it where it
    is rough at every scale; half is used.
    """
    mesh = database.mesh()
    vertices, faces = mesh.vertices_m, mesh.faces
    # Area vectors of the facets around a vertex, summed: weighted by area.
    total = np.zeros_like(vertices)
    for corner in faces.T:
        np.add.at(total, corner, mesh.area_vectors_m2)
    normals = total / np.linalg.norm(total, axis=1, keepdims=True)
    # Mean of the vertices that share an edge with each one. Each edge is added once: the two facets that share it
    # traverse it in opposite directions.
    around, count = np.zeros_like(vertices), np.zeros(len(vertices))
    for tail, head in ((0, 1), (1, 2), (2, 0)):
        np.add.at(around, faces[:, tail], vertices[faces[:, head]])
        np.add.at(count, faces[:, tail], 1.0)
    # Along the normal only: across it a landmark slides on the surface, which changes no range.
    scatter_m2 = np.einsum("ni,nij,nj->n", normals, database.covariances_m2, normals)
    relief_m = np.einsum("ni,ni->n", normals, vertices - around / count[:, None])
    return float(np.sqrt(scatter_m2.mean() + np.mean((0.5 * relief_m) ** 2)))


class AltimeterEstimator:
    """The pose of another estimator, updated with the range of a laser altimeter along the boresight.

    The range to the mesh of the base's landmark data base is predicted, and the pose updated by an iterated Kalman
    update. With ``trust: adaptive`` the base's covariance is first inflated where the range contradicts it.

    Use it when
    -----------
    The scenario has an altimeter (``sensors.altimeter``), and the base is an estimator on a landmark data base. Use
    ``trust: reported`` with a base whose covariance describes its errors, such as ``landmark-ransac``.

    It fails when
    -------------
    The base fails or gives no covariance. Where there is no reading, or the boresight misses the mesh, the pose of the
    base is returned unchanged. A range measures one direction alone: errors of the attitude remain.

    Cost
    ----
    That of its base, and less than 0.01 s: 0.10 s an image of ``quickstart`` with ``landmark-harris``.

    Source
    ------
    Rowell et al. (2015), section 6, propose the fusion; the method is ours. Inflation: Zhou and Frank (1996).
    """

    name: ClassVar[str] = "landmark-altimeter"
    version: ClassVar[int] = 4
    options_model: ClassVar[type[SpecModel]] = AltimeterOptions
    base: ClassVar[str] = "landmark-harris"
    sensors: ClassVar[frozenset[str]] = frozenset({"altimeter"})

    def __init__(self, base: Estimator, database: LandmarkDatabase, options: AltimeterOptions) -> None:
        self._base = base
        self._ground = MeshGround(database.mesh())
        self._height_sigma_m = options.height_sigma_m or mesh_height_sigma_m(database)
        self._adaptive = options.trust == "adaptive"

    @classmethod
    def from_options(cls, options: Mapping[str, object], assets: Assets) -> Self:
        """Build from a campaign's options, which name the base and give its options."""
        from boresight.estimators.registry import built_base  # the registry imports this module by name

        parsed = parse_options(AltimeterOptions, options, cls.name)
        if parsed.base == cls.name:
            raise BoresightError(f"estimator {cls.name}: base: it cannot be its own: the range would count twice")
        base = built_base(parsed.base, parsed.options, assets)
        database = getattr(base, "database", None)
        if not isinstance(database, LandmarkDatabase):
            raise BoresightError(
                f"estimator {cls.name}: base: {parsed.base} has no landmark data base to measure a range against:"
                " choose an estimator on landmarks"
            )
        return cls(base, database, parsed)

    def predict(self, planned: Observation) -> FloatArray | None:
        """Predict the covariance (6, 6) of the base, which must predict, with an agreeing range; see `Predictor`."""
        covariance = self._base.predict(planned) if isinstance(self._base, Predictor) else None
        pose, reading = planned.frame.prior_T_cam_body, planned.frame.altimeter
        met = boresight_range(self._ground, pose)
        if covariance is None or reading is None or met is None:
            return covariance
        agreeing = RangeReading(met.range_m, reading.sigma_m)
        fused = fuse_range((pose, covariance), agreeing, self._ground, self._height_sigma_m, adaptive=False)
        return covariance if fused is None else fused.covariance

    def estimate(self, observation: Observation, *, rng: np.random.Generator) -> Estimate:
        """Estimate with the base, then update with the range where there is one."""
        estimate = self._base.estimate(observation, rng=rng)
        if estimate.status != "ok" or estimate.pose is None:
            return estimate
        if estimate.covariance is None:
            return Estimate("failed", "the base gives no covariance to weigh the range with")
        clock = Stopwatch()
        reading, fused, pose = observation.frame.altimeter, None, estimate.pose
        with clock("range"):
            if reading is not None:
                fused = fuse_range(
                    (pose, estimate.covariance), reading, self._ground, self._height_sigma_m, self._adaptive
                )
        diagnostics: dict[str, float | int | str] = {"range_used": 0}
        if fused is not None:
            bound = estimate.bound
            if bound is not None:
                # Information of independent measurements adds.
                bound = np.asarray(np.linalg.inv(np.linalg.inv(bound) + fused.information), dtype=np.float64)
            pose = fused.T_cam_body
            estimate = replace(estimate, pose=pose, covariance=fused.covariance, bound=bound)
            diagnostics = {
                "range_used": 1,
                "range_innovation_m": fused.innovation_m,
                "range_contradiction": fused.normalised_innovation,
                "range_sigma_m": fused.sigma_m,
                "range_inflation": fused.inflation,
            }
        return replace(
            estimate,
            stages=(*estimate.stages, Stage("range", pose)),
            diagnostics={**estimate.diagnostics, **diagnostics},
            timings_s={**estimate.timings_s, **clock.seconds},
        )

"""Viewpoint, lighting and pose-error sections."""

from __future__ import annotations

from statistics import NormalDist
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.spec.base import SpecModel, WithDefaultAlternative, optional, rule
from boresight.scenarios.spec.camera import Rectangle
from boresight.scenarios.spec.distribution import DrawnModel, Limits, PositiveScalar, Scalar, Uniform
from boresight.scenarios.spec.trajectory import StatesSpec, TrajectorySpec
from boresight.scenarios.spec.vectors import Correlated6, Uniform3, Vector3, check_semidefinite, draw_normals

_DISTANCE = Limits(1e-3, 1e13)
"""Of a camera from a body, m: from a millimetre to what no camera shows."""


class ViewpointSpec(DrawnModel):
    """Random direction at a range or altitude, or states of a trajectory; boresight to the centre or a target kind."""

    alternatives: ClassVar = (("range_m", "trajectory", "altitude_m"),)
    no_default: ClassVar = True
    limits: ClassVar = {"range_m": _DISTANCE, "altitude_m": _DISTANCE, "latitude_deg": Limits(-90.0, 90.0)}

    kind: Literal["random-direction"] = Field("random-direction", description="The only kind of viewpoint")
    range_m: PositiveScalar | None = Field(
        None, description="Distance of the camera from the body's origin, one or drawn"
    )
    altitude_m: PositiveScalar | None = optional(
        "Distance of the camera from the true surface, on the line from the body's origin through the"
        " camera, one or drawn; instead of range_m"
    )
    trajectory: TrajectorySpec | None = optional("Camera positions of a mission, instead of range_m")
    roll_deg: Scalar = Field(Uniform(uniform=(-180.0, 180.0)), description="Roll about the boresight")
    off_pointing_deg: Scalar | None = optional(
        "Angle by which the boresight misses the body's centre or the target, at a random azimuth"
    )
    latitude_deg: Uniform = Field(
        Uniform(uniform=(-90.0, 90.0)),
        description="Body-fixed latitudes of the camera, within -90 to 90; uniform over the area",
    )
    keep_clear_px: tuple[Rectangle, ...] = Field(
        (),
        description="Rectangles [left, top, right, bottom] of the detector; a view with the body in one is drawn anew",
    )
    targets: tuple[Literal["nadir", "limb", "terminator"], ...] = optional(
        "Point at sunlit ground, each kind as often: below the camera, near the lit limb (emission 50 to 70"
        " deg) or near the terminator (incidence 55 to 75 deg); at the body's centre where none is given",
        (),
    )

    @rule
    def _a_trajectory_has_the_views(self) -> None:
        if self.states is None:
            return
        pointed = ["roll_deg", "off_pointing_deg", "targets"] if self.states.attitude is not None else []
        given = self.stated("latitude_deg", "keep_clear_px", *pointed)
        if given:
            raise ValueError(f"{given[0]} has no part where a trajectory has the views: leave it out")

    @property
    def states(self) -> StatesSpec | None:
        """The states of the trajectory; None without one."""
        return None if self.trajectory is None else self.trajectory.states

    @property
    def flies(self) -> bool:
        """True for a trajectory that has velocities other than 0."""
        return self.states is not None and bool(np.any(self.states.velocity_m_s or 0.0))

    @property
    def range_bounds_m(self) -> tuple[float, float]:
        """The shortest and the longest range, or altitude where that is given, m."""
        distance = self.range_m or self.altitude_m
        if distance is None:
            return float(self._state_ranges_m.min()), float(self._state_ranges_m.max())
        return (distance, distance) if isinstance(distance, float) else distance.support

    @property
    def median_range_m(self) -> float:
        """The median of the range, or of the altitude where that is given, m, at which data bases are built."""
        distance = self.range_m or self.altitude_m
        if distance is None:
            return float(np.median(self._state_ranges_m))
        return distance if isinstance(distance, float) else distance.median

    @property
    def _state_ranges_m(self) -> FloatArray:
        """(n,) ranges of the states of a trajectory."""
        if self.states is None:
            raise ValueError("a viewpoint without range_m has the states of a trajectory")
        return np.asarray(np.linalg.norm(self.states.position_m, axis=1), dtype=np.float64)


class LightingSpec(DrawnModel):
    """Direction to the Sun by the phase angle; its azimuth about the line of sight is uniform."""

    limits: ClassVar = {"phase_deg": Limits(0.0, 180.0), "brightness": Limits(0.0, rms=1e6)}

    phase_deg: Scalar = Field(Uniform(uniform=(0.0, 60.0)), description="Range of the phase angle, within 0 to 180")
    brightness: PositiveScalar = optional(
        "Factor on the radiance of each image, one or drawn: albedo, distance of the Sun, calibration", 1.0
    )
    measure: Literal["solid-angle", "angle"] = Field(
        "solid-angle",
        description="Uniform over the solid angle of the cap, or in the angle itself, for a uniform phase_deg",
    )


CorrelatedKey = Literal[
    "viewpoint.range_m",
    "viewpoint.altitude_m",
    "viewpoint.roll_deg",
    "viewpoint.off_pointing_deg",
    "lighting.phase_deg",
    "lighting.brightness",
    "detector.exposure_s",
]


class CorrelatedSpec(SpecModel):
    """Keys that are drawn together, each by the law that its own section has.

    With ``correlation`` the normal scores of the values have these correlations (a Gaussian copula). Normal laws are
    then jointly normal: a covariance c_ij is written as sigma_i of each key and c_ij / (sigma_i sigma_j) here.
    With ``same_row`` each key has a ``choice`` of as many values, and a trial has the values of one row.
    """

    alternatives: ClassVar = (("correlation", "same_row"),)
    no_default: ClassVar = True

    keys: tuple[CorrelatedKey, ...] = Field(min_length=2, description="The keys, with their sections")
    correlation: tuple[tuple[Annotated[float, Field(ge=-1, le=1)], ...], ...] | None = Field(
        None, description="Correlation matrix, in the order of the keys: symmetric, positive semidefinite"
    )
    same_row: Literal[True] | None = Field(
        None, description="Draw a row of the columns that the keys have as choice, instead of correlation"
    )

    @rule
    def _check(self) -> None:
        twice = [key for key in self.keys if self.keys.count(key) > 1]
        if twice:
            raise ValueError(f"keys: {twice[0]} is given twice")
        if self.correlation is not None:
            count = len(self.keys)
            if {len(self.correlation), *map(len, self.correlation)} != {count}:
                raise ValueError(f"correlation is not {count} x {count}, as there are {count} keys")
            if any(row[place] != 1.0 for place, row in enumerate(self.correlation)):
                raise ValueError("correlation has other numbers than 1 on its diagonal")
            check_semidefinite("correlation", np.array(self.correlation))

    def shares(self, rng: np.random.Generator) -> tuple[float, ...]:
        """Draw for each key the share of all values that its value is above."""
        if self.correlation is None:
            return (float(rng.uniform()),) * len(self.keys)
        return tuple(map(NormalDist().cdf, draw_normals(np.array(self.correlation), rng).tolist()))


class AttitudeErrorSpec(SpecModel):
    """A rotation by ``angle_deg`` about an isotropic axis, or a random rotation vector."""

    alternatives: ClassVar = (("angle_deg", "rotation_vector_deg"),)

    axis: Literal["isotropic"] = Field("isotropic", description="Axis of angle_deg: uniform over the sphere")
    angle_deg: Scalar | None = Field(None, description="Angle about a random axis")
    rotation_vector_deg: Vector3 | None = Field(None, description="Components in camera axes, instead of angle_deg")

    @property
    def second_moment_rad2(self) -> FloatArray:
        """(3, 3) mean of the outer product of the rotation vector with itself."""
        if self.rotation_vector_deg is not None:
            moment_deg2 = self.rotation_vector_deg.second_moment
        else:
            # E[angle^2 n n^T] = E[angle^2] / 3 I for an isotropic axis n.
            moment_deg2 = np.eye(3) * (0.0 if self.angle_deg is None else self.angle_deg.second_moment / 3.0)
        return np.asarray(moment_deg2 * np.radians(1.0) ** 2, dtype=np.float64)


PAPER_ATTITUDE_ERROR = AttitudeErrorSpec(angle_deg=Uniform(uniform=(-2.0, 2.0)))


class PoseErrorSpec(WithDefaultAlternative):
    """Error of the prior pose given to estimators (Rowell et al. 2015, section 4.2).

    The translation T of equation (4) is shifted in camera axes (x, y across the line of sight, z along it)
    and the attitude is rotated, independently. Or the camera's position has an error in body axes, as an orbit
    determination has it, and the attitude one of its own, which then moves the body in the image.
    """

    alternatives: ClassVar = (
        ("position_cam_m", "position_cam_px", "position_body_m", "position_rtn_m", "pose_cam_deg_m"),
        ("pose_cam_deg_m", "attitude"),
    )

    position_cam_m: Vector3 | None = Field(None, description="Shift in camera axes, m")
    position_cam_px: Vector3 | None = Field(
        None, description="Shift in camera axes in pixel sizes at the body's range, instead of position_cam_m"
    )
    position_body_m: Vector3 | None = optional(
        "Error of the camera's position about the body, body axes, instead of position_cam_m"
    )
    position_rtn_m: Vector3 | None = optional(
        "Error of the camera's position about the body: radial, transverse and normal, with a trajectory"
        " that has velocities, instead of position_cam_m"
    )
    pose_cam_deg_m: Correlated6 | None = optional(
        "Rotation vector, deg, and shift, m, in camera axes with one covariance, instead of position_cam_m and attitude"
    )
    attitude: AttitudeErrorSpec = Field(
        PAPER_ATTITUDE_ERROR, description="Error of the attitude, independent of the position's"
    )

    @property
    def position(self) -> tuple[str, Vector3]:
        """The key of the position's own law, and the law; raise BoresightError if there is none."""
        keys = self.alternatives[0][:-1]
        for key in keys:
            if (law := getattr(self, key)) is not None:
                return key, law
        raise BoresightError(f"pose_error: give {', '.join(keys)} or pose_cam_deg_m")


PAPER_POSE_ERROR = PoseErrorSpec(
    position_cam_px=Uniform3(uniform=((-40.0, 40.0), (-40.0, 40.0), (-4.0, 4.0))),
)
"""The errors of Rowell et al. (2015), section 4.2, in pixels of their images: 50 m are 39.7 pixels."""

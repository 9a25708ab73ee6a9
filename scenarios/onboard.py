"""Onboard model of a scenario: the shape, camera, Sun direction and spin state that the spacecraft assumes."""

from __future__ import annotations

import numpy as np

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.draw import draw_direction, turn_direction
from boresight.scenarios.geometry import Camera, Pose
from boresight.scenarios.spec.body import BodySpec
from boresight.scenarios.spec.camera import CameraSpec
from boresight.scenarios.spec.distribution import Scalar
from boresight.scenarios.spec.onboard import OnboardSpec
from boresight.scenarios.spec.scenario import ScenarioSpec

_EQUATOR_RAD = (0.0, 0.0)


def onboard_spec(spec: ScenarioSpec) -> ScenarioSpec:
    """Return the scenario with the onboard model instead of the truth, for data bases and onboard shapes."""
    onboard = spec.onboard
    changes = {
        "body": _believed_body(spec.body, onboard),
        "brdf": onboard.brdf or spec.brdf,
        "camera": _believed_camera(spec.camera, onboard),
        "second_body": None,
        "pose_error": spec.believed_pose_error,
        "onboard": OnboardSpec(declared=onboard.declared),
    }
    return spec.model_copy(update=changes)


def _believed_body(body: BodySpec, onboard: OnboardSpec) -> BodySpec:
    if onboard.body is not None:
        return onboard.body
    detail = body.detail
    if detail is not None:
        changes = {} if onboard.facets is None else {"facets": onboard.facets}
        known = {} if onboard.albedo == "as-truth" else {"albedo": None}
        relief = {} if onboard.relief is None else {"redrawn": onboard.relief}
        detail = detail.model_copy(update={**changes, **known, **relief})
    mapped = body.albedo_map if onboard.albedo == "as-truth" else None
    heights = onboard.height_error or body.height_error
    return body.model_copy(update={"detail": detail, "height_error": heights, "albedo_map": mapped})


def _believed_camera(camera: CameraSpec, onboard: OnboardSpec) -> CameraSpec:
    """Apply the onboard errors of focal length, principal point and distortion to the true camera."""
    if camera.distortion is not None:
        lens = camera.distortion.scaled(1.0 + onboard.distortion_error)
        camera = camera.model_copy(update={"distortion": lens})
    if onboard.focal_error == 0.0 and onboard.principal_point_error_px == (0.0, 0.0):
        return camera
    true = camera.camera()
    scale = 1.0 + onboard.focal_error
    dx, dy = onboard.principal_point_error_px
    changes = {
        "fov_deg": None,
        "optics": None,
        "focal_px": (true.fx_px * scale, true.fy_px * scale),
        "principal_point_px": (true.cx_px + dx, true.cy_px + dy),
    }
    return camera.model_copy(update=changes)


def onboard_camera(spec: ScenarioSpec) -> Camera:
    """Return the camera model that is used on board."""
    return _believed_camera(spec.camera, spec.onboard).camera()


def onboard_sun_dir(sun_dir_cam: FloatArray, onboard: OnboardSpec, rng: np.random.Generator) -> FloatArray:
    """Perturb the direction to the Sun, (3,) unit vector, by a rotation about a random axis perpendicular to it."""
    angle_rad, azimuth_rad = _angle_rad(onboard.sun_error_deg, rng), rng.uniform(0.0, 2.0 * np.pi)
    if angle_rad == 0.0:
        return sun_dir_cam
    return turn_direction(sun_dir_cam, angle_rad, azimuth_rad)


def onboard_attitude(T_cam_body: Pose, onboard: OnboardSpec, rng: np.random.Generator) -> Pose:
    """Perturb the body's attitude relative to the camera by the onboard errors of pole and rotation phase.

    The assumed body axes differ from the true ones by a tilt of the pole about a random equatorial axis and by a
    phase error about the pole. The position of the body's origin in the camera frame is unchanged.
    """
    # Imported here: `boresight list` reads what is on board, and scipy takes 0.3 s.
    from scipy.spatial.transform import Rotation

    tilt_rad, phase_rad = _angle_rad(onboard.pole_error_deg, rng), _angle_rad(onboard.rotation_error_deg, rng)
    axis = draw_direction(_EQUATOR_RAD, rng)
    # Right of R_cam_body: the error is in body axes, where the pole is z.
    turn = Rotation.from_rotvec(phase_rad * np.array([0.0, 0.0, 1.0])) * Rotation.from_rotvec(tilt_rad * axis)
    return Pose(T_cam_body.rotation @ turn.as_matrix(), T_cam_body.translation_m)


def _angle_rad(law: Scalar | None, rng: np.random.Generator) -> float:
    return 0.0 if law is None else float(np.radians(law.draw(rng)))

"""Observations for estimators: image, direction to the Sun in camera axes, prior pose and sensor readings."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from boresight.campaign.imaging.world import TrialImage, World
from boresight.renderers.rectify import rectify
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.draw import Stream, degrade, generator, prior_covariance, state_of_trial
from boresight.scenarios.geometry import Pose, View
from boresight.scenarios.observation import CameraSigma, Frame, Observation, RangeReading, SkyKnowledge
from boresight.scenarios.onboard import onboard_attitude, onboard_camera, onboard_sun_dir
from boresight.scenarios.spec.scenario import ScenarioSpec

T = TypeVar("T", bound=np.generic)


def altimeter_reading(world: World, view: View, rng: np.random.Generator | None) -> RangeReading | None:
    """Measure the distance from the camera along its boresight to the true surface; without ``rng`` it has no error.

    The reading is None if the scenario has no altimeter or the boresight misses the body.
    """
    altimeter = world.scenario.spec.sensors.altimeter
    if altimeter is None:
        return None
    camera = view.camera
    hits = world.renderer.surface(view, np.array([[camera.cx_px, camera.cy_px]]))
    if not hits.hit[0]:
        return None
    range_m = float(np.linalg.norm(hits.points_body_m[0] - view.T_cam_body.camera_position_m))
    error_m = 0.0 if rng is None else float(rng.normal(0.0, altimeter.sigma_m))
    return RangeReading(range_m + error_m, altimeter.sigma_m)


def observe(world: World, trial_image: TrialImage, seed: int, trial: int) -> Observation:
    """Create the observation of a trial: what an estimator may use of it.

    An image with distortion is resampled, once for all estimators, to the pinhole camera that the spacecraft assumes.
    """
    spec = world.scenario.spec
    true = trial_image.view.T_cam_body
    velocity_m_s = trial_image.velocity_m_s
    drawn = degrade(true, spec.pose_error, world.camera, generator(seed, Stream.POSE_ERROR, trial), velocity_m_s)
    knowledge = generator(seed, Stream.KNOWLEDGE, trial)
    prior = onboard_attitude(drawn, spec.onboard, knowledge)
    camera = onboard_camera(spec)
    frame = Frame(
        image=_read_only(rectify(trial_image.image, camera)),
        sun_dir_cam=_read_only(onboard_sun_dir(true.rotate(trial_image.view.sun_dir_body), spec.onboard, knowledge)),
        prior_T_cam_body=prior,
        prior_covariance=_read_only(prior_covariance(spec.believed_pose_error, prior, world.camera, velocity_m_s)),
        time_s=trial_image.time_s,
        altimeter=altimeter_reading(world, trial_image.view, generator(seed, Stream.ALTIMETER, trial)),
        sky=_sky(spec, trial_image, drawn.rotation.T @ prior.rotation, generator(seed, Stream.STAR_TRACKER, trial)),
    )
    return Observation(camera.pinhole, frame, _camera_sigma(spec))


def plan(world: World, seed: int, trial: int) -> Observation:
    """Create the observation of a trial without its image, for predictions: the view is that of the trial.

    Its prior pose is the drawn one and its range the true one, without errors; the covariance is the one that the
    spacecraft believes in there.
    """
    spec, view = world.scenario.spec, world.source.view(seed, trial)
    pose, viewpoint, velocity_m_s = view.T_cam_body, spec.viewpoint, None
    if viewpoint is not None and viewpoint.states is not None:
        velocity_m_s = viewpoint.states.velocity(state_of_trial(viewpoint, seed, trial))
    frame = Frame(
        image=np.zeros((0, 0), dtype=np.float32),
        sun_dir_cam=_read_only(pose.rotate(view.sun_dir_body)),
        prior_T_cam_body=pose,
        prior_covariance=_read_only(prior_covariance(spec.believed_pose_error, pose, world.camera, velocity_m_s)),
        altimeter=altimeter_reading(world, view, None),
    )
    return Observation(onboard_camera(spec).pinhole, frame, _camera_sigma(spec))


def _camera_sigma(spec: ScenarioSpec) -> CameraSigma:
    declared = spec.onboard.camera_sigma
    return CameraSigma() if declared is None else CameraSigma(declared.focal, declared.principal_point_px)


def _sky(
    spec: ScenarioSpec, trial_image: TrialImage, turn: FloatArray, rng: np.random.Generator
) -> SkyKnowledge | None:
    """Tell the attitudes among the stars; ``turn`` (3, 3) takes the believed axes of the body to the true ones."""
    if spec.stars is None or trial_image.R_body_inertial is None:
        return None
    body = _read_only(turn.T @ trial_image.R_body_inertial)
    if spec.stars.tracker_sigma_deg is None:
        return SkyKnowledge(body)
    sigma_rad = np.radians(spec.stars.tracker_sigma_deg)
    true = Pose(trial_image.view.T_cam_body.rotation @ trial_image.R_body_inertial, np.zeros(3))
    tracked = true.perturbed(sigma_rad * rng.normal(size=3), np.zeros(3)).rotation
    return SkyKnowledge(body, _read_only(tracked), _read_only(sigma_rad))


def _read_only(array: NDArray[T]) -> NDArray[T]:
    view = array.view()
    view.setflags(write=False)
    return view

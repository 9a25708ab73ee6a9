"""What an estimator may see of an image: the image, the Sun in the camera and a degraded pose."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from campaign.imaging.altimeter import altimeter_reading
from campaign.imaging.world import Sight, World
from renderers.rectify import rectify
from scenarios.beliefs import believed_attitude, believed_camera, believed_sun
from scenarios.draw import Stream, degrade, generator, prior_covariance
from scenarios.observation import Frame, Observation

T = TypeVar("T", bound=np.generic)


def observe(world: World, sight: Sight, seed: int, trial: int) -> Observation:
    """Make what an estimator may see of a sight.

    The image of a lens is resampled to the pinhole that the spacecraft takes it for, once for all estimators.
    """
    spec = world.scenario.spec
    true = sight.view.T_cam_body
    prior = degrade(true, spec.pose_error, world.camera, generator(seed, Stream.POSE_ERROR, trial))
    knowledge = generator(seed, Stream.KNOWLEDGE, trial)
    prior = believed_attitude(prior, spec.onboard, knowledge)
    range_m = float(np.linalg.norm(prior.translation_m))
    camera = believed_camera(spec)
    frame = Frame(
        image=_read_only(rectify(sight.image, camera)),
        sun_dir_cam=_read_only(believed_sun(true.rotate(sight.view.sun_dir_body), spec.onboard, knowledge)),
        prior_T_cam_body=prior,
        prior_covariance=_read_only(prior_covariance(spec.pose_error, range_m, world.camera)),
        time_s=sight.time_s,
        altimeter=altimeter_reading(world, sight.view, generator(seed, Stream.ALTIMETER, trial)),
    )
    return Observation(camera.pinhole, (frame,))


def _read_only(array: NDArray[T]) -> NDArray[T]:
    view = array.view()
    view.setflags(write=False)
    return view

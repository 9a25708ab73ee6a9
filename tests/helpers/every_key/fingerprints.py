"""What trials of a scenario show to an estimator, the truth that they are scored against and what is lent, hashed."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from boresight.campaign.imaging.observe import observe
from boresight.campaign.imaging.world import open_world
from boresight.campaign.kinds.crater_matching.pairs import BY_GEOMETRY, open_pairs
from boresight.campaign.kinds.crater_navigation.images import NavigationTrial, open_sights
from boresight.campaign.kinds.orbit_determination.trial import open_orbit_world
from boresight.campaign.kinds.sequence.images import OrbitImages
from boresight.campaign.kinds.sequence.tracks import ImageTracks
from boresight.campaign.kinds.sequence.trial import ground_of
from boresight.campaign.products import BuiltAssets
from boresight.estimators.craters.navigation.rounds import CraterNavigation
from boresight.estimators.craters.navigation.stages import StageFiles
from boresight.estimators.slam.registry import sequence_estimator_class
from boresight.renderers.mitsuba3 import choose_variant
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import View, look_at
from boresight.scenarios.load import LoadedScenario, load_scenario
from boresight.scenarios.orbits.draw import draw_orbit
from boresight.scenarios.orbits.imaging import imaging_of
from boresight.scenarios.sequences import draw_sequence


def fingerprint(file: Path, overrides: tuple[str, ...] = ()) -> str:
    """Hash what three trials show to an estimator, the truth that they are scored against and what is lent."""
    variant = choose_variant().name
    scenario = load_scenario(str(file), overrides)
    if scenario.spec.sequence is not None:
        return sequence_fingerprint(scenario)
    if scenario.spec.crater_pairs is not None:
        return pairs_fingerprint(scenario)
    if scenario.spec.orbit is not None:
        imaged = scenario.spec.orbit.imaging is not None
        return imaging_fingerprint(scenario) if imaged else orbit_fingerprint(scenario)
    world = open_world(scenario, variant)
    parts = [*lent(BuiltAssets(scenario, file.parent / "products", None, variant))]
    if world.ground is not None:
        parts.append(world.ground.rims.crest_m.tobytes())
    for trial in range(3):
        try:
            sight = world.source.trial_image(3, trial)
        except BoresightError as error:
            parts.append(str(error).encode())
            continue
        observation = observe(world, sight, 3, trial)
        frame = observation.frame
        parts += [repr(observation.camera).encode(), repr(frame.altimeter).encode()]
        truths = [sight.view.T_cam_body, *(view.T_cam_body for view in sight.further.values())]
        poses = [array for pose in (*truths, frame.prior_T_cam_body) for array in (pose.rotation, pose.translation_m)]
        arrays = [sight.image, frame.image, frame.sun_dir_cam, frame.prior_covariance, *poses]
        parts += [np.ascontiguousarray(array).tobytes() for array in arrays]
        parts += [name.encode() for name in sight.further]
    return hashlib.sha256(b"|".join(parts)).hexdigest()


def orbit_fingerprint(scenario: LoadedScenario) -> str:
    """Hash what a trial of orbit determination shows to an estimator, and its truth."""
    truth, data = draw_orbit(open_orbit_world(scenario, 3), 3, 0)
    known, pictures, marks, radio = data.knowledge, data.pictures, data.landmarks, data.radiometry
    field = known.field
    arrays = [truth.states, truth.image_states, truth.crater, truth.wrong, truth.points_body_m, data.wanted_s]
    arrays += [pictures.times_s, pictures.R_cam_inertial, pictures.image, pictures.landmark, pictures.uv_px]
    arrays += [marks.numbers, marks.positions_body_m, marks.sigma_m, known.state, field.light_m_s2]
    arrays += [
        field.harmonics.c,
        field.harmonics.s,
        radio.times_s,
        radio.earth_dir,
        radio.range_m,
        radio.range_rate_m_s,
    ]
    numbers = [known.noise_px, known.attitude_sigma_rad, known.misalignment_sigma_rad, known.focal_sigma]
    numbers += [known.gm_sigma, known.light_sigma, known.noise_m_s2, known.noise_time_s, field.harmonics.gm_m3_s2]
    numbers += [radio.range_sigma_m, radio.range_rate_sigma_m_s, radio.range_bias_sigma_m, field.rotation.rate_rad_s]
    parts = [np.ascontiguousarray(array).tobytes() for array in arrays] + [repr(numbers).encode()]
    return hashlib.sha256(b"|".join(parts)).hexdigest()


def imaging_fingerprint(scenario: LoadedScenario) -> str:
    """Hash what the images of a trial show to a chain of crater navigation, and their truth."""
    world = open_orbit_world(scenario, 3)
    sights = open_sights(scenario, imaging_of(world), choose_variant().name)
    with tempfile.TemporaryDirectory() as folder:
        taken = NavigationTrial.take(world, sights, 3, 0, StageFiles(Path(folder)))
        searched = taken.search(CraterNavigation.from_options({}), taken.task, StageFiles(Path(folder)))
    arrays = [taken.flown.image_states, taken.task.shape.ground.mesh.vertices_m]
    for view, image in zip(taken.views, searched, strict=True):
        shown, rims = image.exposure, image.exposure.detections.ellipses
        arrays += [view.T_cam_body.rotation, shown.R_cam_inertial, shown.sun_dir_cam, shown.pixels, image.crater]
        arrays += [rims.centre_px, rims.semi_axes_px, rims.angle_rad]
    return hashlib.sha256(b"|".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()


def sequence_fingerprint(scenario: LoadedScenario) -> str:
    """Hash what two trials of a sequence show to an estimator, and their truth."""
    spec, ground, tracks = scenario.spec, ground_of(scenario), None
    if spec.sequence.images is not None:
        tracks = ImageTracks(spec.sequence, ground, OrbitImages.open(scenario, choose_variant().name, 3))
    parts: list[bytes] = []
    for trial in range(2):
        if tracks is None:
            truth, sequence = draw_sequence(spec.sequence, spec.camera.camera(), ground, 3, trial)
        else:
            watch = tracks.watch(3, trial)
            sequence_estimator_class("ba-slam").from_options({"connectivity": 2}).follow(watch.sequence)
            seen = watch.seen()
            truth, sequence = seen.truth, seen.sequence
        parts += [repr((sequence.camera, [(f.time_s, f.sigma_px, f.ranges) for f in sequence.frames])).encode()]
        arrays = [truth.points_m, sequence.position_m, sequence.position_covariance_m2]
        known = sequence.forces
        if known is not None:
            parts += [
                repr((known.gm_m3_s2, known.gm_sigma_m3_s2, known.radiation_sigma_m_s2, known.noise_m_s2)).encode()
            ]
            arrays += [known.radiation_m_s2, known.velocity_m_s, known.velocity_covariance_m2_s2]
        for frame in sequence.frames:
            arrays += [frame.again, frame.R_body_inertial, np.float64(frame.attitude_sigma_rad)]
            arrays += [frame.R_cam_body, frame.tracks, frame.uv_px, frame.motion_m, frame.motion_covariance_m2]
        parts += [array.tobytes() for array in arrays]
    return hashlib.sha256(b"|".join(parts)).hexdigest()


def pairs_fingerprint(scenario: LoadedScenario) -> str:
    """Hash what two pairs of looks show to a matcher, and their truth."""
    detector = BY_GEOMETRY if scenario.spec.crater_pairs.images is None else "crater-classic"
    source = open_pairs(scenario, scenario.spec.crater_pairs, choose_variant().name, [detector])
    parts: list[bytes] = []
    for trial in range(2):
        pair = source.looks(3, trial).seen_by(detector)
        for one in (pair.first, pair.second):
            rims, pose = one.detections.ellipses, one.frame.prior_T_cam_body
            arrays = [one.detections.crater, rims.centre_px, rims.semi_axes_px, rims.angle_rad, pose.rotation]
            arrays += [pose.translation_m, one.frame.sun_dir_cam, one.view.T_cam_body.translation_m]
            parts += [array.tobytes() for array in arrays]
    return hashlib.sha256(b"|".join(parts)).hexdigest()


def lent(assets: BuiltAssets) -> Iterator[bytes]:
    """Yield what estimators borrow: the camera, the shape, and an image of it in the BRDF that is believed in."""
    shape = assets.shape()
    yield repr(assets.camera).encode()
    yield np.ascontiguousarray(shape.vertices_m).tobytes()
    view = View(assets.camera, look_at(6.0 * shape.radius_m * np.array([0.9, 0.4, 0.2])), np.array([1.0, 0.0, 0.0]))
    yield np.ascontiguousarray(assets.mesh_renderer(shape).render(view)).tobytes()

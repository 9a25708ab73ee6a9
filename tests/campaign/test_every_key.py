"""Every key of the scenario schema changes the result: a dispersion that is never applied is the classic silent fault.

One key at a time is overridden as on the command line, in a scenario where it applies, and the fingerprint of what
an estimator sees (image, prior pose, its covariance, the Sun) and of the truth must change.
"""

from __future__ import annotations

import csv
import hashlib
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import UnionType
from typing import Annotated, Union, get_args, get_origin

import cv2
import numpy as np
import pytest
import trimesh
from tiny_mission import make_mission

from campaign.crater_pairs import BY_GEOMETRY, open_pairs
from campaign.crater_sights import open_sights
from campaign.experiments.orbit_determination import open_orbit_world
from campaign.experiments.sequence import ground_of
from campaign.experiments.single_image import SingleImage
from campaign.image_tracks import ImageTracks
from campaign.navigation_trial import NavigationTrial
from campaign.orbit_images import OrbitImages
from campaign.products import Shelf
from campaign.world import open_world
from estimators.craters.navigation.rounds import CraterNavigation
from estimators.craters.navigation.stages import Stages
from estimators.slam.registry import sequence_estimator_class
from renderers.mitsuba3 import choose_variant
from scenarios.errors import BoresightError
from scenarios.geometry import View, look_at
from scenarios.load import LoadedScenario, load_scenario
from scenarios.orbits.draw import draw_orbit
from scenarios.orbits.imaging import imaging_of
from scenarios.sequences import draw_sequence
from scenarios.spec.base import SpecModel
from scenarios.spec.scenario import ScenarioSpec

RENDERED = """
body:
  detail:
    facets: 5000
    boulders: {count: 60, min_diameter_m: 15, max_diameter_m: 60}
    craters: {count: 10, min_diameter_m: 40, max_diameter_m: 120}
    roughness: {rms_m: 4, max_wavelength_m: 200, min_wavelength_m: 20}
    albedo: {sigma: 0.2, wavelength_m: 100}
camera: {width_px: 48, height_px: 40, fov_deg: 18.3}
detector: {full_well_e: 3.0e+5, psf_sigma_px: 0.6}
lighting: {phase_deg: {uniform: [20, 60]}}
viewpoint: {range_m: 2000}
"""
LENS = RENDERED.replace("fov_deg: 18.3}", "fov_deg: 18.3, distortion: {k1: 1.5}}")
PAIRS = """
body: {shape: contact-binary}
camera: {width_px: 256, height_px: 256, fov_deg: 3}
crater_pairs:
  range_m: 4000
  view_deg: {uniform: [0, 20]}
  sun_deg: {uniform: [0, 30]}
  aim_sigma_m: 5
  craters: {count: 400, min_diameter_m: 8, max_diameter_m: 60}
  errors: {height_m: 0.3, least_radius_px: 4}
"""
OREN_NAYAR = RENDERED + "brdf: {kind: oren-nayar}\n"
HAPKE = RENDERED + "brdf: {kind: hapke, c: 0.4}\n"
MCEWEN = RENDERED + "brdf: {kind: mcewen}\n"
OPPOSITION = HAPKE.replace("uniform: [20, 60]", "uniform: [0, 4]")
GAUSSIAN = RENDERED + (
    "pose_error: {position_cam_m: {normal: [9, 9, 2]}, attitude: {rotation_vector_deg: {normal: [1, 1, 1]}}}\n"
)
ANGLE = RENDERED + "pose_error: {position_cam_px: {normal: [9, 9, 2]}, attitude: {angle_deg: {normal: 1}}}\n"
UNIFORM = RENDERED + (
    "pose_error: {position_cam_px: {uniform: [[-9, 9], [-9, 9], [-2, 2]]},"
    " attitude: {rotation_vector_deg: {uniform: [[-1, 1], [-1, 1], [-1, 1]]}}}\n"
)
ALTIMETER = RENDERED + "sensors: {altimeter: {sigma_m: 5}}\n"
BALL = RENDERED.replace("body:\n", "body:\n  shape: sphere\n")
WRONG_HEIGHTS = RENDERED.replace(
    "body:\n", "body:\n  height_error: {rms_m: 4, max_wavelength_m: 200, min_wavelength_m: 50}\n"
)
# From so far that the egg may be 600 m or 600 km long.
SHAPE = RENDERED.replace("body:\n", "body:\n  shape: egg.obj\n  unit: m\n").replace("range_m: 2000", "range_m: 800000")
GRID = RENDERED.replace("body:\n", "body:\n  shape: grid.tab\n  unit: m\n  format: pds-grid\n")
CRATERED = """
body: {shape: sphere}
craters:
  {count: 40, min_diameter_m: 24, max_diameter_m: 120, edge_m: 6, known_diameter_m: 30,
   roughness: {rms_m: 2, max_wavelength_m: 80, min_wavelength_m: 20}}
camera: {width_px: 48, height_px: 40, fov_deg: 18.3}
lighting: {phase_deg: {uniform: [20, 60]}}
viewpoint: {range_m: 2000}
"""
SEEN = """
body: {shape: sphere}
craters:
  {count: 40, min_diameter_m: 24, max_diameter_m: 120, edge_m: 6, known_diameter_m: 30,
   roughness: {rms_m: 2, max_wavelength_m: 80, min_wavelength_m: 20}}
camera: {width_px: 192, height_px: 192, fov_deg: 12}
crater_pairs:
  range_m: 2000
  view_deg: {uniform: [0, 10]}
  sun_deg: {uniform: [0, 10]}
  aim_sigma_m: 5
  images: {}
"""
REAL = """
body: {shape: sphere}
camera: {width_px: 48, height_px: 40, fov_deg: 18.3}
images: {folder: set, truth: ref, also_score: [label], noise_realisations: 2}
"""
ORBIT = """
body: {shape: egg.obj}
camera: {width_px: 512, height_px: 400, fov_deg: 5}
orbit:
  arc: {semi_major_axis_m: 3000, days: 1, predicted_days: 0.5}
  asteroid: {gm_m3_s2: 5}
  light: {noise_share: 0.1}
  sightings: {images: 20, craters: 120, wrong_share: 0.2, merged_share: 0.1}
  pointing: {focal_error: 0.001}
  knowledge: {position_m: 100, shape_degree: 4}
"""
IMAGED = """
body: {shape: sphere}
craters: {count: 40, min_diameter_m: 24, max_diameter_m: 120, edge_m: 6, known_diameter_m: 30, roughness: null}
camera: {width_px: 48, height_px: 40, fov_deg: 12}
orbit:
  arc: {semi_major_axis_m: 2000, days: 0.3}
  asteroid: {gm_m3_s2: 5, gravity_degree: 2}
  knowledge: {position_m: 10, shape_degree: 4}
  imaging:
    epochs: 3
    detections: drawn
    craters: {count: 3000, min_diameter_m: 20, max_diameter_m: 100}
    errors: {least_radius_px: 0.5}
"""
SEQUENCE = """
camera: {width_px: 64, height_px: 64, fov_deg: 30}
sequence:
  sphere_radius_m: 190
  orbit: {step_deg: 6, revolutions: 0.2}
  vision: {landmarks_per_frame: 30}
"""

PROPAGATED = SEQUENCE.replace("{step_deg", "{model: propagated, forces: {area_to_mass_m2_kg: 0.02}, step_deg")
EGG = """
body: {shape: egg.obj, unit: m}
camera: {width_px: 64, height_px: 64, fov_deg: 30}
sequence:
  orbit: {model: propagated, step_deg: 6, revolutions: 0.2}
"""
SPIN = SEQUENCE + "  body_motion: {kind: spin}\n"
TUMBLING = SEQUENCE + "  body_motion: {kind: tumbling, axis_body: [0.5, 0, 1]}\n"
IMAGES = """
body: {shape: apophis-sphere, detail: {facets: 80000, albedo: {sigma: 0.35, wavelength_m: 60}}}
camera: {width_px: 200, height_px: 200, fov_deg: 30}
sequence:
  orbit: {step_deg: 5, revolutions: 0.05}
  images: {starts: 2, tracks: 12}
"""
FIXED = SEQUENCE.replace("per_frame: 30", "per_frame: 30, field: fixed, recognised: 0.6")
DYNAMICS = PROPAGATED + "  knowledge: {dynamics: true}\n"

KERNELS = "[naif.tls, tiny.tsc, tiny.tf, tiny.ti, tiny.bsp, tiny.bc]"
SPICE = f"""
body: {{shape: contact-binary}}
camera: {{width_px: 64, height_px: 64, focal_px: [629.1667, 629.1667], distortion: {{k1: -0.40859392}}}}
images:
  folder: mission
  spice: {{instrument: hayabusa-amica, target: ITOKAWA, target_frame: ITOKAWA_FIXED, kernels: {KERNELS}}}
"""

# key: (scenario, new value)
CHANGES: dict[str, tuple[str, str]] = {
    "body.shape": (RENDERED, "sphere"),
    "body.unit": (SHAPE, "km"),
    "body.longitude": (GRID, "west"),
    "body.shading": (RENDERED, "smooth"),
    "body.detail.facets": (RENDERED, "40000"),
    "body.detail.seed": (RENDERED, "1"),
    "body.detail.boulders.count": (RENDERED, "90"),
    "body.detail.boulders.min_diameter_m": (RENDERED, "25"),
    "body.detail.boulders.max_diameter_m": (RENDERED, "90"),
    "body.detail.boulders.exponent": (RENDERED, "1.5"),
    "body.detail.boulders.height_ratio": (RENDERED, "0.7"),
    "body.detail.craters.count": (RENDERED, "20"),
    "body.detail.craters.min_diameter_m": (RENDERED, "60"),
    "body.detail.craters.max_diameter_m": (RENDERED, "160"),
    "body.detail.craters.exponent": (RENDERED, "1.2"),
    "body.detail.craters.depth_ratio": (RENDERED, "0.2"),
    "body.detail.craters.rim_ratio": (RENDERED, "0.08"),
    "body.detail.roughness.rms_m": (RENDERED, "7"),
    "body.detail.roughness.hurst": (RENDERED, "0.4"),
    "body.detail.roughness.max_wavelength_m": (RENDERED, "120"),
    "body.detail.roughness.min_wavelength_m": (RENDERED, "60"),
    "body.detail.albedo.sigma": (RENDERED, "0.4"),
    "body.detail.albedo.wavelength_m": (RENDERED, "60"),
    "craters.seed": (CRATERED, "1"),
    "craters.count": (CRATERED, "50"),
    "craters.min_diameter_m": (CRATERED, "30"),
    "craters.max_diameter_m": (CRATERED, "90"),
    "craters.exponent": (CRATERED, "1.2"),
    "craters.depth_ratio": (CRATERED, "[0.1, 0.15]"),
    "craters.rim_ratio": (CRATERED, "0.06"),
    "craters.known_diameter_m": (CRATERED, "50"),
    "craters.edge_m": (CRATERED, "5"),
    "craters.roughness.rms_m": (CRATERED, "3"),
    "craters.roughness.hurst": (CRATERED, "0.4"),
    "craters.roughness.max_wavelength_m": (CRATERED, "60"),
    "craters.roughness.min_wavelength_m": (CRATERED, "40"),
    "camera.width_px": (RENDERED, "52"),
    "camera.height_px": (RENDERED, "44"),
    "camera.fov_deg": (RENDERED, "20"),
    "camera.focal_px": (RENDERED, "[150, 151]"),
    "camera.principal_point_px": (RENDERED, "[25, 19]"),
    "camera.distortion.k1": (LENS, "0.6"),
    "camera.distortion.k2": (LENS, "0.5"),
    "rendering.samples_per_pixel": (RENDERED, "9"),
    "detector.psf_sigma_px": (RENDERED, "1.0"),
    "detector.exposure_s": (RENDERED, "0.2"),
    "detector.white_e_per_s": (RENDERED, "1.0e+6"),
    "detector.dark_e_per_s": (RENDERED, "1000"),
    "detector.full_well_e": (RENDERED, "20000"),
    "detector.read_noise_e": (RENDERED, "60"),
    "detector.shot_noise": (RENDERED, "false"),
    "detector.gain_e_per_dn": (RENDERED, "40"),
    "detector.offset_dn": (RENDERED, "20"),
    "detector.bits": (RENDERED, "8"),
    "brdf.kind": (RENDERED, "oren-nayar"),
    "brdf.albedo": (RENDERED, "0.5"),
    "brdf.sigma_deg": (OREN_NAYAR, "40"),
    "brdf.form": (OREN_NAYAR, "qualitative"),
    "brdf.w": (HAPKE, "0.6"),
    "brdf.L1_per_deg": (MCEWEN, "-0.01"),
    "brdf.L2_per_deg2": (MCEWEN, "1.0e-4"),
    "brdf.L3_per_deg3": (MCEWEN, "-1.0e-6"),
    "brdf.b": (HAPKE, "0.5"),
    "brdf.c": (HAPKE, "0.9"),
    "brdf.B0": (OPPOSITION, "0.4"),
    "brdf.h": (OPPOSITION, "0.1"),
    "brdf.theta_bar_deg": (HAPKE, "10"),
    "brdf.H_function": (HAPKE, "'1981'"),
    "viewpoint.range_m": (RENDERED, "2100"),
    "viewpoint.roll_deg.uniform": (RENDERED, "[0, 10]"),
    "viewpoint.latitude_deg.uniform": (RENDERED, "[-5, 5]"),
    "viewpoint.targets": (RENDERED, "[terminator]"),
    "viewpoint.keep_clear_px": (RENDERED, "[[0, 0, 48, 5]]"),
    "lighting.phase_deg.uniform": (RENDERED, "[30, 80]"),
    "lighting.measure": (RENDERED, "angle"),
    "pose_error.position_cam_m.uniform": (RENDERED, "[[-5, 5], [-5, 5], [-1, 1]]"),
    "pose_error.position_cam_m.normal": (GAUSSIAN, "[9, 9, 4]"),
    "pose_error.position_cam_px.uniform": (UNIFORM, "[[-9, 9], [-9, 9], [-1, 1]]"),
    "pose_error.position_cam_px.normal": (ANGLE, "[9, 8, 2]"),
    "pose_error.attitude.angle_deg.uniform": (RENDERED, "[-1, 1]"),
    "pose_error.attitude.angle_deg.normal": (ANGLE, "2"),
    "pose_error.attitude.rotation_vector_deg.uniform": (UNIFORM, "[[-1, 1], [-1, 1], [-2, 2]]"),
    "pose_error.attitude.rotation_vector_deg.normal": (GAUSSIAN, "[1, 1, 2]"),
    "body.even_facets": (BALL, "2000"),
    "body.height_error.rms_m": (WRONG_HEIGHTS, "9"),
    "body.height_error.max_wavelength_m": (WRONG_HEIGHTS, "150"),
    "body.height_error.min_wavelength_m": (WRONG_HEIGHTS, "80"),
    "body.height_error.hurst": (WRONG_HEIGHTS, "0.4"),
    "body.height_error.seed": (WRONG_HEIGHTS, "1"),
    "onboard.brdf": (RENDERED, "{kind: oren-nayar}"),
    "onboard.body": (RENDERED, "{shape: sphere}"),
    "onboard.facets": (RENDERED, "20000"),
    "onboard.height_error": (RENDERED, "{rms_m: 2, max_wavelength_m: 200, min_wavelength_m: 40}"),
    "onboard.albedo": (RENDERED, "uniform"),
    "onboard.focal_error": (RENDERED, "0.01"),
    "onboard.principal_point_error_px": (RENDERED, "[1, 0]"),
    "onboard.distortion_error": (LENS, "-1"),
    "onboard.sun_error_deg.uniform": (RENDERED, "[5, 5]"),
    "onboard.sun_error_deg.normal": (RENDERED, "5"),
    "onboard.pole_error_deg.uniform": (RENDERED, "[1, 1]"),
    "onboard.pole_error_deg.normal": (RENDERED, "1"),
    "onboard.rotation_error_deg.uniform": (RENDERED, "[1, 1]"),
    "onboard.rotation_error_deg.normal": (RENDERED, "1"),
    "sensors.altimeter.sigma_m": (ALTIMETER, "3"),
    "crater_pairs.range_m": (PAIRS, "4100"),
    "crater_pairs.view_deg.uniform": (PAIRS, "[5, 20]"),
    "crater_pairs.sun_deg.uniform": (PAIRS, "[5, 30]"),
    "crater_pairs.emission_deg.uniform": (PAIRS, "[5, 30]"),
    "crater_pairs.incidence_deg.uniform": (PAIRS, "[30, 60]"),
    "crater_pairs.aim_sigma_m": (PAIRS, "9"),
    "crater_pairs.craters.count": (PAIRS, "500"),
    "crater_pairs.craters.min_diameter_m": (PAIRS, "9"),
    "crater_pairs.craters.max_diameter_m": (PAIRS, "50"),
    "crater_pairs.craters.exponent": (PAIRS, "2"),
    "crater_pairs.craters.seed": (PAIRS, "1"),
    "crater_pairs.errors.centre_px": (PAIRS, "1"),
    "crater_pairs.errors.centre_radii": (PAIRS, "0.1"),
    "crater_pairs.errors.axes_px": (PAIRS, "0.5"),
    "crater_pairs.errors.axes_ratio": (PAIRS, "0.1"),
    "crater_pairs.errors.recall": (PAIRS, "0.5"),
    "crater_pairs.errors.false_share": (PAIRS, "0.5"),
    "crater_pairs.errors.least_radius_px": (PAIRS, "6"),
    "crater_pairs.errors.height_m": (PAIRS, "2"),
    "crater_pairs.images.most_detections": (SEEN, "1"),
    "sequence.sphere_radius_m": (SEQUENCE, "170"),
    "sequence.orbit.radius_m": (SEQUENCE, "800"),
    "sequence.orbit.normal_body": (SEQUENCE, "[0, 1, 1]"),
    "sequence.orbit.start_deg": (SEQUENCE, "60"),
    "sequence.orbit.step_deg": (SEQUENCE, "5"),
    "sequence.orbit.revolutions": (SEQUENCE, "0.3"),
    "sequence.orbit.gm_m3_s2": (SEQUENCE, "3"),
    "sequence.orbit.model": (SEQUENCE, "propagated"),
    "sequence.orbit.forces.gravity": (EGG, "polyhedral"),
    "sequence.orbit.forces.area_to_mass_m2_kg": (PROPAGATED, "0.03"),
    "sequence.orbit.forces.reflectivity": (PROPAGATED, "1.4"),
    "sequence.orbit.forces.sun_distance_au": (PROPAGATED, "0.9"),
    "sequence.orbit.forces.noise_m_s2": (PROPAGATED, "1.0e-7"),
    "sequence.body_motion.kind": (SEQUENCE, "spin"),
    "sequence.body_motion.period_h": (SPIN, "12"),
    "sequence.body_motion.axis_body": (SPIN, "[1, 0, 1]"),
    "sequence.body_motion.inertia": (TUMBLING, "[0.5, 0.9, 1]"),
    "sequence.vision.landmarks_per_frame": (SEQUENCE, "20"),
    "sequence.vision.count": (SEQUENCE, "constant"),
    "sequence.vision.field": (SEQUENCE, "fixed"),
    "sequence.vision.tracked_share": (FIXED, "0.4"),
    "sequence.vision.recognised": (FIXED, "0.3"),
    "sequence.vision.mistaken": (FIXED, "0.2"),
    "sequence.vision.lit_only": (SEQUENCE, "true"),
    "sequence.vision.noise_px": (SEQUENCE, "0.5"),
    "sequence.vision.repeatability": (SEQUENCE, "0.7"),
    "sequence.vision.repeatability_step_deg": (SEQUENCE, "1"),
    "sequence.vision.min_connection": (SEQUENCE, "28"),
    "sequence.vision.mismatch_share": (SEQUENCE, "0.1"),
    "sequence.vision.outlier_share": (SEQUENCE, "0.1"),
    "sequence.images.starts": (IMAGES, "4"),
    "sequence.images.detector": (IMAGES, "sift"),
    "sequence.images.features": (IMAGES, "40"),
    "sequence.images.ratio_max": (IMAGES, "0.5"),
    "sequence.images.epipolar": (IMAGES, "known-attitude"),
    "sequence.images.epipolar_max_px": (IMAGES, "0.1"),
    "sequence.images.carry": (IMAGES, "patch"),
    "sequence.images.tracks": (IMAGES, "9"),
    "sequence.images.spacing_px": (IMAGES, "40"),
    "sequence.images.guided": (IMAGES, "true"),
    "sequence.images.growth_max": (IMAGES, "1.01"),
    "sequence.images.sigma_px": (IMAGES, "0.7"),
    "sequence.knowledge.motion_error": (SEQUENCE, "0.4"),
    "sequence.knowledge.ranges": (SEQUENCE, "2"),
    "sequence.knowledge.range_to": (SEQUENCE, "lasting"),
    "sequence.knowledge.range_sigma_m": (SEQUENCE, "0.2"),
    "sequence.knowledge.position_sigma_m": (SEQUENCE, "1"),
    "sequence.knowledge.attitude_sigma_deg": (SEQUENCE, "0.1"),
    "sequence.knowledge.range_every": (SEQUENCE, "5"),
    "sequence.knowledge.misalignment_sigma_deg": (SEQUENCE, "0.1"),
    "sequence.knowledge.pole_sigma_deg": (SPIN, "1"),
    "sequence.knowledge.spin_sigma": (SPIN, "0.01"),
    "sequence.knowledge.dynamics": (PROPAGATED, "true"),
    "sequence.knowledge.gm_sigma": (DYNAMICS, "0.05"),
    "sequence.knowledge.radiation_sigma": (DYNAMICS, "0.2"),
    "sequence.knowledge.velocity_sigma_m_s": (DYNAMICS, "0.001"),
    "sequence.knowledge.noise_m_s2": (DYNAMICS, "1.0e-7"),
    "images.folder": (REAL, "other"),
    "images.table": (REAL, "more.csv"),
    "images.first_row": (REAL, "bottom"),
    "images.spice.files": (SPICE, "b*.lbl"),
    "images.spice.kernels": (SPICE, KERNELS.replace("tiny.tf", "tiny.tf, still.tf")),
    "images.spice.target_frame": (SPICE, "J2000"),
    "images.spice.aberration": (SPICE, "NONE"),
    "images.keep_clear_px": (REAL, "[[0, 39.5, 48, 40]]"),
    "images.truth": (REAL, "third"),
    "images.also_score": (REAL, "[third]"),
    "images.noise_realisations": (REAL, "1"),
}
CHANGES |= {
    f"orbit.{key}": (ORBIT, value)
    for key, value in {
        "arc.semi_major_axis_m": "4000",
        "arc.eccentricity": "0.1",
        "arc.inclination_deg": "50",
        "arc.node_deg": "10",
        "arc.pericentre_deg": "40",
        "arc.anomaly_deg": "100",
        "arc.days": "1.5",
        "arc.predicted_days": "2",
        "asteroid.gm_m3_s2": "6",
        "asteroid.gravity_degree": "4",
        "asteroid.anomaly_sigma": "0.01",
        "asteroid.rotation_h": "7",
        "light.sun_dir": "[1, 0.2, 0.3]",
        "light.sun_distance_au": "1",
        "light.earth_dir": "[0, 1, 0.1]",
        "light.area_to_mass_m2_kg": "0.05",
        "light.reflectivity": "1.6",
        "light.noise_share": "0.5",
        "light.noise_days": "0.3",
        "sightings.images": "25",
        "sightings.craters": "150",
        "sightings.per_image": "4",
        "sightings.per_image_shape": "5",
        "sightings.emission_max_deg": "40",
        "sightings.incidence_max_deg": "40",
        "sightings.margin_px": "100",
        "sightings.noise_px": "2",
        "sightings.wrong_share": "0.5",
        "sightings.wrong_within_px": "3",
        "sightings.merged_share": "0.4",
        "pointing.attitude_urad": "300",
        "pointing.misalignment_urad": "900",
        "pointing.focal_error": "0.01",
        "radiometry.interval_h": "2",
        "radiometry.range_sigma_m": "20",
        "radiometry.range_rate_sigma_m_s": "0.01",
        "radiometry.range_bias_sigma_m": "100",
        "knowledge.position_m": "300",
        "knowledge.gm_sigma": "0.01",
        "knowledge.light_sigma": "0.3",
        "knowledge.shape_degree": "3",
    }.items()
}
CHANGES |= {
    f"orbit.imaging.{key}": (IMAGED, value)
    for key, value in {
        "epochs": "4",
        "detections": "rendered",
        "control_urad": "900",
        "craters.count": "2500",
        "craters.min_diameter_m": "24",
        "craters.max_diameter_m": "80",
        "craters.exponent": "2.5",
        "craters.seed": "1",
        "errors.centre_px": "1",
        "errors.centre_radii": "0.1",
        "errors.axes_px": "0.5",
        "errors.axes_ratio": "0.1",
        "errors.recall": "0.5",
        "errors.false_share": "0.5",
        "errors.least_radius_px": "1.5",
        "errors.height_m": "2",
    }.items()
}
SAME_TERMS = {"onboard.brdf", "onboard.body", "onboard.height_error"}
# Keys that change no result, each with its reason.
NO_RESULT = {
    "name": "names the scenario in tables",
    "description": "prose",
    "images.credit": "printed below figures",
    "images.spice.instrument": "images of another camera are refused",
    "images.spice.target": "images of another body are refused",
    "body.format": "says how to read the file; a wrong one is refused",
    "body.expected_diameter_m": "a guard: a body outside is refused",
    "viewpoint.kind": "has one value",
    "pose_error.attitude.axis": "has one value",
}


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("keys")
    trimesh.creation.icosphere(subdivisions=2, radius=200.0).apply_scale([1.5, 1.0, 0.8]).export(folder / "egg.obj")
    lines = [
        f"{latitude:9.3f} {longitude:9.3f} {200 + 30 * np.sin(np.radians(longitude)):9.3f}"
        for latitude in range(-90, 91, 15)
        for longitude in range(0, 361, 15)
    ]
    (folder / "grid.tab").write_text("\n".join(lines) + "\n")
    for number, name in enumerate(("set", "other")):
        _write_image_set(folder / name, np.random.default_rng(number))
    mission = make_mission(folder / "mission")
    for number, name in enumerate(("a", "b", "c")):
        mission.write_image(name, np.random.default_rng(number).uniform(0, 100, (64, 64)), 600.0 * number)
    (mission.folder / "still.tf").write_text("KPL/PCK\n\\begindata\nBODY2025143_PM = ( 0.0 0.0 0.0 )\n\\begintext\n")
    return folder


def _write_image_set(folder: Path, rng: np.random.Generator) -> None:
    folder.mkdir()
    for name in ("a.png", "b.png"):
        cv2.imwrite(str(folder / name), rng.integers(0, 255, (40, 48), dtype=np.uint8))
    for table, shift in (("poses.csv", 0.0), ("more.csv", 5.0)):
        with (folder / table).open("w", newline="") as stream:
            writer = csv.writer(stream)
            head = ["file", "time_s", "sun_body_x", "sun_body_y", "sun_body_z"]
            prefixes = ("ref", "label", "third")
            parts = ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")
            writer.writerow(head + [f"{prefix}_{part}" for prefix in prefixes for part in parts])
            for time_s, name in enumerate(("a.png", "b.png")):
                poses = [[1, 0, 0, 0, k + shift, 80 * time_s, 2000] for k in range(3)]
                writer.writerow([name, time_s, 0, 0, -1, *(x for pose in poses for x in pose)])


def leaves(model: type[SpecModel], prefix: str = "") -> Iterator[str]:
    """Yield the dotted name of every key of the schema that holds a value.

    What is known on board is said in the terms of the body and its reflectance, whose keys have their own lines.
    """
    for name, field in model.model_fields.items():
        models = [] if prefix + name in SAME_TERMS else list(_models(field.annotation))
        if not models:
            yield prefix + name
        for inner in models:
            yield from leaves(inner, f"{prefix}{name}.")


def _models(annotation: object) -> Iterator[type[SpecModel]]:
    if isinstance(annotation, type) and issubclass(annotation, SpecModel):
        yield annotation
    elif get_origin(annotation) in (Union, UnionType, Annotated):
        for argument in get_args(annotation):
            yield from _models(argument)


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
    experiment = SingleImage(world, {}, seed=3)
    parts = [*lent(Shelf(scenario, file.parent / "products", 0, variant))]
    if world.ground is not None:
        parts.append(world.ground.rims.crest_m.tobytes())
    for trial in range(3):
        try:
            sight = world.source.sight(3, trial)
        except BoresightError as error:
            parts.append(str(error).encode())
            continue
        observation = experiment.observe(sight, trial)
        frame = observation.frames[0]
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
        taken = NavigationTrial.take(world, sights, 3, 0, Stages(Path(folder)))
        searched = taken.search(CraterNavigation.from_options({}), Stages(Path(folder)))
    arrays = [taken.flown.image_states, taken.task.shape.ground.mesh.vertices_m]
    for view, image in zip(taken.views, searched, strict=True):
        shown, rims = image.exposure, image.exposure.detections.ellipses
        arrays += [view.T_cam_body.rotation, shown.R_cam_inertial, shown.sun_dir_cam, shown.pixels, image.crater]
        arrays += [rims.centre_px, rims.semi_axes_px, rims.angle_rad]
    return hashlib.sha256(b"|".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()


def sequence_fingerprint(scenario: LoadedScenario) -> str:
    """Hash what two trials of a sequence show to an estimator, and their truth."""
    spec = scenario.spec
    parts: list[bytes] = []
    for trial in range(2):
        ground = ground_of(scenario)
        if spec.sequence.images is None:
            truth, sequence = draw_sequence(spec.sequence, spec.camera.camera(), ground, 3, trial)
        else:
            images = OrbitImages.open(scenario, choose_variant().name, 3)
            watch = ImageTracks(spec.sequence, ground, images).watch(3, trial)
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


def lent(shelf: Shelf) -> Iterator[bytes]:
    """Yield what estimators borrow: the camera, the shape, and an image of it in the BRDF that is believed in."""
    shape = shelf.shape()
    yield repr(shelf.camera).encode()
    yield np.ascontiguousarray(shape.vertices_m).tobytes()
    view = View(shelf.camera, look_at(6.0 * shape.radius_m * np.array([0.9, 0.4, 0.2])), np.array([1.0, 0.0, 0.0]))
    yield np.ascontiguousarray(shelf.mesh_renderer(shape).render(view)).tobytes()


_BASELINES: dict[str, str] = {}


def test_every_key_of_the_schema_is_here():
    found = set(leaves(ScenarioSpec))
    listed = set(CHANGES) | set(NO_RESULT)
    assert found == listed, f"not tested: {sorted(found - listed)}; no such key: {sorted(listed - found)}"


@pytest.mark.parametrize("key", CHANGES)
def test_changing_the_key_alone_changes_the_result(key: str, place: Path):
    text, value = CHANGES[key]
    file = place / f"base-{hashlib.sha256(text.encode()).hexdigest()[:8]}.yaml"
    file.write_text(text)
    before = _BASELINES.setdefault(text, fingerprint(file))
    assert fingerprint(file, (f"{key}={value}",)) != before


def test_the_fingerprint_itself_stands_still(place: Path):
    file = place / "still.yaml"
    file.write_text(RENDERED)
    assert fingerprint(file) == fingerprint(file)

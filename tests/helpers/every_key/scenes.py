"""Scenarios that are quick to make real, one for each group of keys, as the files that users write."""

from __future__ import annotations

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
DATA_SHEET = RENDERED.replace("fov_deg: 18.3}", "optics: {focal_mm: 20.9, pixel_um: 140}}")
LENS = RENDERED.replace("fov_deg: 18.3}", "fov_deg: 18.3, distortion: {k1: 1.5}}")
OREN_NAYAR = RENDERED + "brdf: {kind: oren-nayar}\n"
HAPKE = RENDERED + "brdf: {kind: hapke, c: 0.4}\n"
MCEWEN = RENDERED + "brdf: {kind: mcewen}\n"
OPPOSITION = HAPKE.replace("uniform: [20, 60]", "uniform: [0, 4]")
UNIFORM = RENDERED + (
    "pose_error: {position_cam_px: {uniform: [[-9, 9], [-9, 9], [-2, 2]]},"
    " attitude: {rotation_vector_deg: {uniform: [[-1, 1], [-1, 1], [-1, 1]]}}}\n"
)
ALTIMETER = RENDERED + "sensors: {altimeter: {sigma_m: 5}}\n"
BALL = RENDERED.replace("body:\n", "body:\n  shape: sphere\n")
REDRAWN = RENDERED.replace("    boulders:", "    redrawn: {below_m: 40, seed: 5}\n    boulders:")
WRONG_HEIGHTS = RENDERED.replace(
    "body:\n", "body:\n  height_error: {rms_m: 4, max_wavelength_m: 200, min_wavelength_m: 50}\n"
)
# From so far that the egg may be 600 m or 600 km long, and with so narrow a field that it is 4 pixels long at least.
SHAPE = (
    RENDERED.replace("body:\n", "body:\n  shape: egg.obj\n  unit: m\n")
    .replace("range_m: 2000", "range_m: 800000")
    .replace("fov_deg: 18.3", "fov_deg: 0.5")
)
GRID = RENDERED.replace("body:\n", "body:\n  shape: grid.tab\n  unit: m\n  format: pds-grid\n")
CRATERS = """
body: {shape: sphere}
craters:
  {count: 40, min_diameter_m: 24, max_diameter_m: 120, edge_m: 6, known_diameter_m: 30,
   roughness: {rms_m: 2, max_wavelength_m: 80, min_wavelength_m: 20}}
"""
CRATERED = (
    CRATERS
    + """\
camera: {width_px: 48, height_px: 40, fov_deg: 18.3}
lighting: {phase_deg: {uniform: [20, 60]}}
viewpoint: {range_m: 2000}
"""
)
SEEN = (
    CRATERS
    + """\
camera: {width_px: 192, height_px: 192, fov_deg: 12}
crater_pairs:
  range_m: 2000
  view_deg: {uniform: [0, 10]}
  sun_deg: {uniform: [0, 10]}
  aim_sigma_m: 5
  images: {}
"""
)
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
  asteroid: {gm_m3_s2: 5, gravity_degree: 3}
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
body: {shape: apophis-sphere, detail: {facets: 20000, albedo: {sigma: 0.35, wavelength_m: 60}}}
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

"""Scenarios that are quick to make real, one for each group of keys, and the files that they name."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import trimesh
from colmap_models import write_model
from spc_folders import SCENE as SPC
from spc_folders import write_spc
from tiny_mission import make_mission
from tiny_pairs import PAIRS
from track_tables import SCENE, make_world

RENDERED = """
body:
  detail:
    facets: 3000
    boulders: {count: 60, min_diameter_m: 15, max_diameter_m: 60}
    craters: {count: 10, min_diameter_m: 40, max_diameter_m: 120}
    roughness: {rms_m: 4, max_wavelength_m: 200, min_wavelength_m: 20}
    albedo: {sigma: 0.2, wavelength_m: 100}
camera: {width_px: 48, height_px: 40, fov_deg: 18.3}
detector: {full_well_e: 3.0e+5, psf_sigma_px: 0.6}
lighting: {phase_deg: {uniform: [20, 60]}}
viewpoint: {range_m: 2000}
"""
CRATERS = """
body: {shape: sphere}
craters:
  {count: 40, min_diameter_m: 24, max_diameter_m: 120, edge_m: 6, known_diameter_m: 30,
   roughness: {rms_m: 2, max_wavelength_m: 80, min_wavelength_m: 20}}
"""
SEQUENCE = """
camera: {width_px: 64, height_px: 64, fov_deg: 30}
sequence:
  sphere_radius_m: 190
  orbit: {step_deg: 6, revolutions: 0.2}
  vision: {landmarks_per_frame: 30}
"""
KERNELS = "[naif.tls, tiny.tsc, tiny.tf, tiny.ti, tiny.bsp, tiny.bc]"
FLIGHT = (
    "{kernels: [mission/naif.tls, mission/tiny.tf, mission/tiny.bsp], observer: HAYABUSA, target: ITOKAWA,"
    " target_frame: ITOKAWA_FIXED, start_utc: '2005-10-07T23:40:00', stop_utc: '2005-10-08T00:10:00', step_s: 600}"
)
CAMERA = """KPL/IK
\\begindata
INS-999100_FOV_FRAME = 'J2000'
INS-999100_FOV_SHAPE = 'RECTANGLE'
INS-999100_BORESIGHT = ( 0 0 1 )
INS-999100_FOV_BOUNDARY_CORNERS = ( 0.1 0.1 1 -0.1 0.1 1 -0.1 -0.1 1 0.1 -0.1 1 )
\\begintext
"""
SCENES = {
    "rendered": RENDERED,
    "data-sheet": RENDERED.replace("fov_deg: 18.3}", "optics: {focal_mm: 20.9, pixel_um: 140}}"),
    "lens": RENDERED.replace("fov_deg: 18.3}", "fov_deg: 18.3, distortion: {k1: 1.5}}"),
    "oren-nayar": RENDERED + "brdf: {kind: oren-nayar}\n",
    # At phase angles of an opposition surge.
    "hapke": RENDERED.replace("uniform: [20, 60]", "uniform: [0, 4]") + "brdf: {kind: hapke, c: 0.4}\n",
    "mcewen": RENDERED + "brdf: {kind: mcewen}\n",
    "uniform": RENDERED
    + "pose_error: {position_cam_px: {uniform: [[-9, 9], [-9, 9], [-2, 2]]},"
    + " attitude: {rotation_vector_deg: {uniform: [[-1, 1], [-1, 1], [-1, 1]]}}}\n",
    "altimeter": RENDERED + "sensors: {altimeter: {sigma_m: 5}}\n",
    "calibrated": RENDERED + "onboard: {camera_sigma: {focal: 0.0004, principal_point_px: 0.2}}\n",
    "ball": RENDERED.replace("body:\n", "body:\n  shape: sphere\n"),
    "redrawn": RENDERED.replace("    boulders:", "    redrawn: {below_m: 40, seed: 5}\n    boulders:"),
    "wrong-heights": RENDERED.replace(
        "body:\n", "body:\n  height_error: {rms_m: 4, max_wavelength_m: 200, min_wavelength_m: 50}\n"
    ),
    # From so far that the egg may be 600 m or 600 km long, in so narrow a field that it is 4 pixels long at least.
    "shape": RENDERED.replace("body:\n", "body:\n  shape: egg.obj\n  unit: m\n")
    .replace("range_m: 2000", "range_m: 800000")
    .replace("fov_deg: 18.3", "fov_deg: 0.5"),
    "states": RENDERED.replace(
        "range_m: 2000",
        "trajectory: {table: states.csv, rotation: {pole_ra_deg: 40, pole_dec_deg: 60, rate_deg_day: 700}}",
    )
    + "pose_error: {position_rtn_m: {normal: [9, 20, 5]}}\n",
    "flown": RENDERED.replace("range_m: 2000", "trajectory: {table: states.csv}").replace(
        "lighting: {phase_deg: {uniform: [20, 60]}}\n", ""
    ),
    # Exposed so long that the body is saturated and stars of magnitude 4 are seen.
    "stars": RENDERED.replace("detector: {", "detector: {exposure_s: 100, ")
    + "stars: {sun_distance_au: 20, tracker_sigma_deg: [0.1, 0.1, 0.2]}\n",
    "stars-above": RENDERED.replace("range_m: 2000", "trajectory: {table: states.csv}").replace(
        "detector: {", "detector: {exposure_s: 100, "
    )
    + "stars: {zero_point_e_per_s: 2.0e+4, rotation: {pole_ra_deg: 40, pole_dec_deg: 60, meridian_deg: 9,"
    + " rate_deg_day: 700}}\n",
    "pair": RENDERED.replace("fov_deg: 18.3", "fov_deg: 60")
    + "second_body: {body: {shape: dimorphos-like}, semi_major_axis_m: 800, inclination_deg: 30, node_deg: 50}\n",
    # Exposed so long that the camera's flight at 0.1 m/s is seen.
    "artefacts": RENDERED.replace("range_m: 2000", "trajectory: {table: states.csv}").replace(
        "detector: {",
        "detector: {exposure_s: 10, white_e_per_s: 2.0e+4, psf_wings: [{share: 0.1, sigma_px: 3}],"
        " stray_light: {veil_share: 0.1, gradient_e_per_s: 500}, cosmic_rays: {hits_per_s: 2},"
        " motion: {trajectory: true, rate_deg_s: {normal: [0.1, 0.1, 0.1]}, row_delay_s: 0.05},"
        " pixels: {response_sigma: 0.05, vignetting: 0.2, dead_share: 0.02, hot_share: 0.02},",
    ),
    "transfer": RENDERED.replace(
        "detector: {", "detector: {row_shift_s: 1.0e-4, bits: 8, gain_e_per_dn: 400, jpeg_quality: 70, "
    ),
    "above": RENDERED.replace("range_m: 2000", "altitude_m: 1700"),
    "together": RENDERED.replace("range_m: 2000", "range_m: {choice: [1800, 2500]}, off_pointing_deg: {choice: [0, 2]}")
    + "correlated: {keys: [viewpoint.range_m, viewpoint.off_pointing_deg], correlation: [[1, 0.9], [0.9, 1]]}\n",
    "passing": RENDERED.replace(
        "range_m: 2000",
        "trajectory: {flyby: {periapsis_m: 1500, v_infinity_m_s: 0.2, gm_m3_s2: 20, duration_s: 9000, step_s: 900}}",
    ),
    "hovering": RENDERED.replace(
        "range_m: 2000",
        "trajectory: {hover: {position_m: [1500, 900, 300], duration_s: 1500, step_s: 750, box_m: 80, drift_m_s: 0.1}}",
    ),
    "descending": RENDERED.replace(
        "range_m: 2000",
        "trajectory: {descent: {direction: [1, 0.5, 0.2], from_altitude_m: 1800, to_altitude_m: 1200, rate_m_s: 0.2,"
        " step_s: 1500}}",
    ),
    "site": RENDERED.replace(
        "    boulders:", "    site: {direction: [0.2, 1, 0.3], radius_m: 120, edge_m: 5}\n    boulders:"
    ),
    "local": RENDERED.replace("body:\n", "body:\n  shape: sphere\n  local: [{shape: cap.ply, blend_m: 20}]\n"),
    "mapped": RENDERED.replace("body:\n", "body:\n  albedo_map: {file: map.png, left_deg: 20, unity: 90}\n"),
    "grid": RENDERED.replace("body:\n", "body:\n  shape: grid.tab\n  unit: m\n  format: pds-grid\n"),
    "cratered": CRATERS + RENDERED[RENDERED.index("camera:") :],
    "real": """
body: {shape: sphere}
camera: {width_px: 48, height_px: 40, fov_deg: 18.3}
images: {folder: set, truth: ref, also_score: [label], noise_realisations: 2}
""",
    "moved": """
body: {shape: sphere}
camera: {width_px: 48, height_px: 40, fov_deg: 18.3}
images:
  folder: set
  truth: placed
  moved: [{name: placed, of: label, rotation_vector_deg: [0, 1, 0], origin_m: [4, 0, 0]}]
""",
    "adjusted": """
body: {shape: sphere}
camera: {width_px: 48, height_px: 40, fov_deg: 18.3}
images: {folder: set, truth: third, also_score: [label], adjusted: {name: third, table: set/more.csv}}
""",
    "sumfiles": """
body: {shape: sphere}
camera: {width_px: 48, height_px: 40, focal_px: [150, 150], principal_point_px: [24, 20]}
images: {folder: set, truth: spc, sumfiles: [{image: a.png, sumfile: a.SUM}]}
""",
    "colmap": """
body: {shape: sphere}
camera: {width_px: 48, height_px: 40, focal_px: [150, 150], principal_point_px: [24, 20]}
images: {folder: set, truth: sfm, colmap: {images: [{image: a.png, sun_body: [0, 0.6, -0.8]}]}}
""",
    "spice": f"""
body: {{shape: contact-binary}}
camera: {{width_px: 64, height_px: 64, focal_px: [629.1667, 629.1667], distortion: {{k1: -0.40859392}}}}
images:
  folder: mission
  spice: {{instrument: hayabusa-amica, target: ITOKAWA, target_frame: ITOKAWA_FIXED, kernels: {KERNELS}}}
""",
    "pairs": PAIRS,
    "seen-pairs": CRATERS
    + """
camera: {width_px: 192, height_px: 192, fov_deg: 12}
crater_pairs:
  range_m: 2000
  view_deg: {uniform: [0, 10]}
  sun_deg: {uniform: [0, 10]}
  aim_sigma_m: 5
  images: {}
""",
    # Forces, rotation, landmarks that are seen again and knowledge of all of it.
    "dynamics": """
camera: {width_px: 64, height_px: 64, fov_deg: 30}
sequence:
  sphere_radius_m: 190
  orbit: {model: propagated, forces: {area_to_mass_m2_kg: 0.02, noise_m_s2: 1.0e-7}, step_deg: 6, revolutions: 0.2}
  body_motion: {kind: spin}
  vision:
    {landmarks_per_frame: 30, field: fixed, recognised: 0.6,
     track_errors: {walk_px: 0.3, contraction: 1.0e-3, drift_px: 0.1, student_t: 5}}
  knowledge:
    {dynamics: true, velocity_sigma_m_s: 0.001, noise_m_s2: 1.0e-7, walk_px: 0.3, contraction: 1.0e-3, drift_px: 0.1}
""",
    "sequence": SEQUENCE,
    "free": SEQUENCE.replace("orbit: {step_deg: 6, revolutions: 0.2}", "trajectory: {table: states.csv}").replace(
        "frame: 30}", "frame: 30, lit_only: true}"
    ),
    # Two of three tracks have no gap; three frames of nine can be the first.
    "tracks": SCENE.replace("per_frame: 12", "per_frame: 12, frames: 7, first_frame: 1, loops: true"),
    "spc": SPC.replace("per_frame: 12", "per_frame: 12, frames: 7"),
    "tumbling": SEQUENCE + "  body_motion: {kind: tumbling, axis_body: [0.5, 0, 1]}\n",
    "egg": """
body: {shape: egg.obj, unit: m}
camera: {width_px: 64, height_px: 64, fov_deg: 30}
sequence:
  orbit: {model: propagated, step_deg: 6, revolutions: 0.2}
""",
    "images": """
body: {shape: apophis-sphere, detail: {facets: 20000, albedo: {sigma: 0.35, wavelength_m: 60}}}
camera: {width_px: 200, height_px: 200, fov_deg: 30}
sequence:
  orbit: {step_deg: 5, revolutions: 0.05}
  images: {starts: 2, tracks: 12}
""",
    "orbit": """
body: {shape: egg.obj}
camera: {width_px: 512, height_px: 400, fov_deg: 5}
orbit:
  arc: {semi_major_axis_m: 3000, days: 1, predicted_days: 0.5}
  asteroid: {gm_m3_s2: 5, gravity_degree: 3}
  light: {noise_share: 0.1}
  sightings: {images: 20, craters: 120, wrong_share: 0.2, merged_share: 0.1}
  pointing: {focal_error: 0.001}
  knowledge: {position_m: 100, shape_degree: 4}
""",
    "closing": """
body: {shape: egg.obj}
camera: {width_px: 512, height_px: 400, fov_deg: 5}
orbit:
  arc: {approach: {range_m: 50000, speed_m_s: 1, miss_m: 1500}, days: 0.5, predicted_days: 0}
  asteroid: {gm_m3_s2: 5, gravity_degree: 3}
  sightings: {images: 20, craters: 120}
  knowledge: {position_m: 100, shape_degree: 4}
""",
    "imaged": """
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
""",
    "arriving": """
body: {shape: sphere}
camera: {width_px: 48, height_px: 40, fov_deg: 2}
orbit:
  arc: {approach: {range_m: 50000, speed_m_s: 1, miss_m: 1500}, days: 0.5, predicted_days: 0}
  asteroid: {gm_m3_s2: 5, gravity_degree: 3}
  radiometry: null
  knowledge: {position_m: 100, shape_degree: 4}
  imaging: {epochs: 3}
""",
}


SUMFILE = """A
2019 MAR 14 19:01:23.961
  48 40 0 255  NPX, NLN, THRSH
  10 24.5 20.5  MMFL, CTR
  0 0 {range_km}  SCOBJ
  1 0 0  CX
  0 1 0  CY
  0 0 1  CZ
  0 0 -1  SZ
  15 0 0 0 15 0  K-MATRIX
  0 0 0 0  DISTORTION
END FILE
"""


def write_scenes(folder: Path) -> None:
    """Write the scenes, an egg of 600 m, a grid, tables of states, two image sets of two images, a mission of three."""
    for name, text in SCENES.items():
        (folder / f"{name}.yaml").write_text(text)
    trimesh.creation.icosphere(subdivisions=2, radius=200.0).apply_scale([1.5, 1.0, 0.8]).export(folder / "egg.obj")
    places = [(latitude, longitude) for latitude in range(-90, 91, 15) for longitude in range(0, 361, 15)]
    lines = [f"{lat:9.3f} {lon:9.3f} {200 + 30 * np.sin(np.radians(lon)):9.3f}" for lat, lon in places]
    (folder / "grid.tab").write_text("\n".join(lines) + "\n")
    cap = trimesh.creation.icosphere(subdivisions=4, radius=290.0)
    cap.update_faces(cap.triangles_center[:, 1] > 200.0)
    cap.export(folder / "cap.ply")
    for name, bright in (("map", 60), ("more-map", 90)):
        cv2.imwrite(str(folder / f"{name}.png"), np.linspace(bright, 120, 200, dtype=np.uint8).reshape(10, 20))
    (folder / "camera.ti").write_text(CAMERA)
    for name, height_m in (("states", 300.0), ("other", 400.0)):
        rows = [f"{600 * k},{-1500 - 90 * k},1200,{height_m},0.1,0.1,0" for k in range(3)]
        (folder / f"{name}.csv").write_text("\n".join(["time_s,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s", *rows]) + "\n")
    (folder / "stars.csv").write_text("ra_deg,dec_deg,mag\n" + "".join(f"{k},{k % 90},2\n" for k in range(360)))
    for number, name in enumerate(("set", "other")):
        _write_image_set(folder / name, np.random.default_rng(number))
    for name, radius_m in (("tracks", 790.0), ("more-tracks", 800.0)):
        world = make_world(radius_m=radius_m)
        world.sightings.to_csv(folder / f"{name}.csv", index=False)
        world.poses.to_csv(folder / ("poses.csv" if name == "tracks" else "more-poses.csv"), index=False)
        write_spc(world, folder / ("spc" if name == "tracks" else "more-spc"))
    mission = make_mission(folder / "mission")
    for number, name in enumerate(("a", "b", "c")):
        mission.write_image(name, np.random.default_rng(number).uniform(0, 100, (64, 64)), 600.0 * number)
    (mission.folder / "still.tf").write_text("KPL/PCK\n\\begindata\nBODY2025143_PM = ( 0.0 0.0 0.0 )\n\\begintext\n")


def _write_image_set(folder: Path, rng: np.random.Generator) -> None:
    folder.mkdir()
    for name in ("a.png", "b.png"):
        cv2.imwrite(str(folder / name), rng.integers(0, 255, (40, 48), dtype=np.uint8))
    for name, range_km in (("a", 2.0), ("b", 2.1)):
        (folder / f"{name}.SUM").write_text(SUMFILE.format(range_km=range_km))
    poses = {"a.png": (1, 0, 0, 0, 0, 0, 2000), "b.png": (1, 0, 0, 0, 0, 80, 2000)}
    write_model(folder, poses, (1, (150, 150, 24, 20)), (48, 40))
    for table, shift in (("poses.csv", 0.0), ("more.csv", 5.0)):
        with (folder / table).open("w", newline="") as stream:
            writer = csv.writer(stream)
            parts = ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")
            poses = [f"{prefix}_{part}" for prefix in ("ref", "label", "third") for part in parts]
            upper = [(i, j) for i in range(6) for j in range(i, 6)]
            poses += [f"{prefix}_cov_{i}{j}" for prefix in ("label", "third") for i, j in upper]
            writer.writerow(["file", "time_s", "sun_body_x", "sun_body_y", "sun_body_z", *poses])
            for time_s, name in enumerate(("a.png", "b.png")):
                numbers = [x for k in range(3) for x in (1, 0, 0, 0, k + shift, 80 * time_s, 2000)]
                numbers += 2 * [int(i == j) for i, j in upper]
                writer.writerow([name, time_s, 0, 0, -1, *numbers])

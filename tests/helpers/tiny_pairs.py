"""A scenario of pairs of looks at craters that runs in a second."""

PAIRS = """\
name: tiny-pairs
body: {shape: contact-binary}
camera: {width_px: 256, height_px: 256, fov_deg: 3}
crater_pairs:
  range_m: 4000
  view_deg: {uniform: [0, 20]}
  sun_deg: {uniform: [0, 30]}
  aim_sigma_m: 5
  craters: {count: 300, min_diameter_m: 8, max_diameter_m: 60}
  errors: {height_m: 0.3, least_radius_px: 4}
pose_error:
  position_cam_m: {normal: [2, 2, 2]}
  attitude: {rotation_vector_deg: {normal: [0.005, 0.005, 0.005]}}
"""

"""Geometry shared by all packages: frames, poses, cameras, ellipses and meshes.

Conventions:

- ``R_cam_body`` / ``T_cam_body`` take body coordinates to camera coordinates.
- Camera axes: x right, y down, z forward (the boresight).
- Pixels ``(u, v)`` = (column, row), continuous: the corner of the image is (0, 0), the centre of the
  first pixel is (0.5, 0.5). This is equation (11) of Rowell et al. (2015) and Mitsuba's film convention.
- SI units and radians; directions are unit vectors towards the named thing.
- Small rotations perturb on the left; 6-vectors are ``[rotation_rad, translation_m]``.
"""

from boresight.scenarios.geometry.camera import Camera, SurfaceHits, View, pixel_from_opencv, pixel_to_opencv
from boresight.scenarios.geometry.ellipse import Ellipses, project_circles
from boresight.scenarios.geometry.lens import OpenCVDistortion, RadialDistortion
from boresight.scenarios.geometry.mesh import TriangleMesh
from boresight.scenarios.geometry.pose import (
    Pose,
    angle_between,
    cross_matrix,
    look_at,
    orbit_axes,
    plane_axes,
    spherical_direction,
)

__all__ = [
    "Camera",
    "Ellipses",
    "OpenCVDistortion",
    "Pose",
    "RadialDistortion",
    "SurfaceHits",
    "TriangleMesh",
    "View",
    "angle_between",
    "cross_matrix",
    "look_at",
    "orbit_axes",
    "pixel_from_opencv",
    "pixel_to_opencv",
    "plane_axes",
    "project_circles",
    "spherical_direction",
]

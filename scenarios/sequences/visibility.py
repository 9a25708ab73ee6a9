"""Visibility of surface points from a camera, and the visible share of the surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from boresight.scenarios.arrays import BoolArray, FloatArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import View
from boresight.scenarios.sequences.ground import LandmarkGround, SphereGround

_PROBES = 16384  # points spread over a mesh
_PROBED_FRAMES = 36  # of an orbit, at most twice as many
_NODES = 20000  # circles about the nadir, from the limb inward
_CENTRED_PX = 1e-6  # of the body's origin from the principal point


@dataclass(frozen=True, slots=True, eq=False)
class Visibility:
    """Visibility test of points on a surface, with its occlusion.

    With ``lit_only`` points that do not face the Sun are invisible.
    """

    ground: LandmarkGround
    lit_only: bool = False

    def visible(self, points_m: FloatArray, normals: FloatArray, view: View) -> BoolArray:
        """(n,) whether points are in the field of view, not occluded and, with ``lit_only``, lit."""
        # The cheap tests first: rays are traced to points in the image alone.
        seen = view.camera.contains(view.camera.project(view.T_cam_body.transform(points_m)))
        if self.lit_only:
            seen &= normals @ view.sun_dir_body > 0.0
        rows = np.flatnonzero(seen)
        seen[rows] = self.ground.in_sight(points_m[rows], normals[rows], view.T_cam_body.camera_position_m)
        return seen

    def share(self, views: Sequence[View]) -> float:
        """Return the share of the area that is visible, as the mean over the views of an orbit.

        Raise BoresightError if nothing is visible from any of them.
        """
        some = views[:: max(1, len(views) // _PROBED_FRAMES)]
        if isinstance(self.ground, SphereGround) and all(_is_centred(view) for view in some):
            shares = [sphere_share(self.ground.radius_m, view, self.lit_only) for view in some]
        else:
            points, normals = self.ground.spread(_PROBES)
            shares = [float(self.visible(points, normals, view).mean()) for view in some]
        if not any(shares):
            raise BoresightError("sequence: the camera sees none of the body: check orbit, camera, body and lit_only")
        return float(np.mean(shares))


def _is_centred(view: View) -> bool:
    """Return whether the boresight passes through the body's origin and the principal point is in the image."""
    camera = view.camera
    centre = np.array([camera.cx_px, camera.cy_px])
    off = camera.project(view.T_cam_body.translation_m) - centre
    return bool(np.abs(off).max() < _CENTRED_PX and camera.contains(centre))


def sphere_share(radius_m: float, view: View, lit_only: bool) -> float:
    """Return the visible share of a sphere whose centre is on the boresight.

    On a circle at the angle theta from the nadir, the points in the image (and in sunlight) are arcs of the azimuth
    phi, known in closed form. Their lengths are summed over cos(theta) from the limb, at R / r, to 1.
    """
    limb = radius_m / float(np.linalg.norm(view.T_cam_body.translation_m))
    if limb >= 1.0:
        return 0.0
    # Midpoint rule in cos(theta), to which the area is proportional.
    cosine = limb + (1.0 - limb) * (np.arange(_NODES) + 0.5) / _NODES
    sine = np.sqrt(1.0 - cosine**2)
    # tan of the angle from the boresight: R sin / (r - R cos).
    slope = limb * sine / (1.0 - limb * cosine)
    arcs = _arcs_in_image(slope, view)
    centre, half = _arc_in_light(cosine, sine, view) if lit_only else (0.0, np.full(_NODES, np.pi))
    # Arcs are limits on a circle: their overlap is that of all copies a turn apart.
    turns = 2.0 * np.pi * np.arange(-2, 3)[:, None]
    length = sum(
        np.clip(np.minimum(high + turns, centre + half) - np.maximum(low + turns, centre - half), 0.0, None).sum(axis=0)
        for low, high in arcs
    )
    # The cap from the limb to the nadir has the share (1 - R / r) / 2 of the sphere.
    return float(np.mean(length) / (2.0 * np.pi) * (1.0 - limb) / 2.0)


def _arcs_in_image(slope: FloatArray, view: View) -> list[tuple[FloatArray, FloatArray]]:
    """Return the azimuth limits, by quadrant, within which a cone of this slope about the boresight is in the image."""
    camera = view.camera
    right, left = (x / (camera.fx_px * slope) for x in (camera.width_px - camera.cx_px, camera.cx_px))
    down, up = (y / (camera.fy_px * slope) for y in (camera.height_px - camera.cy_px, camera.cy_px))
    arcs = []
    for start, sign, across, along in ((0.0, 1, right, down), (np.pi, -1, left, down), (np.pi, 1, left, up)):
        arcs.append(_quadrant(start, sign, across, along))
    arcs.append(_quadrant(2.0 * np.pi, -1, right, up))
    return arcs


def _quadrant(start: float, sign: int, across: FloatArray, along: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Solve cos(psi) <= across and sin(psi) <= along for psi from 0 to 90 deg, with phi = start + sign psi."""
    nearest, farthest = np.arccos(np.minimum(across, 1.0)), np.arcsin(np.minimum(along, 1.0))
    # An empty arc rather than one of negative length.
    farthest = np.maximum(nearest, farthest)
    ends = start + sign * nearest, start + sign * farthest
    return (ends[0], ends[1]) if sign > 0 else (ends[1], ends[0])


def _arc_in_light(cosine: FloatArray, sine: FloatArray, view: View) -> tuple[float, FloatArray]:
    """Return centre and half width of the azimuth arc on which the surface is sunlit."""
    sun = view.T_cam_body.rotate(view.sun_dir_body)
    across = float(np.hypot(sun[0], sun[1]))
    with np.errstate(divide="ignore", invalid="ignore"):
        # Lit where s . n > 0: sin(theta) across cos(phi - phi_sun) > cos(theta) s_z, as the normal at the nadir is -z.
        least = np.nan_to_num(cosine * sun[2] / (sine * across), posinf=1.0, neginf=-1.0)
    return float(np.arctan2(sun[1], sun[0])), np.arccos(np.clip(least, -1.0, 1.0))

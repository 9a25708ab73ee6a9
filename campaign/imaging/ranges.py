"""Ranges of the images or tracks of a scenario, and the size of its body."""

from __future__ import annotations

import numpy as np

from boresight.scenarios.bodies import load_body
from boresight.scenarios.geometry import TriangleMesh
from boresight.scenarios.load import LoadedScenario


def ranges_m(scenario: LoadedScenario, mesh: TriangleMesh) -> tuple[float, float, float]:
    """Return the shortest, the median and the longest range of a scenario's images or tracks, m."""
    spec = scenario.spec
    if spec.viewpoint is not None:
        shortest_m, longest_m = spec.viewpoint.range_bounds_m
        if spec.viewpoint.altitude_m is not None:
            radii_m = np.linalg.norm(mesh.vertices_m, axis=1)
            shortest_m, longest_m = shortest_m + float(radii_m.min()), longest_m + float(radii_m.max())
        return shortest_m, typical_range_m(scenario), longest_m
    if spec.crater_pairs is not None:
        return (spec.crater_pairs.range_m,) * 3
    if spec.orbit is not None:
        return spec.orbit.arc.ranges_m
    ranges = _known_ranges_m(scenario)
    return float(min(ranges)), float(np.median(ranges)), float(max(ranges))


def typical_range_m(scenario: LoadedScenario) -> float:
    """Range of a scenario's views, m: the median of that of its viewpoint or sequence, or over its real images.

    To an altitude the radius of a sphere of the body's volume is added.
    """
    spec = scenario.spec
    if spec.viewpoint is not None:
        radius_m = 0.0
        if spec.viewpoint.altitude_m is not None:
            radius_m = np.cbrt(0.75 / np.pi * load_body(spec.body, scenario.search_dirs).mesh.volume_m3)
        return float(radius_m + spec.viewpoint.median_range_m)
    return float(np.median(_known_ranges_m(scenario)))


def _known_ranges_m(scenario: LoadedScenario) -> list[float]:
    """List the ranges of the frames of a sequence or of real images, m."""
    sequence = scenario.spec.sequence
    if sequence is not None and sequence.tracks is None:
        states = None if sequence.trajectory is None else sequence.trajectory.states
        return [sequence.orbit.radius_m] if states is None else list(np.linalg.norm(states.position_m, axis=1))
    # Imported here: renderers take a second to import, and most scenarios have nothing real.
    from boresight.campaign.imaging.real_images import open_images, open_tracks

    if (tracks := open_tracks(scenario)) is not None:
        return list(np.linalg.norm(tracks.states.position_m, axis=1))
    images = open_images(scenario)
    return [float(np.linalg.norm(images.view(i).T_cam_body.translation_m)) for i in range(len(images))]


def longest_m(scenario: LoadedScenario, mesh: TriangleMesh) -> float:
    """Return the longest side of a body's box, m; the diameter of an ideal sphere that a sequence has in its place."""
    sphere_m = None if scenario.spec.sequence is None else scenario.spec.sequence.sphere_radius_m
    return float(np.ptp(mesh.vertices_m, axis=0).max()) if sphere_m is None else 2.0 * sphere_m

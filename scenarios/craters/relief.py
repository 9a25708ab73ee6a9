"""The relief of a cratered surface: craters from the oldest to the youngest, and roughness."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from scenarios.bodies.detail.noise import Band
from scenarios.bodies.topology import tangent_axes
from scenarios.craters.kernels import add_crater, add_octave
from scenarios.craters.population import Craters
from scenarios.craters.profile import REACH, Profiles
from scenarios.craters.tiles import Tiling
from scenarios.spec.body import RoughnessSpec
from scenarios.spec.craters import CratersSpec

FloatArray = NDArray[np.float64]

_LATTICE = 64
_SPLINE_RMS = 0.3321
"""RMS of a cubic B-spline of white noise of variance 1: (151 / 315)^(3/2), the mean squares of its weights."""


def crater_frames(craters: Craters) -> FloatArray:
    """(n, 3, 3) axes of each crater, the last one up."""
    first, second = tangent_axes(craters.axis_body, np.zeros(len(craters)))
    return np.stack([first, second, craters.axis_body], axis=1)


def crater_relief(
    spec: CratersSpec, craters: Craters, tiling: Tiling, points_m: FloatArray, up: FloatArray
) -> FloatArray:
    """Heights (N,) along ``up`` after all impacts, over the smooth surface.

    A crater replaces what was within its rim and adds to what was outside, as in the model of Howard (2007,
    Geomorphology 91, 332) with the inheritance growing from 0, within half the radius, to 1 at the rim. What replaces
    is its bowl below the least-squares plane of the old surface about the rim; so depths hold on slopes and on the
    curved body too, and the crest lies on the old ground. Distances r are chords.
    """
    heights = np.zeros(len(points_m))
    profiles = Profiles.of(craters.degradation, craters.depth_ratio, spec.rim_ratio, spec.depth_ratio[1])
    shapes = np.stack([profiles.rim, profiles.rounding, profiles.stretch, profiles.scale], axis=1)
    middles, runs = tiling.runs
    tree = cKDTree(middles, balanced_tree=False, compact_nodes=False)
    frames = crater_frames(craters)
    for k in range(len(craters)):
        reach_m = REACH * craters.radius_m[k] + tiling.reach_m
        near = np.sort(np.asarray(tree.query_ball_point(craters.centre_m[k], reach_m), dtype=np.int64))
        add_crater(
            heights, points_m, up, runs[near], craters.centre_m[k], frames[k], float(craters.radius_m[k]), shapes[k]
        )
    return heights


def add_roughness(
    heights_m: FloatArray, points_m: FloatArray, spec: RoughnessSpec, seed: np.random.SeedSequence
) -> None:
    """Add a band-limited random field to heights (N,): octaves of cubic splines of white noise on lattices."""
    band = Band(spec.max_wavelength_m, spec.min_wavelength_m, spec.hurst)
    octaves = zip(band.wavelengths_m, band.amplitudes, seed.spawn(len(band.wavelengths_m)), strict=True)
    for wavelength_m, amplitude, stream in octaves:
        rng = np.random.default_rng(stream)
        lattice = rng.standard_normal((_LATTICE,) * 3, dtype=np.float32)
        steps_per_m = 2.0 / wavelength_m
        turn, shift = Rotation.random(rng=rng).as_matrix() * steps_per_m, rng.uniform(0.0, _LATTICE, 3)
        add_octave(heights_m, points_m, lattice, turn, shift, float(spec.rms_m * amplitude / _SPLINE_RMS))

"""Band-limited random fields in space: sums of octaves of smooth lattice noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boresight.scenarios.arrays import FloatArray

_LATTICE = 96  # random values along each side of a periodic lattice


@dataclass(frozen=True, slots=True)
class SmallScaleSeed:
    """Separate random seed for the features of one kind that are smaller than ``below_m``."""

    below_m: float
    seed: np.random.SeedSequence


@dataclass(frozen=True, slots=True)
class Band:
    """Octaves of wavelength from ``longest_m`` to ``shortest_m``, each at least half as long as the previous one.

    Their amplitudes are proportional to wavelength**hurst.
    """

    longest_m: float
    shortest_m: float
    hurst: float

    @property
    def wavelengths_m(self) -> FloatArray:
        """The octaves, longest first."""
        # 1e-9: a band of whole octaves must not get another one by rounding.
        count = 1 + int(np.ceil(np.log2(self.longest_m / self.shortest_m) - 1e-9))
        return np.geomspace(self.longest_m, self.shortest_m, count, dtype=np.float64)

    @property
    def amplitudes(self) -> FloatArray:
        """RMS of each octave; their squares add up to 1."""
        amplitude = self.wavelengths_m**self.hurst
        return amplitude / np.linalg.norm(amplitude)


def fractal_field(
    points_m: FloatArray,
    band: Band,
    resolution_m: float,
    seed: np.random.SeedSequence,
    small: SmallScaleSeed | None = None,
    even: int | None = None,
) -> tuple[FloatArray, int]:
    """Sum the octaves of a band at points (N, 3): a field (N,) of mean 0, and the number of octaves left out.

    Octaves shorter than ``resolution_m`` cannot be resolved by the mesh and are left out; with all of them the RMS is
    1. Each octave has its own random stream, so that the long ones depend on the number of facets by their
    normalisation over the points alone. That is over the first ``even`` points, by default all: further ones may crowd
    at a place. Octaves shorter than ``small.below_m`` are drawn from ``small.seed``.
    """
    field = np.zeros(len(points_m))
    omitted = 0
    variance = 0.0
    octaves = zip(band.wavelengths_m, band.amplitudes, _streams(band, seed, small), strict=True)
    for wavelength_m, amplitude, stream in octaves:
        if wavelength_m < resolution_m:
            omitted += 1
            continue
        # Two lattice steps make the shortest wave of a lattice.
        octave = _lattice_noise(points_m * (2.0 / wavelength_m), np.random.default_rng(stream))
        # Normalised over the surface: a lattice much coarser than the body has few independent values on it.
        field += amplitude * (octave - octave[:even].mean()) / octave[:even].std()
        variance += amplitude**2
    # The octaves that are left keep their share of the variance of the whole band.
    return (field * np.sqrt(variance) / field[:even].std() if variance else field), omitted


def _streams(band: Band, seed: np.random.SeedSequence, small: SmallScaleSeed | None) -> list[np.random.SeedSequence]:
    streams = seed.spawn(len(band.wavelengths_m))
    if small is None:
        return streams
    others = small.seed.spawn(len(streams))
    own = band.wavelengths_m >= small.below_m
    return [mine if kept else other for mine, other, kept in zip(streams, others, own, strict=True)]


def _lattice_noise(points: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Evaluate a cubic B-spline of random values at points (N, 3) in lattice steps; its period is 96 steps.

    Each octave is rotated and shifted at random, so that the periods of different octaves do not coincide.
    """
    lattice = rng.standard_normal((_LATTICE,) * 3, dtype=np.float32)
    # Imported here: scipy takes 0.4 s, which commands that read coarse shapes do without.
    from scipy.ndimage import map_coordinates
    from scipy.spatial.transform import Rotation

    turn = Rotation.random(rng=rng).as_matrix()
    # einsum and not BLAS: its sums do not depend on the number of threads.
    coordinates = np.einsum("ij,nj->in", turn, points) + rng.uniform(0.0, _LATTICE, (3, 1))
    return map_coordinates(lattice, coordinates, order=3, mode="grid-wrap", prefilter=False, output=np.float64)

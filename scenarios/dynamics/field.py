"""Acceleration about a rotating body by spherical harmonics and solar radiation pressure, with partial derivatives."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.dynamics import inner, kernel
from boresight.scenarios.dynamics.gravity import (
    Harmonics,
    HarmonicTable,
    derivative,
    normalisation,
    outer_harmonics,
    term_count,
    term_index,
)

_TIDE_DEGREE = 4
"""Degree of the potential in the gravity gradient of the variational equations; truncation changes it by 1e-8 at
200 km about Eros."""

_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2))
"""Axes of the five second derivatives that are stored; the sixth follows from Laplace's equation."""


@dataclass(frozen=True, eq=False)
class UniformRotation:
    """Uniform rotation of a body about its z axis, fixed in inertial space, from its attitude at the epoch, time 0."""

    R_body_inertial: FloatArray
    rate_rad_s: float

    def at(self, times_s: FloatArray) -> FloatArray:
        """(n, 3, 3) R_body_inertial at (n,) seconds after the epoch."""
        angles = self.rate_rad_s * np.asarray(times_s, dtype=np.float64)
        turns = np.zeros((len(angles), 3, 3))
        turns[:, 0, 0] = turns[:, 1, 1] = np.cos(angles)
        # Coordinates in axes that rotate by +angle about z: the transpose of a rotation of vectors.
        turns[:, 0, 1] = np.sin(angles)
        turns[:, 1, 0] = -np.sin(angles)
        turns[:, 2, 2] = 1.0
        return np.asarray(turns @ self.R_body_inertial, dtype=np.float64)

    def changed(self, across_rad: FloatArray, rate_ratio: float) -> UniformRotation:
        """Return the rotation with its pole turned by (2,) rad about the body's x and y axes, and another rate."""
        # Left of R_body_inertial: about body axes.
        tilt = Rotation.from_rotvec([*across_rad, 0.0]).as_matrix()
        return UniformRotation(tilt @ self.R_body_inertial, rate_ratio * self.rate_rad_s)


class FlatField(NamedTuple):
    """A force field as arrays for the kernels; tables of V and W have the shape (2, terms, ...).

    ``pull`` (2, t1, 3) and ``tide`` (2, t2, 5) are first and second derivatives of the potential, the latter to a lower
    degree; ``parts`` (2, t3, 3 K) are the accelerations by each estimated coefficient. All are in units of
    ``unit`` = GM / R^2.
    """

    unit: float
    radius_m: float
    pull: FloatArray
    tide: FloatArray
    parts: FloatArray
    R_body_inertial: FloatArray
    rate_rad_s: float
    light_m_s2: FloatArray


@dataclass(frozen=True, eq=False)
class HarmonicField:
    """Acceleration about the body's centre of mass, inertial axes, by its gravity about that and its rotation.

    ``light_m_s2`` (3,) is the constant acceleration by solar radiation pressure. ``by_degree`` is the highest degree of
    the coefficients of which partial derivatives are computed (from 2 on); 0 for none.
    """

    harmonics: Harmonics
    rotation: UniformRotation
    light_m_s2: FloatArray
    by_degree: int = 0

    @cached_property
    def coefficients(self) -> tuple[tuple[str, int, int], ...]:
        """Coefficients of the partial derivatives: ("c" or "s", degree, order)."""
        return tuple(
            (name, n, m)
            for n in range(2, self.by_degree + 1)
            for name in ("c", "s")
            for m in range(0 if name == "c" else 1, n + 1)
        )

    @property
    def parameters(self) -> int:
        """Number of parameters: ratio of GM, factor on solar pressure, coefficients."""
        return 2 + len(self.coefficients)

    def changed(self, gm_ratio: float, light_factor: float, coefficients: FloatArray) -> HarmonicField:
        """Return the field with scaled GM and solar pressure, and with additions to the normalised coefficients."""
        # Coefficients of higher degrees than the a priori field's may be estimated: they start at 0.
        size = max(self.by_degree, self.harmonics.degree) + 1
        c, s = np.zeros((2, size, size))
        kept = self.harmonics.degree + 1
        c[:kept, :kept], s[:kept, :kept] = self.harmonics.c, self.harmonics.s
        for (name, n, m), added in zip(self.coefficients, coefficients, strict=True):
            (c if name == "c" else s)[n, m] += added
        harmonics = Harmonics(self.harmonics.gm_m3_s2 * gm_ratio, self.harmonics.radius_m, c, s)
        return replace(self, harmonics=harmonics, light_m_s2=self.light_m_s2 * light_factor)

    @cached_property
    def flat(self) -> FlatField:
        """The field as arrays for the kernels."""
        potential = self.harmonics.flat
        pull = [derivative(potential, axis) for axis in range(3)]
        # The gradient serves the variational equations alone, for which a lower degree suffices.
        whole, few = self.harmonics, _TIDE_DEGREE + 1
        coarse = Harmonics(whole.gm_m3_s2, whole.radius_m, whole.c[:few, :few], whole.s[:few, :few]).flat
        slopes = [derivative(coarse, axis) for axis in range(2)]
        return FlatField(
            self.harmonics.gm_m3_s2 / self.harmonics.radius_m**2,
            self.harmonics.radius_m,
            _stacked(pull),
            _stacked([derivative(slopes[i], j) for i, j in _PAIRS]),
            _parts(self.coefficients, self.by_degree),
            np.ascontiguousarray(self.rotation.R_body_inertial, dtype=np.float64),
            float(self.rotation.rate_rad_s),
            np.array(self.light_m_s2, dtype=np.float64),
        )

    @cached_property
    def work(self) -> FloatArray:
        """The work array of `accelerate` and `differentiate`."""
        # Long enough for V and W of the highest degree of the three tables.
        return np.empty((2, max(self.flat.pull.shape[1], self.flat.tide.shape[1], self.flat.parts.shape[1])))

    def acceleration(self, time_s: float, position_m: FloatArray) -> FloatArray:
        """(3,) m/s2 at a position (3,) in inertial axes."""
        out = np.empty(3)
        accelerate(self.flat, time_s, np.ascontiguousarray(position_m, dtype=np.float64), self.work, out)
        return out


@lru_cache(maxsize=8)
def _parts(coefficients: tuple[tuple[str, int, int], ...], degree: int) -> FloatArray:
    """Return the accelerations by normalised coefficients, read-only: the same for all bodies."""
    scale, found = normalisation(degree), []
    for name, n, m in coefficients:
        table: HarmonicTable = (np.zeros(term_count(degree)), np.zeros(term_count(degree)))
        # One normalised coefficient of 1 is 1 / N of the unnormalised function.
        table["cs".index(name)][term_index(n, m)] = 1.0 / scale[term_index(n, m)]
        found += [derivative(table, axis) for axis in range(3)]
    parts = _stacked(found) if found else np.zeros((2, 1, 0))
    parts.setflags(write=False)
    return parts


def _stacked(tables: list[HarmonicTable]) -> FloatArray:
    return np.ascontiguousarray(np.stack([np.stack(part, axis=1) for part in zip(*tables, strict=True)]))


@inner
def body_attitude(field: FlatField, time: float) -> FloatArray:
    """Return R_body_inertial, (3, 3), at a time."""
    angle = field.rate_rad_s * time
    c, s = np.cos(angle), np.sin(angle)
    # A rotation about body z mixes the first two rows of the attitude at the epoch.
    R, out = field.R_body_inertial, np.empty((3, 3))
    for j in range(3):
        out[0, j] = c * R[0, j] + s * R[1, j]
        out[1, j] = c * R[1, j] - s * R[0, j]
        out[2, j] = R[2, j]
    return out


@kernel
def accelerate(field: FlatField, time: float, position: FloatArray, work: FloatArray, out: FloatArray) -> None:
    """Write the acceleration, m/s2, inertial axes, to ``out`` (3,); ``work`` is (2, terms) of the pull's degree."""
    R = body_attitude(field, time)
    x = R[0, 0] * position[0] + R[0, 1] * position[1] + R[0, 2] * position[2]
    y = R[1, 0] * position[0] + R[1, 1] * position[1] + R[1, 2] * position[2]
    z = R[2, 0] * position[0] + R[2, 1] * position[1] + R[2, 2] * position[2]
    outer_harmonics(x, y, z, field.radius_m, work[0], work[1])
    in_body = np.empty(3)
    # Equation (3.32) of Montenbruck and Gill.
    _sum(field.pull, work, field.unit, in_body)
    for j in range(3):
        # Back to inertial axes with the transpose; sunlight is constant there.
        out[j] = R[0, j] * in_body[0] + R[1, j] * in_body[1] + R[2, j] * in_body[2] + field.light_m_s2[j]


@kernel
def differentiate(
    field: FlatField, time: float, position: FloatArray, work: FloatArray, tide: FloatArray, by_parameters: FloatArray
) -> None:
    """Write partial derivatives of the acceleration to ``tide`` (3, 3) and ``by_parameters`` (3, 2 + K).

    ``tide`` is by the position; ``by_parameters`` by the ratio of GM, the factor on solar pressure and the
    coefficients. ``work`` is (2, terms) of the higher degree of pull and tide.
    """
    R = body_attitude(field, time)
    x = R[0, 0] * position[0] + R[0, 1] * position[1] + R[0, 2] * position[2]
    y = R[1, 0] * position[0] + R[1, 1] * position[1] + R[1, 2] * position[2]
    z = R[2, 0] * position[0] + R[2, 1] * position[1] + R[2, 2] * position[2]
    outer_harmonics(x, y, z, field.radius_m, work[0], work[1])
    second = np.empty(5)
    # A second derivative has one more factor 1 / R.
    _sum(field.tide, work, field.unit / field.radius_m, second)
    body = np.empty((3, 3))
    # xx, xy, xz, yy, yz; outside the body the trace is 0 (Laplace), so that zz = -xx - yy.
    body[0, 0], body[0, 1], body[0, 2] = second[0], second[1], second[2]
    body[1, 0], body[1, 1], body[1, 2] = second[1], second[3], second[4]
    body[2, 0], body[2, 1], body[2, 2] = second[2], second[4], -second[0] - second[3]
    for i in range(3):
        for j in range(3):
            total = 0.0
            for a in range(3):
                for b in range(3):
                    # R^T G R: the tensor in inertial axes.
                    total += R[a, i] * body[a, b] * R[b, j]
            tide[i, j] = total
    count = field.parts.shape[2] // 3
    # Gravity as a whole is the derivative by the ratio of GM; then the coefficients.
    in_body = np.empty(3 + 3 * count)
    _sum(field.pull, work, field.unit, in_body[:3])
    _sum(field.parts, work, field.unit, in_body[3:])
    for k in range(1 + count):
        column = 0 if k == 0 else 1 + k
        own = in_body[3 * k : 3 * k + 3]
        for j in range(3):
            by_parameters[j, column] = R[0, j] * own[0] + R[1, j] * own[1] + R[2, j] * own[2]
    for j in range(3):
        # The acceleration is proportional to the factor on solar pressure.
        by_parameters[j, 1] = field.light_m_s2[j]


@inner
def _sum(table: FloatArray, work: FloatArray, unit: float, out: FloatArray) -> None:
    """Write ``unit`` times the sums of the products of a table (2, terms, n) with V and W to ``out`` (n,)."""
    out[:] = 0.0
    # Tables are in the order of the degree: one of a lower degree uses the first terms of V and W.
    for k in range(table.shape[1]):
        v, w = work[0, k], work[1, k]
        for i in range(len(out)):
            out[i] += table[0, k, i] * v + table[1, k, i] * w
    for i in range(len(out)):
        out[i] *= unit

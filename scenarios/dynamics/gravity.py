"""Gravity of a point mass, of a homogeneous polyhedron, and by spherical harmonics: those of a homogeneous mesh too.

The solid harmonics are in Cartesian coordinates (Cunningham 1970) and not normalised. Outside a body they are
``V_nm + i W_nm = (R / r)^(n+1) P_nm(sin phi) e^(i m lambda)``, after equations (3.29) to (3.33) of Montenbruck and Gill
(2000), Satellite Orbits. A derivative of a sum of V and W is another such sum of one degree more; `derivative` computes
its coefficients.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import factorial
from typing import TypeVar

import numpy as np

from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.dynamics import kernel
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry.mesh import TriangleMesh, solid_angles


@dataclass(frozen=True, slots=True)
class PointMass:
    """A point mass at the origin."""

    gm_m3_s2: float

    def acceleration(self, position_m: FloatArray) -> FloatArray:
        """-GM r / r^3: the first term of equation (6) of Delpech et al. (2015), which is printed without its sign."""
        return np.asarray(-self.gm_m3_s2 * position_m / np.linalg.norm(position_m) ** 3, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Polyhedron:
    """A closed mesh of constant density, after Werner and Scheeres (1997), Celest. Mech. Dyn. Astron. 65, 313.

    Their sums over edges are evaluated facet by facet: an edge's dyad is the sum of its two facets' terms,
    ``E_e = n_A (m_A)^T + n_B (m_B)^T`` with m the normal of the edge in the plane of the facet, so that

    ``a = (G sigma) sum_f n_f [(n_f . r_f) omega_f - sum_(e of f) (m_fe . r_e) L_e]``,

    r from the field point to a point of the facet or edge. G sigma is GM over the volume. The formula holds inside the
    body as well, but not on an edge.
    """

    mesh: TriangleMesh
    gm_m3_s2: float

    def acceleration(self, position_m: FloatArray) -> FloatArray:
        """(3,) m/s2 at a position (3,) m in the mesh's axes."""
        corners = self._corners_m - position_m
        distances = np.sqrt(np.einsum("fki,fki->fk", corners, corners))
        # (n_f . r_f) omega_f: r_f may be any corner, as all have the same distance from the facet's plane.
        flux = np.einsum("fi,fi->f", self.mesh.normals, corners[:, 0]) * solid_angles(corners, distances)
        # (m_fe . r_e) L_e of the three edges, L_e = ln((a + b + e) / (a + b - e)) the potential of a wire along an edge
        # of length e with distances a and b of its ends; both facets of an edge have the same L_e.
        both = distances + np.roll(distances, -1, axis=1)
        logs = np.log((both + self._lengths_m) / (both - self._lengths_m))
        edges = np.einsum("fki,fki->fk", self._edge_normals, corners) * logs
        return np.asarray((flux - edges.sum(axis=1)) @ self.mesh.normals * self._g_sigma, dtype=np.float64)

    def laplacian(self, position_m: FloatArray) -> float:
        """Divergence of the acceleration, 1/s2: -4 pi G sigma inside and 0 outside."""
        corners = self._corners_m - position_m
        return float(-self._g_sigma * solid_angles(corners, np.linalg.norm(corners, axis=2)).sum())

    @cached_property
    def _g_sigma(self) -> float:
        return self.gm_m3_s2 / self.mesh.volume_m3

    @cached_property
    def _corners_m(self) -> FloatArray:
        return self.mesh.corners_m

    @cached_property
    def _edges_m(self) -> FloatArray:
        """(F, 3, 3) edge vectors of each facet, from corner k to the next one."""
        return np.roll(self._corners_m, -1, axis=1) - self._corners_m

    @cached_property
    def _lengths_m(self) -> FloatArray:
        lengths: FloatArray = np.linalg.norm(self._edges_m, axis=2)
        return lengths

    @cached_property
    def _edge_normals(self) -> FloatArray:
        """(F, 3, 3) unit vectors in the plane of the facet, perpendicular to each edge and pointing outward."""
        # Edge times normal points away from a counter-clockwise facet.
        across = np.cross(self._edges_m, self.mesh.normals[:, None])
        out: FloatArray = np.divide(
            across, self._lengths_m[..., None], out=np.zeros_like(across), where=self._lengths_m[..., None] > 0.0
        )
        return out


_PLACES_AT_ONCE = 1 << 19

_Index = TypeVar("_Index", int, IndexArray)
HarmonicTable = tuple[FloatArray, FloatArray]
"""Coefficients of V and of W, (terms,) each, in the order of `term_index`."""


def term_count(degree: int) -> int:
    """Return the number of pairs (n, m) up to a degree."""
    return (degree + 1) * (degree + 2) // 2


def term_index(n: _Index, m: _Index) -> _Index:
    """Return the index of the term of degree n and order m."""
    return n * (n + 1) // 2 + m


def solid_harmonics(points: FloatArray, degree: int) -> tuple[FloatArray, FloatArray]:
    """Return ``r^n P_nm(sin phi)`` times cos and sin of ``m lambda``, (terms, k) each, at points (k, 3)."""
    x, y, z = points.T
    squares = x * x + y * y + z * z
    c, s = np.zeros((2, term_count(degree), len(points)))
    c[0] = 1.0
    for m in range(degree + 1):
        if m:
            before, here = term_index(m - 1, m - 1), term_index(m, m)
            # (x + i y)^m times (2 m - 1)!!, without the sign (-1)^m of Condon and Shortley, as in geodesy.
            c[here] = (2 * m - 1) * (x * c[before] - y * s[before])
            s[here] = (2 * m - 1) * (x * s[before] + y * c[before])
        for n in range(m + 1, degree + 1):
            below, here = term_index(n - 1, m), term_index(n, m)
            for part in (c, s):
                # (n - m) R_nm = (2 n - 1) z R_(n-1)m - (n + m - 1) r^2 R_(n-2)m; the last term is 0 for n = m + 1.
                part[here] = (2 * n - 1) * z * part[below]
                if n > m + 1:
                    part[here] -= (n + m - 1) * squares * part[term_index(n - 2, m)]
                part[here] /= n - m
    return c, s


@kernel
def outer_harmonics(x: float, y: float, z: float, radius: float, v: FloatArray, w: FloatArray) -> None:
    """Write V and W at a point to ``v`` and ``w``, (terms,) of any degree: equations (3.29) to (3.31)."""
    squares = x * x + y * y + z * z
    # Inverts terms = (degree + 1)(degree + 2) / 2; the 0.5 guards against rounding.
    degree = int((np.sqrt(8.0 * len(v) + 1.0) - 3.0) / 2.0 + 0.5)
    a, b, c, rho = radius * x / squares, radius * y / squares, radius * z / squares, radius * radius / squares
    v[0], w[0] = radius / np.sqrt(squares), 0.0  # eq. (3.31)
    for m in range(degree + 1):
        here = m * (m + 1) // 2 + m
        if m > 0:
            before = here - m - 1
            v[here] = (2 * m - 1) * (a * v[before] - b * w[before])  # eq. (3.29)
            w[here] = (2 * m - 1) * (a * w[before] + b * v[before])
        for n in range(m + 1, degree + 1):
            k, below, lower = n * (n + 1) // 2 + m, n * (n - 1) // 2 + m, (n - 1) * (n - 2) // 2 + m
            # Equation (3.30).
            first = (2 * n - 1) / (n - m)
            v[k], w[k] = first * c * v[below], first * c * w[below]
            if n > m + 1:
                second = (n + m - 1) / (n - m) * rho
                v[k] -= second * v[lower]
                w[k] -= second * w[lower]


def derivative(table: HarmonicTable, axis: int) -> HarmonicTable:
    """Differentiate a sum of V and W by x, y or z (0, 1, 2), in units of 1 / R; the degree increases by one."""
    # Equation (3.33): the derivatives of V_nm and of W_nm, each with its own factor.
    degree = int((np.sqrt(8.0 * len(table[0]) + 1.0) - 3.0) / 2.0 + 0.5)
    c, s = np.zeros((2, term_count(degree + 1)))
    (n, m), (of_v, of_w) = np.tril_indices(degree + 1), table
    if axis == 2:
        k = term_index(n + 1, m)
        c[k], s[k] = -(n - m + 1) * of_v, -(n - m + 1) * of_w
        return c, s
    # Order 0 has no W, and no neighbour of order -1.
    low, half, of_w = m > 0, np.where(m > 0, 0.5, 1.0), np.where(m > 0, of_w, 0.0)
    up, down = term_index(n + 1, m + 1), term_index(n + 1, m - 1)[low]
    # (n - m + 2)! / (n - m)! = (n - m + 2)(n - m + 1).
    fall = (0.5 * (n - m + 2) * (n - m + 1))[low]
    to_v, to_w = (c, s) if axis == 0 else (s, c)
    sign = 1.0 if axis == 0 else -1.0
    to_v[up] -= half * of_v
    to_w[up] -= sign * half * of_w
    to_v[down] += sign * fall * of_v[low]
    to_w[down] += fall * of_w[low]
    return c, s


@dataclass(frozen=True, eq=False)
class Harmonics:
    """The potential ``U = GM / r sum_nm (R / r)^n P_nm(sin phi) (C_nm cos m lambda + S_nm sin m lambda)``, body axes.

    ``c`` and ``s`` (N + 1, N + 1) are fully normalised coefficients (geodesy's: mean square 1 on the sphere) by degree
    and order; zero above the diagonal. C_00 is 1. ``radius_m`` is R.
    """

    gm_m3_s2: float
    radius_m: float
    c: FloatArray
    s: FloatArray

    def __post_init__(self) -> None:
        if self.c.shape != self.s.shape or self.c.ndim != 2 or self.c.shape[0] != self.c.shape[1]:
            raise BoresightError(
                f"harmonics need two square tables of coefficients, not {self.c.shape} and {self.s.shape}"
            )
        if not (np.isfinite(self.c).all() and np.isfinite(self.s).all() and self.gm_m3_s2 > 0.0 < self.radius_m):
            raise BoresightError("harmonics need finite coefficients, a positive gm_m3_s2 and a positive radius_m")

    @classmethod
    def point(cls, gm_m3_s2: float, radius_m: float = 1.0) -> Harmonics:
        """Make the harmonics of a point mass at the origin."""
        return cls(gm_m3_s2, radius_m, np.ones((1, 1)), np.zeros((1, 1)))

    @property
    def degree(self) -> int:
        """The highest degree N."""
        return len(self.c) - 1

    @cached_property
    def flat(self) -> tuple[FloatArray, FloatArray]:
        """Return (terms,) coefficients of the unnormalised functions, cosines and sines, ordered by `term_index`."""
        scale = normalisation(self.degree)
        rows, columns = np.tril_indices(self.degree + 1)
        return self.c[rows, columns] / scale, self.s[rows, columns] / scale


def normalisation(degree: int) -> FloatArray:
    """(terms,) factors ``N``, ordered by `term_index`: a normalised coefficient is ``N`` times the unnormalised one.

    ``1 / N^2 = (2 - delta_0m) (2 n + 1) (n - m)! / (n + m)!``.
    """
    return np.array(
        [
            np.sqrt(factorial(n + m) / ((1 if m == 0 else 2) * (2 * n + 1) * factorial(n - m)))
            for n in range(degree + 1)
            for m in range(n + 1)
        ]
    )


def homogeneous_harmonics(mesh: TriangleMesh, gm_m3_s2: float, degree: int, radius_m: float) -> Harmonics:
    """Return the harmonics of a homogeneous closed mesh about the origin of its axes, exact except for rounding.

    A solid harmonic is a homogeneous polynomial of its degree. Over the tetrahedron between the origin and a facet it
    integrates to ``3 V / (n + 3)`` times its mean over the facet, which a Gauss rule of sufficient order gives exactly.
    """
    corners = mesh.corners_m / radius_m
    volumes = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
    weights, barycentric = _triangle_rule(degree)
    total = np.zeros((2, term_count(degree)))
    share = max(1, _PLACES_AT_ONCE // len(weights))
    for start in range(0, len(volumes), share):
        some = slice(start, start + share)
        places = np.einsum("ka,fai->fki", barycentric, corners[some]).reshape(-1, 3)
        heavy = (volumes[some, None] * weights).ravel()
        total += np.stack([part @ heavy for part in solid_harmonics(places, degree)])
    scale, c, s = normalisation(degree), *np.zeros((2, degree + 1, degree + 1))
    for n in range(degree + 1):
        for m in range(n + 1):
            # C_nm = (2 - delta_0m) (n - m)! / (n + m)! of the mean of r^n P_nm cos(m lambda) over the mass.
            k = term_index(n, m)
            # That is 1 / (N^2 (2 n + 1)) of the mean, and N times it when normalised.
            factor = 3.0 / (n + 3) / (volumes.sum() * scale[k] * (2 * n + 1))
            c[n, m], s[n, m] = factor * total[0, k], factor * total[1, k]
    return Harmonics(gm_m3_s2, radius_m, c, s)


def _triangle_rule(degree: int) -> tuple[FloatArray, FloatArray]:
    """Weights (K,) of sum 1 and barycentric nodes (K, 3): a Gauss rule on the square, mapped to the triangle."""
    # The square (u, v) is mapped to the triangle (u, v (1 - u)); the Jacobian 1 - u requires one degree more in u.
    u, w_u = _unit_rule(degree // 2 + 2)
    v, w_v = _unit_rule(degree // 2 + 1)
    first, second = np.repeat(u, len(v)), np.outer(1.0 - u, v).ravel()
    weights = 2.0 * np.outer(w_u * (1.0 - u), w_v).ravel()
    return weights, np.column_stack([1.0 - first - second, first, second])


def _unit_rule(places: int) -> tuple[FloatArray, FloatArray]:
    """Nodes and weights of the Gauss-Legendre rule on [0, 1]."""
    nodes, weights = np.polynomial.legendre.leggauss(places)
    return 0.5 * (nodes + 1.0), 0.5 * weights

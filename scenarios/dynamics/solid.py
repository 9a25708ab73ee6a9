"""Solid harmonics in Cartesian coordinates (Cunningham 1970), and their derivatives as tables of coefficients.

The functions are not normalised. Outside a body they are
``V_nm + i W_nm = (R / r)^(n+1) P_nm(sin phi) e^(i m lambda)``, after equations (3.29) to (3.33) of Montenbruck and Gill
(2000), Satellite Orbits, where derivatives raise the degree by one: a derivative of a sum of V and W is another such
sum, whose coefficients `derivative` works out once and for all.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenarios.dynamics import kernel

FloatArray = NDArray[np.float64]
Table = tuple[FloatArray, FloatArray]
"""Coefficients of V and of W, (terms,) each, in the order of `index`."""


def terms(degree: int) -> int:
    """Count the pairs (n, m) up to a degree."""
    return (degree + 1) * (degree + 2) // 2


def index(n: int, m: int) -> int:
    """Return where the term of degree n and order m stands."""
    return n * (n + 1) // 2 + m


def solid_harmonics(points: FloatArray, degree: int) -> tuple[FloatArray, FloatArray]:
    """Return ``r^n P_nm(sin phi)`` times cos and sin of ``m lambda``, (terms, k) each, at points (k, 3)."""
    x, y, z = points.T
    squares = x * x + y * y + z * z
    c, s = np.zeros((2, terms(degree), len(points)))
    c[0] = 1.0
    for m in range(degree + 1):
        if m:
            before, here = index(m - 1, m - 1), index(m, m)
            c[here] = (2 * m - 1) * (x * c[before] - y * s[before])
            s[here] = (2 * m - 1) * (x * s[before] + y * c[before])
        for n in range(m + 1, degree + 1):
            below, here = index(n - 1, m), index(n, m)
            for part in (c, s):
                part[here] = (2 * n - 1) * z * part[below]
                if n > m + 1:
                    part[here] -= (n + m - 1) * squares * part[index(n - 2, m)]
                part[here] /= n - m
    return c, s


@kernel
def outer_harmonics(x: float, y: float, z: float, radius: float, v: FloatArray, w: FloatArray) -> None:
    """Fill ``v`` and ``w``, (terms,) of any degree, with V and W at a point: equations (3.29) to (3.31)."""
    squares = x * x + y * y + z * z
    degree = int((np.sqrt(8.0 * len(v) + 1.0) - 3.0) / 2.0 + 0.5)
    a, b, c, rho = radius * x / squares, radius * y / squares, radius * z / squares, radius * radius / squares
    v[0], w[0] = radius / np.sqrt(squares), 0.0
    for m in range(degree + 1):
        here = m * (m + 1) // 2 + m
        if m > 0:
            before = here - m - 1
            v[here] = (2 * m - 1) * (a * v[before] - b * w[before])
            w[here] = (2 * m - 1) * (a * w[before] + b * v[before])
        for n in range(m + 1, degree + 1):
            k, below, lower = n * (n + 1) // 2 + m, n * (n - 1) // 2 + m, (n - 1) * (n - 2) // 2 + m
            first = (2 * n - 1) / (n - m)
            v[k], w[k] = first * c * v[below], first * c * w[below]
            if n > m + 1:
                second = (n + m - 1) / (n - m) * rho
                v[k] -= second * v[lower]
                w[k] -= second * w[lower]


def derivative(table: Table, axis: int) -> Table:
    """Differentiate a sum of V and W by x, y or z (0, 1, 2), in units of 1 / R: one degree more."""
    degree = int((np.sqrt(8.0 * len(table[0]) + 1.0) - 3.0) / 2.0 + 0.5)
    c, s = np.zeros((2, terms(degree + 1)))
    for n in range(degree + 1):
        for m in range(n + 1):
            _add_derivative(c, s, (n, m), (table[0][index(n, m)], table[1][index(n, m)]), axis)
    return c, s


def _add_derivative(c: FloatArray, s: FloatArray, term: tuple[int, int], value: tuple[float, float], axis: int) -> None:
    """Add the derivative of ``value[0] V_nm + value[1] W_nm`` to a table."""
    (n, m), (of_v, of_w) = term, value
    if axis == 2:
        k = index(n + 1, m)
        c[k] -= (n - m + 1) * of_v
        s[k] -= (n - m + 1) * of_w
        return
    up, down = index(n + 1, m + 1), index(n + 1, max(m - 1, 0))
    if m == 0:
        (c if axis == 0 else s)[up] -= of_v
        return
    half, fall = 0.5, 0.5 * (n - m + 2) * (n - m + 1)
    if axis == 0:
        c[up] -= half * of_v
        s[up] -= half * of_w
        c[down] += fall * of_v
        s[down] += fall * of_w
    else:
        s[up] -= half * of_v
        c[up] += half * of_w
        s[down] -= fall * of_v
        c[down] += fall * of_w

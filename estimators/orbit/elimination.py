"""Kernels that eliminate landmarks from the normal equations (Schur complement)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimators.orbit.rays import kernel

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


@kernel
def whitened(
    begin: IndexArray, by_point: FloatArray, by_image: FloatArray, residuals: FloatArray, damping: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return ``L`` (L, 3, 3), ``L^-1 b`` (L, 3) and ``H' P L^-T`` (K, 7, 3) of each landmark and sighting.

    ``C = L L'`` is the normal matrix of a landmark, b its gradient. Sightings stand in the order of their landmarks,
    those of j from ``begin[j]`` to ``begin[j + 1]``.
    """
    count = len(begin) - 1
    factors, pulls = np.zeros((count, 3, 3)), np.zeros((count, 3))
    links = np.empty((len(residuals), 7, 3))
    for j in range(count):
        C, b = np.zeros((3, 3)), np.zeros(3)
        for d in range(3):
            C[d, d] = damping[j]
        for k in range(begin[j], begin[j + 1]):
            for row in range(2):
                for d in range(3):
                    b[d] += by_point[k, row, d] * residuals[k, row]
                    for e in range(3):
                        C[d, e] += by_point[k, row, d] * by_point[k, row, e]
        L = factors[j]
        for d in range(3):
            for e in range(d + 1):
                total = C[d, e]
                for f in range(e):
                    total -= L[d, f] * L[e, f]
                L[d, e] = np.sqrt(total) if d == e else total / L[e, e]
        for d in range(3):
            total = b[d]
            for f in range(d):
                total -= L[d, f] * pulls[j, f]
            pulls[j, d] = total / L[d, d]
        for k in range(begin[j], begin[j + 1]):
            for c in range(7):
                for d in range(3):
                    total = by_image[k, 0, c] * by_point[k, 0, d] + by_image[k, 1, c] * by_point[k, 1, d]
                    for f in range(d):
                        total -= L[d, f] * links[k, c, f]
                    links[k, c, d] = total / L[d, d]
    return factors, pulls, links


@kernel
def shared_links(begin: IndexArray, image: IndexArray, links: FloatArray, shared: FloatArray) -> FloatArray:
    """(L, 3, q): how each whitened landmark hangs on the shared unknowns; ``shared`` is (I, 7, q)."""
    count, q = len(begin) - 1, shared.shape[2]
    found = np.zeros((count, 3, q))
    for j in range(count):
        for k in range(begin[j], begin[j + 1]):
            for c in range(7):
                for d in range(3):
                    factor = links[k, c, d]
                    for p in range(q):
                        found[j, d, p] += factor * shared[image[k], c, p]
    return found


@kernel
def subtract_landmarks(
    matrix: FloatArray, begin: IndexArray, image: IndexArray, links: FloatArray, common: FloatArray
) -> None:
    """Subtract what landmarks carry from image to image, and from images to shared unknowns; the lower triangle.

    ``matrix`` has two rows for each image, its pan and tilt, and then the shared unknowns; ``common`` is what
    `shared_links` returns.
    """
    first = matrix.shape[0] - common.shape[2]
    for j in range(len(begin) - 1):
        for k in range(begin[j], begin[j + 1]):
            for m in range(begin[j], begin[j + 1]):
                if image[m] > image[k]:
                    continue
                for r in range(2):
                    for s in range(2):
                        total = 0.0
                        for d in range(3):
                            total += links[k, 3 + r, d] * links[m, 3 + s, d]
                        matrix[2 * image[k] + r, 2 * image[m] + s] -= total
            for r in range(2):
                row = 2 * image[k] + r
                for p in range(common.shape[2]):
                    total = 0.0
                    for d in range(3):
                        total += links[k, 3 + r, d] * common[j, d, p]
                    matrix[first + p, row] -= total

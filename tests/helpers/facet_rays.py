"""Intersections of rays with facets by brute force: every facet is tried, by signed volumes in place of edges."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def crossings(corners: Floats, origin: Floats, direction: Floats) -> Floats:
    """Return the sorted distances, in lengths of ``direction``, at which a ray crosses facets (F, 3, 3)."""
    a, b, c = np.moveaxis(corners - origin, 1, 0)
    volumes = np.stack([np.cross(p, q) @ direction for p, q in ((a, b), (b, c), (c, a))])
    met = (volumes >= 0.0).all(axis=0) | (volumes <= 0.0).all(axis=0)
    normals = np.cross(b[met] - a[met], c[met] - a[met])
    along = np.einsum("fi,fi->f", a[met], normals) / (normals @ direction)
    return np.sort(along[along > 0.0])

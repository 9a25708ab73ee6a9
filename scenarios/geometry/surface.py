"""Where lines of sight meet a body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceHits:
    """The first points of the body on N lines of sight.

    Parameters
    ----------
    points_body_m
        (N, 3) points in the body frame; NaN where the line of sight misses the body.
    normals_body
        (N, 3) outward unit normals that the shading uses, in the body frame; NaN where it misses.
    facets
        (N,) index of the facet; -1 where it misses.
    lit
        (N,) whether the Sun shines on the point; False where it misses.
    """

    points_body_m: NDArray[np.float64]
    normals_body: NDArray[np.float64]
    facets: NDArray[np.int64]
    lit: NDArray[np.bool_]

    @property
    def hit(self) -> NDArray[np.bool_]:
        """(N,) whether the line of sight meets the body."""
        return self.facets >= 0

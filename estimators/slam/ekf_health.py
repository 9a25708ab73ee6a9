"""How a filter tells that it diverges: by its own innovation, and by how much of it a gate refuses."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from estimators.slam.following import LostError
from estimators.slam.options import FilterOptions

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

_MOST_REFUSED = 0.5


class Health:
    """Innovations and refusals of the last frames.

    A gate hides a divergence from the innovation that passes it: a filter that refuses more than half of what it sees,
    over as many frames, diverges too.
    """

    def __init__(self, options: FilterOptions) -> None:
        self.options = options
        self.recent: deque[tuple[float, int]] = deque(maxlen=options.innovation_frames)
        self.judged: deque[tuple[int, int]] = deque(maxlen=options.innovation_frames)
        self.in_a_row: dict[int, int] = {}
        self.total = 0.0
        self.measurements = 0
        self.refused = 0

    def diagnostics(self) -> dict[str, float]:
        """Return the mean squared normalised innovation, its degrees of freedom, and how many pixels were refused."""
        refused = {"refused_pixels": float(self.refused)}
        if not self.measurements:
            return refused
        return {
            "innovation": self.total / self.measurements,
            "innovation_degrees": float(self.measurements),
            **refused,
        }

    def judge(self, tracks: IndexArray, fit: BoolArray) -> None:
        """Note which tracks (n,) a gate believed in a frame.

        Raises
        ------
        LostError
            If most were refused for as many frames as innovations are averaged over.
        """
        self.in_a_row = {
            track: self.in_a_row.get(track, 0) + 1 for track, good in zip(tracks.tolist(), fit, strict=True) if not good
        }
        self.refused += int(np.count_nonzero(~fit))
        self.judged.append((int(np.count_nonzero(~fit)), len(fit)))
        refused, seen = (sum(item[i] for item in self.judged) for i in (0, 1))
        if len(self.judged) == self.judged.maxlen and refused > _MOST_REFUSED * seen:
            raise LostError(f"the filter diverges: {refused} of {seen} pixels of the last frames do not fit")

    def discredited(self) -> IndexArray:
        """List the tracks that were refused too often in a row."""
        return np.array([t for t, n in self.in_a_row.items() if n >= self.options.refusals_max], dtype=np.int64)

    def test(self, squared: float, count: int, inverse_distances: FloatArray) -> None:
        """Declare divergence where the squared normalised innovation stays far above its expectation of 1.

        Raises
        ------
        LostError
            If it does, or if an inverse distance is not positive.
        """
        self.total += squared
        self.measurements += count
        self.recent.append((squared, count))
        mean = sum(item[0] for item in self.recent) / max(sum(item[1] for item in self.recent), 1)
        if len(self.recent) == self.recent.maxlen and mean > self.options.innovation_max:
            raise LostError(
                f"the filter diverges: the squared normalised innovation of {len(self.recent)} frames is {mean:.3g}"
            )
        if np.any(inverse_distances <= 0.0):
            raise LostError("the filter diverges: an inverse distance is not positive")

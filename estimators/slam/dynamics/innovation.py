"""Whether new measurements agree with what was known before them: a smoother's own test of divergence."""

from __future__ import annotations

from collections import deque

from estimators.slam.dynamics.problem import DynamicAdjustment
from estimators.slam.following import LostError


class InnovationTest:
    """Holds by how much new frames raise the minimum of the cost against what chance lets expect.

    Twice the rise is chi-square of as many degrees of freedom as there are new measurements beyond new unknowns: the
    squared normalised innovation of a filter that iterates.
    """

    def __init__(self, frames: int, limit: float) -> None:
        self.limit = limit
        self.recent: deque[tuple[float, int]] = deque(maxlen=frames)
        self.total = 0.0
        self.measurements = 0

    def diagnostics(self) -> dict[str, float]:
        """Return the mean over all frames so far, of which 1 is expected, and its degrees of freedom."""
        if not self.measurements:
            return {}
        return {"innovation": self.total / self.measurements, "innovation_degrees": float(self.measurements)}

    def add(self, rise: float, measurements: int) -> None:
        """Take the next frame's rise in; raise LostError where the last frames are far above expectation."""
        self.total += 2.0 * rise
        self.measurements += measurements
        self.recent.append((2.0 * rise, measurements))
        count = sum(item[1] for item in self.recent)
        if len(self.recent) < (self.recent.maxlen or 0) or count <= 0:
            return
        mean = sum(item[0] for item in self.recent) / count
        if mean > self.limit:
            raise LostError(
                f"the smoother diverges: the squared normalised innovation of {len(self.recent)} frames is {mean:.3g};"
                " forces or tracks are not what they are said to be"
            )


def measurements_beyond_unknowns(problem: DynamicAdjustment) -> int:
    """Count measurements less unknowns of landmarks; a view adds as many unknowns as its arc tells."""
    vision = problem.vision
    return 2 * len(vision.sightings.view) + len(vision.distances.view) - 3 * len(vision.free_points)

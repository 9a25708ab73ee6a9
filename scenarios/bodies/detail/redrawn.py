"""Small features that are drawn from a seed of their own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Redrawn:
    """Features of one kind that are smaller than ``below_m`` come from ``seed``."""

    below_m: float
    seed: np.random.SeedSequence

"""The first image of a scenario's sequence and its strongest features, made again for a figure."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from campaign.kinds.sequence.images import OrbitImages
from scenarios.load import LoadedScenario


def first_image(
    scenario: LoadedScenario, variant: str, seed: int, count: int
) -> tuple[NDArray[np.float32], NDArray[np.float64], int]:
    """Return the image (H, W) of trial 0, its ``count`` strongest features (n, 2) px, and how many were found."""
    images = OrbitImages.open(scenario, variant, seed)
    features = images.found(0, 0).features
    return images.image(0, 0), features.uv_px[:count], len(features)

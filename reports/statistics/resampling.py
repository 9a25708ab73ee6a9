"""Resamples whose draws follow from what is resampled, so that the same rows give the same interval."""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import NDArray

RESAMPLES = 2000


def content_rng(*arrays: NDArray[np.generic]) -> np.random.Generator:
    """Seed a generator by the bytes of ``arrays``, so that the same rows give the same interval."""
    digest = hashlib.blake2b(digest_size=16)
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return np.random.default_rng(int.from_bytes(digest.digest(), "little"))


def draw_counts(n_clusters: int, resamples: int, rng: np.random.Generator) -> NDArray[np.int32]:
    """Draw (b, C) numbers of times that each cluster is in a resample of C clusters."""
    drawn = rng.integers(0, n_clusters, size=(resamples, n_clusters))
    drawn += n_clusters * np.arange(resamples)[:, None]
    counts = np.bincount(drawn.ravel(), minlength=resamples * n_clusters)
    return counts.reshape(resamples, n_clusters).astype(np.int32)

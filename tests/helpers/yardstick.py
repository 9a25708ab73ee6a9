"""A fixed piece of work of Python and numpy, in processor time, to which the cost of tests is related."""

from __future__ import annotations

import time

import numpy as np


def yardstick_s() -> float:
    """Return the processor time of interpreted Python, elementwise numpy and small linear algebra, about 0.3 s."""
    rng = np.random.default_rng(7)
    grid, systems = rng.normal(size=(256, 256)), rng.normal(size=(2000, 6, 6)) + 6.0 * np.eye(6)
    began, total = time.process_time(), 0.0
    for number in range(30):
        words = {f"{k}.{number}": k * k for k in range(8000)}
        total += sum(value for key, value in words.items() if key.endswith("7"))
        total += float(np.sqrt(np.abs(np.sin(grid + number))).sum() + np.linalg.solve(systems, systems).sum())
    return time.process_time() - began

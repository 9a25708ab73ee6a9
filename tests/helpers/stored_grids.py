"""A stored run over a grid of ranges and phases, of any number of levels and methods."""

import numpy as np
from stored_runs import RunBuilder, pose_error

RANGES, PHASES = tuple(f"{k} km" for k in range(5)), tuple(f"{k} deg" for k in range(6))
METHODS = tuple(f"method-{k}" for k in range(12))
TRIALS = 8


def size_m(near: int, dark: int, method: int, trial: int) -> float:
    """Error of a trial: no two cells have the same median."""
    return 100.0 + 30.0 * near + 6.0 * dark + 0.25 * method + trial


def store_wide(folder, ranges=RANGES, phases=PHASES, methods=METHODS, trials=TRIALS):
    """Store a grid of ranges and phases; the last method fails in the last cell."""
    builder, scenarios = RunBuilder(folder), []
    prior = {f"prior_{key}": value for key, value in pose_error(np.array([500.0, 0.0, 0.0]), 2.0).items()}
    for i, near in enumerate(ranges):
        for j, dark in enumerate(phases):
            name = f"rock-{i}-{j}"
            scenarios.append({"name": name, "base": "rock", "levels": {"range": near, "phase": dark}})
            for k, method in enumerate(methods):
                failed = (i, j, k) == (len(ranges) - 1, len(phases) - 1, len(methods) - 1)
                for trial in range(trials):
                    errors = pose_error(np.array([size_m(i, j, k, trial), 0.0, 0.0]), 1.0)
                    errors = dict.fromkeys(errors, np.nan) if failed else errors
                    key = {"trial": trial, "scenario": name, "estimator": method, "reason": "", "image": ""}
                    builder.add("rows", **key, status="failed" if failed else "ok", n_landmarks=9, **prior, **errors)
    axes = [
        {"name": name, "label": name, "levels": list(levels), "values": None}
        for name, levels in (("range", ranges), ("phase", phases))
    ]
    grid = {"design": "full", "axes": axes, "scenarios": scenarios}
    specs = {one["name"]: {} for one in scenarios}
    return builder.write(grid=grid, scenarios=specs, estimators=list(methods), report=None, trials=trials)


def store_thousand(folder):
    """Store a grid of 1,000 scenarios and 50 methods with 4 trials in each cell."""
    ranges, phases = [f"{k} km" for k in range(40)], [f"{k} deg" for k in range(25)]
    return store_wide(folder, ranges, phases, [f"method-{k}" for k in range(50)], trials=4)

"""Units of a run that are statistically independent: trials, real images, sets of rendered images, or data bases.

The noise realisations of a real image share its difficulty, the starts of sequences on one set of images share the
errors of its features, and trials with one data base those of its landmarks. All trials enter a statistic, but its
uncertainty is that of the number of images, sets, or data bases. Where there is a single data base, statistics hold for
it alone, and the trials are the independent units.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from boresight.reports.run.data import TRIAL_KEY, RunData

_DATA_BASE = "data base "


def image_set(spec: Mapping[str, Any]) -> str:
    """Name the set of images that the sequences of a scenario use; '' where there is none.

    All images of one body are one set, whatever the camera: they share its texture.
    """
    sequence = spec.get("sequence") or {}
    return json.dumps(spec.get("body"), sort_keys=True) if sequence.get("images") else ""


def all_but_body(spec: Mapping[str, Any]) -> str:
    """Name the conditions of a scenario apart from its body: those that have it in common are pooled."""
    rest = {key: value for key, value in spec.items() if key not in {"name", "description", "body"}}
    return json.dumps(rest, sort_keys=True)


def clusters_of(run: RunData, table: pd.DataFrame) -> NDArray[np.generic]:
    """Label each row of a table (``scenario``, ``trial``) by the independent unit that it belongs to.

    The unit is the data base of its trial where there are several, its set of images where sequences use one, its image
    where that is real, else its trial. A table without ``estimator`` stands for all estimators together, of which some
    may have data bases.
    """
    trials = table["trial"].to_numpy().astype(str)
    if run.databases > 1:
        keys = [name for name in TRIAL_KEY if name in table]
        numbers = run.database_of_trial.groupby(level=keys).max()
        number = numbers.reindex(pd.MultiIndex.from_frame(table[keys])).to_numpy(dtype=np.float64)
        named = np.char.add(_DATA_BASE, np.nan_to_num(number, nan=-1.0).astype(int).astype(str))
        return np.where(np.isnan(number), trials, named)
    units: NDArray[np.str_] = trials
    if run.has_images:
        image = (
            run.image_of_trial.reindex(pd.MultiIndex.from_frame(table[["scenario", "trial"]]))
            .fillna("")
            .to_numpy(dtype=str)
        )
        units = np.where(image == "", trials, image)
    sets = {name: image_set(run.manifest.scenarios.get(name, {})) for name in table["scenario"].unique()}
    if any(sets.values()):
        seen = table["scenario"].map(sets).fillna("").to_numpy(dtype=str)
        units = np.where(seen == "", units, seen)
    return units


def units_of(clusters: NDArray[np.generic]) -> int:
    """Return how many of some rows, labelled by `clusters_of`, count as independent where all of them agree.

    That they agree says nothing of their correlation. The noise realisations of one image, or the starts on one set of
    images, are nearly copies and count as one; the trials of one data base are of other views, and count each.
    """
    labels = np.asarray(clusters).astype(str)
    of_data_bases = np.char.startswith(labels, _DATA_BASE)
    return int(of_data_bases.sum()) + len(np.unique(labels[~of_data_bases]))


def pools(run: RunData) -> dict[str, tuple[str, ...]]:
    """Pool the scenarios that differ in their set of images, one for each body with its texture, and in nothing else.

    Return the scenarios of each pool by its name, which stands for that of a scenario and counts the sets.
    """
    alike: dict[str, list[str]] = {}
    done = set(run.rows["scenario"])
    for name, spec in run.manifest.scenarios.items():
        if name in done:
            alike.setdefault(all_but_body(spec), []).append(name)
    found = {}
    for names in alike.values():
        sets = len({image_set(run.manifest.scenarios[name]) for name in names})
        if sets > 1:
            found[f"{_base(run, names)}, {sets} sets of images"] = tuple(names)
    return found


def _base(run: RunData, names: list[str]) -> str:
    """Name the scenario that those of a pool vary, with the grid levels that they have in common."""
    design = run.manifest.grid
    own = [one for one in design.scenarios if one.name in names] if design is not None else []
    if len({one.base for one in own}) != 1:
        return ", ".join(names)
    common = [level for axis, level in own[0].levels.items() if all(one.levels[axis] == level for one in own)]
    return "-".join((own[0].base, *common))


def pooled_scenarios(run: RunData) -> set[str]:
    """Return the scenarios that belong to a pool."""
    return {name for members in pools(run).values() for name in members}


def groups(run: RunData) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield the groups of scenarios over which statistics are taken: each scenario by itself, then each pool."""
    yield from ((name, (name,)) for name in dict.fromkeys(run.rows["scenario"]))
    yield from pools(run).items()

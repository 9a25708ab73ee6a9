"""What looks at trials of several kinds share: good, bad and failed ones, and how near their cameras are drawn."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from campaign.inspection.case import Case, Choice
from campaign.inspection.ranking import worst_cases
from campaign.inspection.show import Scene
from reports.pages.view3d import BAD, FAILED, GOOD, CameraSet
from reports.run.data import select

FloatArray = NDArray[np.float64]

MOST_FACES = 40_000
_NEAR = 1.8


def nearer(places_m: FloatArray, radius_m: float) -> tuple[float, str]:
    """Return by which factor (n, 3) cameras are drawn nearer than they are, and a line that says so.

    From 2 km a body of 300 m is a dot: cameras in the middle are drawn at 1.8 radii of the body.
    """
    middle = float(np.median(np.linalg.norm(places_m, axis=1))) if len(places_m) else 0.0
    factor = max(middle / (_NEAR * radius_m), 1.0)
    return factor, f" Cameras are drawn {factor:.2g} times nearer to the body than they are." if factor > 1.0 else ""


def camera_sets(
    rows: pd.DataFrame, badness: FloatArray, told: Callable[[float], str], places: Callable[[int], FloatArray]
) -> list[CameraSet]:
    """Divide the cameras of trials into good ones, bad ones (above the median badness) and those without an estimate.

    Parameters
    ----------
    rows
        Rows of the run, one for each trial.
    badness
        (n,) how bad each is, in the order of the rows.
    told
        Says a badness in words.
    places
        (n, 3) cameras of a trial.
    """
    values = pd.Series(badness, index=rows.index)
    solved = rows["status"] == "ok"
    good = solved & (values <= values[solved].median())
    sets = (("good trials", GOOD, good), ("bad trials", BAD, solved & ~good), ("no estimate", FAILED, ~solved))
    found = []
    for name, colour, which in sets:
        texts, points = [], [np.zeros((0, 3))]
        keys = rows.loc[which, ["trial", "status", "reason"]].itertuples(index=False, name=None)
        for (trial, status, reason), value in zip(keys, values[which], strict=True):
            points.append(np.reshape(places(int(trial)), (-1, 3)))
            text = f"trial {trial}<br>" + (told(value) if status == "ok" else f"{status}: {reason}")
            texts += [text] * len(points[-1])
        if texts:
            found.append(CameraSet(name, colour, np.concatenate(points), texts))
    return found


def middle_and_worst(scene: Scene) -> Iterable[tuple[str, str, Case]]:
    """Yield the trial in the middle and the worst one with their names and colours; one that is both, once."""
    every = len(select(scene.run.rows, scene.scenario, scene.label))
    ranked, _ = worst_cases(scene.run, every, Choice(scene.scenario, scene.label), None)
    cases = list(dict.fromkeys([ranked[len(ranked) // 2], ranked[0]]))
    return list(zip(("middle", "worst"), (GOOD, BAD), cases, strict=False))


def finite_or_dash(value: float, unit: str) -> str:
    """Print a number with its unit, or a dash where there is none."""
    return "-" if np.isnan(value) else f"{value:.3g} {unit}"

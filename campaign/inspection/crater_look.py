"""Parts of looks at craters in images: craters by their share of hits, and the cameras of good and bad trials."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from campaign.inspection.coarse import coarsened
from campaign.inspection.look_parts import MOST_FACES, camera_sets, finite_or_dash, nearer
from campaign.inspection.show import Scene
from reports.pages.view3d import PointSet, View3D
from scenarios.geometry import TriangleMesh

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


def outcome_marks(places_m: FloatArray, outcomes: pd.DataFrame, words: tuple[str, str, str]) -> PointSet:
    """Colour craters by their share of hits; ``words`` name the share, the chances and the hits."""
    chances, hits = (outcomes[name].to_numpy(dtype=np.float64) for name in ("chances", "hits"))
    share = np.where(chances > 0, 100.0 * hits / np.maximum(chances, 1.0), np.nan)
    texts = [
        f"crater {number}<br>{words[1]}: {c:.0f} times<br>{words[2]}: {h:.0f} ({finite_or_dash(s, '%')})"
        for number, c, h, s in zip(outcomes.index, chances, hits, share, strict=True)
    ]
    return PointSet(words[0], places_m, share, texts, "%")


def crater_look(
    scene: Scene,
    rows: pd.DataFrame,
    marks: list[PointSet],
    mesh: TriangleMesh,
    trials: tuple[dict[int, FloatArray], str, pd.Series | None],
) -> View3D:
    """Put a look together: ``trials`` are the cameras of each, what its faults are called, and how many it has."""
    views, called, faults = trials
    body = coarsened(mesh, MOST_FACES)
    factor, told = nearer(np.concatenate(list(views.values())), body.radius_m)
    badness = np.full(len(rows), np.nan) if faults is None else faults[rows.index].to_numpy(dtype=np.float64)
    middle = float(np.nanmedian(badness)) if np.isfinite(badness).any() else 0.0
    note = f"{len(rows)} trials. Good and bad: at most, or more than, the median of {middle:g} {called}.{told}"
    cameras = camera_sets(rows, badness, lambda value: f"{value:.0f} {called}", lambda trial: views[trial] / factor)
    return View3D(scene.title, note, body.vertices_m, body.faces, marks, cameras)


def places_of(centre_m: FloatArray, numbers: IndexArray, outcomes: pd.DataFrame) -> FloatArray:
    """Find the middles of the craters that index ``outcomes``."""
    return pd.DataFrame(centre_m, index=numbers).loc[outcomes.index].to_numpy(dtype=np.float64)

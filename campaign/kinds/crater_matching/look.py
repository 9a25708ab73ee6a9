"""A look at crater matching: how often each crater is matched, and both cameras of good and bad trials."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from campaign.inspection.case import Case
from campaign.inspection.crater_look import crater_look, outcome_marks, places_of
from campaign.inspection.ranking import crater_faults
from campaign.inspection.recompute import recompute
from campaign.inspection.show import Scene
from campaign.kinds.crater_matching.pairs import PairSource, RenderedPairs, SimulatedPairs
from campaign.kinds.crater_matching.trial import CraterMatching, MatchedPair
from reports.pages.look import Look
from reports.run.data import select
from scenarios.craters.simulated import NO_CRATER
from scenarios.errors import BoresightError

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

_MOST_PAIRS = 60
"""Trials of matching that are recomputed: which crater each match is of is not stored."""


def look_at_matches(scene: Scene) -> Look:
    """Show the craters by how often they are matched when both looks show them, and both cameras of each trial."""
    experiment, run = scene.opened(CraterMatching), scene.run
    rows = select(run.rows, scene.scenario, scene.label).head(_MOST_PAIRS)
    views, outcomes = {}, []
    for trial in map(int, rows["trial"]):
        shown = recompute(scene.campaign, scene.folder, Case(scene.scenario, scene.label, trial)).shown
        if isinstance(shown, MatchedPair):
            looks = (shown.pair.first, shown.pair.second)
            views[trial] = np.array([look.view.T_cam_body.camera_position_m for look in looks])
            outcomes.append(pair_outcomes(shown))
    if not outcomes:
        raise BoresightError(f"{scene.folder.path}: --look: no trial of {scene.title} came to a pair of looks")
    rows = rows[rows["trial"].isin(views)]
    counts = pd.concat(outcomes).groupby("crater").sum()
    words = ("matched when in both looks", "in both looks", "matched rightly")
    marks = [outcome_marks(places_of(*_craters_of(experiment.source), counts), counts, words)]
    look = crater_look(
        scene, rows, marks, experiment.known.mesh, (views, "missed or wrong matches", crater_faults(run))
    )
    more = len(select(run.rows, scene.scenario, scene.label)) - len(rows)
    return replace(look, note=f"{look.note} {more} further trials are left out.") if more else look


def pair_outcomes(shown: MatchedPair) -> pd.DataFrame:
    """List the craters that both looks of a pair show, and whether each is matched with itself."""
    one, other = (look.detections.crater for look in (shown.pair.first, shown.pair.second))
    common = np.setdiff1d(np.intersect1d(one, other), [NO_CRATER])
    pairs = np.zeros((0, 2), dtype=np.int64) if shown.matches is None else shown.matches.pairs
    here, there = one[pairs[:, 0]], other[pairs[:, 1]]
    hits = np.isin(common, here[here == there]).astype(float)
    return pd.DataFrame({"crater": common, "chances": np.ones(len(common)), "hits": hits})


def _craters_of(source: PairSource) -> tuple[FloatArray, IndexArray]:
    """Return the middles (n, 3) and the numbers (n,) of the craters that a source shows."""
    if isinstance(source, SimulatedPairs):
        return source.craters.centre_body_m, np.arange(len(source.craters))
    if isinstance(source, RenderedPairs):
        return source.rims.centre_m, source.rims.crater
    raise TypeError(f"{type(source).__name__} has no craters that could be looked at")

"""Looks at craters in images: how often each is detected, or matched, and the cameras of good and bad trials."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from campaign.crater_pairs import PairSource, RenderedPairs, SimulatedPairs
from campaign.experiments.crater_detection import CraterDetection
from campaign.experiments.crater_matching import CraterMatching, MatchedPair
from campaign.inspection.case import Case
from campaign.inspection.coarse import coarsened
from campaign.inspection.looks.parts import MOST_FACES, Of, camera_sets, finite_or_dash, nearer
from campaign.inspection.ranking import crater_faults
from campaign.inspection.recompute import recompute
from campaign.resolve import ResolvedCampaign
from campaign.store import RunFolder
from reports.look import Look, Marks
from reports.run_data import RunData, select
from scenarios.craters.simulated import NO_CRATER
from scenarios.errors import BoresightError
from scenarios.geometry import TriangleMesh

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

_MOST_PAIRS = 60
"""Trials of matching that are recomputed: which crater each match is of is not stored."""


def look_at_detections(experiment: CraterDetection, run: RunData, of: Of) -> Look:
    """Show the craters by how often they are detected when they could be, and the cameras of all images.

    Of several worlds the first is shown.
    """
    rows = select(run.rows, of.scenario, of.label)
    rows = rows[rows["trial"] % max(len(experiment.others), 1) == 0]
    ground = experiment.world.ground
    if ground is None:
        raise BoresightError(f"{run.folder}: --look: the scenario {of.scenario} has no craters")
    there = run.craters[(run.craters["scenario"] == of.scenario) & run.craters["detectable"].astype(bool)]
    there = there[there["trial"].isin(rows["trial"])]
    found = select(run.detections, of.scenario, of.label)
    found = found[found["trial"].isin(rows["trial"])]
    found = found[found["kept"].astype(bool) & found["detectable"].astype(bool) & (found["crater"] >= 0)]
    chances = there.groupby("crater").size()
    hits = found.groupby("crater").size().reindex(chances.index).fillna(0)
    outcomes = pd.DataFrame({"chances": chances, "hits": hits})
    places = _at(ground.rims.centre_m, ground.rims.crater, outcomes)
    marks = [outcome_marks(places, outcomes, ("detected when detectable", "detectable", "detected"))]
    views = {
        int(trial): experiment.world.source.view(experiment.seed, int(trial)).T_cam_body.camera_position_m[None]
        for trial in rows["trial"]
    }
    return _look(of, rows, marks, experiment.world.body.mesh, (views, "missed or false craters", crater_faults(run)))


def look_at_matches(
    campaign: ResolvedCampaign, folder: RunFolder, run: RunData, of: Of, experiment: CraterMatching
) -> Look:
    """Show the craters by how often they are matched when both looks show them, and both cameras of each trial."""
    rows = select(run.rows, of.scenario, of.label).head(_MOST_PAIRS)
    views, outcomes = {}, []
    for trial in map(int, rows["trial"]):
        shown = recompute(campaign, folder, Case(of.scenario, of.label, trial)).shown
        if isinstance(shown, MatchedPair):
            looks = (shown.pair.first, shown.pair.second)
            views[trial] = np.array([look.view.T_cam_body.camera_position_m for look in looks])
            outcomes.append(pair_outcomes(shown))
    if not outcomes:
        raise BoresightError(f"{folder.path}: --look: no trial of {of.title} came to a pair of looks")
    rows = rows[rows["trial"].isin(views)]
    counts = pd.concat(outcomes).groupby("crater").sum()
    words = ("matched when in both looks", "in both looks", "matched rightly")
    marks = [outcome_marks(_at(*_craters_of(experiment.source), counts), counts, words)]
    look = _look(of, rows, marks, experiment.known.mesh, (views, "missed or wrong matches", crater_faults(run)))
    more = len(select(run.rows, of.scenario, of.label)) - len(rows)
    return replace(look, note=f"{look.note} {more} further trials are left out.") if more else look


def pair_outcomes(shown: MatchedPair) -> pd.DataFrame:
    """List the craters that both looks of a pair show, and whether each is matched with itself."""
    one, other = (look.detections.crater for look in (shown.pair.first, shown.pair.second))
    common = np.setdiff1d(np.intersect1d(one, other), [NO_CRATER])
    pairs = np.zeros((0, 2), dtype=np.int64) if shown.matches is None else shown.matches.pairs
    here, there = one[pairs[:, 0]], other[pairs[:, 1]]
    hits = np.isin(common, here[here == there]).astype(float)
    return pd.DataFrame({"crater": common, "chances": np.ones(len(common)), "hits": hits})


def outcome_marks(places_m: FloatArray, outcomes: pd.DataFrame, words: tuple[str, str, str]) -> Marks:
    """Colour craters by their share of hits; ``words`` name the share, the chances and the hits."""
    chances, hits = (outcomes[name].to_numpy(dtype=np.float64) for name in ("chances", "hits"))
    share = np.where(chances > 0, 100.0 * hits / np.maximum(chances, 1.0), np.nan)
    texts = [
        f"crater {number}<br>{words[1]}: {c:.0f} times<br>{words[2]}: {h:.0f} ({finite_or_dash(s, '%')})"
        for number, c, h, s in zip(outcomes.index, chances, hits, share, strict=True)
    ]
    return Marks(words[0], places_m, share, texts, "%")


def _look(
    of: Of,
    rows: pd.DataFrame,
    marks: list[Marks],
    mesh: TriangleMesh,
    trials: tuple[dict[int, FloatArray], str, pd.Series | None],
) -> Look:
    """Put a look together: ``trials`` are the cameras of each, what its faults are called, and how many it has."""
    views, called, faults = trials
    body = coarsened(mesh, MOST_FACES)
    factor, told = nearer(np.concatenate(list(views.values())), body.radius_m)
    badness = np.full(len(rows), np.nan) if faults is None else faults[rows.index].to_numpy(dtype=np.float64)
    middle = float(np.nanmedian(badness)) if np.isfinite(badness).any() else 0.0
    note = f"{len(rows)} trials. Good and bad: at most, or more than, the median of {middle:g} {called}.{told}"
    cameras = camera_sets(rows, badness, lambda value: f"{value:.0f} {called}", lambda trial: views[trial] / factor)
    return Look(of.title, note, body.vertices_m, body.faces, marks, cameras)


def _craters_of(source: PairSource) -> tuple[FloatArray, IndexArray]:
    """Return the middles (n, 3) and the numbers (n,) of the craters that a source shows."""
    if isinstance(source, SimulatedPairs):
        return source.craters.centre_body_m, np.arange(len(source.craters))
    if isinstance(source, RenderedPairs):
        return source.rims.centre_m, source.rims.crater
    raise TypeError(f"{type(source).__name__} has no craters that could be looked at")


def _at(centre_m: FloatArray, numbers: IndexArray, outcomes: pd.DataFrame) -> FloatArray:
    """Find the middles of the craters that index ``outcomes``."""
    return pd.DataFrame(centre_m, index=numbers).loc[outcomes.index].to_numpy(dtype=np.float64)

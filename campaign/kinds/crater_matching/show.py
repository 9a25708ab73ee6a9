"""The displays of crater matching."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import cast

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from boresight.campaign.inspection.recompute import Case, Recomputed, recompute
from boresight.campaign.inspection.show import (
    CaseFigures,
    CaseFiles,
    EstimatorRun,
    Show,
    crater_look,
    outcome_marks,
    places_of,
)
from boresight.campaign.kinds.crater_matching import CraterMatching, MatchedPair, right_matches, unlisted_matches
from boresight.campaign.kinds.crater_matching.pairs import PairSource, SimulatedPairs
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.store import RunFolder
from boresight.estimators.craters.contract import CraterMatches
from boresight.reports.compare.trials import missed_or_wrong
from boresight.reports.figures.craters import MatchedRims, draw_matched_pair
from boresight.reports.figures.named import NamedFigure, file_stem
from boresight.reports.pages.view3d import View3D
from boresight.reports.run.data import RunData, read_run
from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.craters.simulated import NO_CRATER
from boresight.scenarios.errors import BoresightError

_ALIKE_DEG = (20.0, 10.0)

_MOST_PAIRS = 60
"""Trials of matching that are recomputed: which crater each match is of is not stored."""


def look_at_matches(scene: EstimatorRun) -> View3D:
    """Show the craters by how often they are matched when both looks show them, and both cameras of each trial."""
    run, experiment = scene.run, cast("CraterMatching", scene.opened())
    rows = run.of(scene.scenario, scene.label).head(_MOST_PAIRS)
    views, outcomes = {}, []
    for trial in map(int, rows["trial"]):
        shown = recompute(scene.campaign, scene.folder, Case(scene.scenario, scene.label, trial)).shown
        if shown is not None:
            looks = (shown.truth.first, shown.truth.second)
            views[trial] = np.array([look.view.T_cam_body.camera_position_m for look in looks])
            outcomes.append(pair_outcomes(shown))
    if not outcomes:
        raise BoresightError(f"{scene.folder.path}: --look: no trial of {scene.title} came to a pair of looks")
    rows = rows[rows["trial"].isin(views)]
    counts = pd.concat(outcomes).groupby("crater").sum()
    words = ("matched when in both looks", "in both looks", "matched rightly")
    marks = [outcome_marks(places_of(*_craters_of(experiment.source), counts), counts, words)]
    look = crater_look(
        scene, rows, marks, experiment.known.mesh, (views, "missed or wrong matches", missed_or_wrong(run))
    )
    more = len(run.of(scene.scenario, scene.label)) - len(rows)
    return replace(look, note=f"{look.note} {more} further trials are left out.") if more else look


def pair_outcomes(shown: MatchedPair) -> pd.DataFrame:
    """List the craters that both looks of a pair show, and whether each is matched with itself."""
    one, other = (look.detections.crater for look in (shown.truth.first, shown.truth.second))
    common = np.setdiff1d(np.intersect1d(one, other), [NO_CRATER])
    pairs = np.zeros((0, 2), dtype=np.int64) if shown.estimate is None else shown.estimate.pairs
    here, there = one[pairs[:, 0]], other[pairs[:, 1]]
    hits = np.isin(common, here[here == there]).astype(float)
    return pd.DataFrame({"crater": common, "chances": np.ones(len(common)), "hits": hits})


def _craters_of(source: PairSource) -> tuple[FloatArray, IndexArray]:
    """Return the middles (n, 3) and the numbers (n,) of the craters that a source shows."""
    if isinstance(source, SimulatedPairs):
        return source.craters.centre_body_m, np.arange(len(source.craters))
    if source.imager.ground is None:
        raise TypeError("rendered pairs have craters")
    return source.imager.ground.rims.centre_m, source.imager.ground.rims.crater


def draw_pair_case(again: Recomputed) -> CaseFigures:
    """Draw both looks with the matches that are right, those that are wrong, and common craters that were missed."""
    shown, what = cast("MatchedPair", again.shown), str(again.case)
    looks = (shown.truth.first, shown.truth.second)
    matches = CraterMatches.none("") if shown.estimate is None else shown.estimate
    one, other = (look.detections.crater for look in looks)
    unlisted = unlisted_matches(matches, shown.truth)
    pairs, right = matches.pairs[~unlisted], right_matches(matches, shown.truth)[~unlisted]
    rims = MatchedRims(
        (looks[0].detections.ellipses, looks[1].detections.ellipses), pairs, right, _missed(one, other, pairs[right])
    )
    images = (looks[0].frame.image, looks[1].frame.image)
    view_deg, sun_deg = shown.truth.view_deg, shown.truth.sun_deg
    caption = (
        f"{what}. The same craters have the same colour and number in both looks, {view_deg:.0f} deg of view"
        f" and {sun_deg:.0f} deg of Sun apart. Red and dashed: wrong matches. White and dashed: craters that"
        " both show and that were not matched. Grey: other detections."
    )
    figure = NamedFigure(
        "pair", draw_matched_pair(images, rims, what), caption, "Two looks at craters with their rims."
    )
    drawn = "" if images[0].size else " Rims are drawn by geometry in this scenario: there are no images."
    neither = f" {unlisted.sum()} more of craters too small for the truth's list." if unlisted.any() else ""
    return CaseFigures([figure], notes=[f"{len(pairs)} matches, {int(right.sum())} of them right.{neither}{drawn}"])


def _missed(one: NDArray[np.int64], other: NDArray[np.int64], right: NDArray[np.int64]) -> NDArray[np.int64]:
    """(k, 2) rows of common craters of which no match is right."""
    common = np.setdiff1d(np.intersect1d(one[one != NO_CRATER], other), one[right[:, 0]])
    rows = [(int(np.flatnonzero(one == c)[0]), int(np.flatnonzero(other == c)[0])) for c in common]
    return np.array(rows, dtype=np.int64).reshape(-1, 2)


def matching_examples(campaign: ResolvedCampaign, folder: RunFolder) -> Iterator[NamedFigure]:
    """Draw a pair for each scenario and matcher; of a grid of scenarios none."""
    run = read_run(folder.path)
    for scenario, label in run.pairs() if run.manifest.grid is None else ():
        figure = matching_example(campaign, folder, run, scenario, label)
        if figure is not None:
            yield figure


def matching_example(
    campaign: ResolvedCampaign, folder: RunFolder, run: RunData, scenario: str, label: str
) -> NamedFigure | None:
    """Draw the pair in which a matcher finds its median number of craters; None where it never finds one."""
    trial = _typical(run.of(scenario, label, "crater_matches"))
    again = None if trial is None else recompute(campaign, folder, Case(scenario, label, trial))
    if again is None or again.shown is None:
        return None
    figure = next(iter(draw_pair_case(again).figures))
    chosen = (
        " Of the pairs with views within 20 deg and Suns within 10 deg, where there are any, that with the median"
        " number of right matches."
    )
    return replace(figure, stem=file_stem("matching_example", scenario, label), caption=f"{figure.caption}{chosen}")


def _typical(table: pd.DataFrame) -> int | None:
    """Return the trial of the median number of right matches, those of none left out."""
    found = table[table["n_correct"] > 0]
    alike = found[(found["view_deg"] <= _ALIKE_DEG[0]) & (found["sun_deg"] <= _ALIKE_DEG[1])]
    ordered = (alike if len(alike) else found).sort_values(["n_correct", "trial"])["trial"]
    return int(ordered.iloc[len(ordered) // 2]) if len(ordered) else None


def kept(shown: MatchedPair) -> CaseFiles:
    """Return both images, where there are some, and the matches; none of a matcher that raised."""
    looks = {"first": shown.truth.first.frame.image, "second": shown.truth.second.frame.image}
    images = {name: image for name, image in looks.items() if image.size}
    if shown.estimate is None:
        return CaseFiles(images)
    matches = shown.estimate
    return CaseFiles(
        images, {"reason": matches.reason, "pairs": matches.pairs.tolist(), "score": matches.score.tolist()}
    )


SHOW = Show(draw=draw_pair_case, kept=kept, look=look_at_matches, examples=matching_examples)

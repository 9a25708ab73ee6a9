"""Pairs of images of a stored run of crater matching with what was matched, made again from their seeds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import pandas as pd

from campaign.inspection.case import Case
from campaign.inspection.recompute import recompute
from campaign.kinds.crater_matching.draw import draw_pair_case
from campaign.resolved import ResolvedCampaign
from campaign.store import RunFolder
from reports.run.data import RunData, read_run, select
from reports.schema.named_figure import NamedFigure, file_stem

_ALIKE_DEG = (20.0, 10.0)


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
    trial = _typical(select(run.crater_matches, scenario, label))
    drawn = None if trial is None else draw_pair_case(recompute(campaign, folder, Case(scenario, label, trial)))
    if drawn is None:
        return None
    figure = drawn.figures[0]
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

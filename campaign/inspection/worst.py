"""The worst trials of a run with their pictures, for its report."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from campaign.inspection.case import Choice
from campaign.inspection.draw import draw_case
from campaign.inspection.ranking import ORDER, worst_cases
from campaign.inspection.recompute import recompute
from campaign.resolve import ResolvedCampaign
from campaign.store import RunFolder
from reports.named_figure import NamedFigure
from reports.run_data import read_run


def worst_figures(campaign: ResolvedCampaign, folder: RunFolder, count: int) -> Iterator[NamedFigure]:
    """Draw the first picture of each of the worst cases; none where one alone takes minutes to make again."""
    if count == 0 or _is_long(campaign):
        return
    cases, ranked_by = worst_cases(read_run(folder.path), count, Choice(), None)
    for place, case in enumerate(cases, start=1):
        again = recompute(campaign, folder, case)
        for figure in list(draw_case(again).figures)[:1]:
            reason = f" ({again.row['reason']})" if again.row["reason"] else ""
            words = (
                f"Worst {place} of {len(cases)} by {ORDER} {ranked_by}: {again.row['status']}{reason}. {figure.caption}"
                f" All of it: boresight inspect {folder.path} --scenario {case.scenario} --estimator {case.estimator}"
                f" --trial {case.trial}"
            )
            yield replace(figure, stem=f"worst_{place}", caption=words)


def _is_long(campaign: ResolvedCampaign) -> bool:
    on_images = any(s.spec.sequence is not None and s.spec.sequence.images is not None for s in campaign.scenarios)
    return on_images or campaign.spec.experiment == "crater-navigation"

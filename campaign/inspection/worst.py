"""The worst trials of a run with their pictures, for its report."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from campaign.inspection.build import draw_case
from campaign.inspection.case import Choice
from campaign.inspection.ranking import ORDER, worst_cases
from campaign.inspection.recompute import recompute
from campaign.inspection.show import show_of
from campaign.resolved import ResolvedCampaign
from campaign.store import RunFolder
from reports.run.data import read_run
from reports.schema.named_figure import NamedFigure


def worst_figures(campaign: ResolvedCampaign, folder: RunFolder, count: int) -> Iterator[NamedFigure]:
    """Draw the first picture of each of the worst cases; none where one alone takes minutes to make again."""
    show = show_of(campaign.spec.experiment)
    if count == 0 or (show is not None and show.long(campaign)):
        return
    cases, ranked_by = worst_cases(read_run(folder.path), count, Choice(), None)
    for place, case in enumerate(cases, start=1):
        again = recompute(campaign, folder, case)
        for figure in list(draw_case(again, show, campaign.spec.experiment).figures)[:1]:
            reason = f" ({again.row['reason']})" if again.row["reason"] else ""
            words = (
                f"Worst {place} of {len(cases)} by {ORDER} {ranked_by}: {again.row['status']}{reason}. {figure.caption}"
                f" All of it: boresight inspect {folder.path} --scenario {case.scenario} --estimator {case.estimator}"
                f" --trial {case.trial}"
            )
            yield replace(figure, stem=f"worst_{place}", caption=words)

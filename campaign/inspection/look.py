"""What is to be seen of a run in space: the body, landmarks by how they are recognised, good and bad cameras."""

from __future__ import annotations

from campaign.inspection.case import CONTROLS, Choice, unknown
from campaign.inspection.show import Scene, show_of
from campaign.resolved import ResolvedCampaign
from campaign.store import RunFolder
from reports.pages.view3d import View3D
from reports.run.data import RunData
from scenarios.errors import BoresightError


def look_of(campaign: ResolvedCampaign, folder: RunFolder, run: RunData, choice: Choice) -> View3D:
    """Collect what is to be seen of one scenario and estimator.

    Raises
    ------
    BoresightError
        If several scenarios or estimators are left to choose from, or the kind of trial has no places in space.
    """
    scenario, label = _one(run, choice)
    kind = campaign.spec.experiment
    show = show_of(kind)
    if show is None or show.look is None:
        raise BoresightError(f"{folder.path}: --look: trials of {kind} have no camera to look at: leave it out")
    return show.look(Scene(campaign, folder, run, scenario, label))


def _one(run: RunData, choice: Choice) -> list[str]:
    """Choose the one scenario and estimator: the named one, or the only one that is no control."""
    chosen = []
    for column, wanted, left_out in (("scenario", choice.scenario, ()), ("estimator", choice.estimator, CONTROLS)):
        there = list(dict.fromkeys(run.rows[column].astype(str)))
        rest = [name for name in there if name not in left_out] or there
        if wanted is not None and wanted not in there:
            raise unknown(column, wanted, there, str(run.folder))
        if wanted is None and len(rest) > 1:
            raise BoresightError(f"--look shows one {column}: give --{column}, one of {', '.join(there)}")
        chosen.append(wanted or rest[0])
    return chosen

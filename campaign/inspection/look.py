"""What is to be seen of a run in space: the body, landmarks by how they are recognised, good and bad cameras."""

from __future__ import annotations

from campaign.experiments.crater_detection import CraterDetection
from campaign.experiments.crater_matching import CraterMatching
from campaign.experiments.crater_navigation import CraterNavigationTrials
from campaign.experiments.orbit_determination import OrbitTrials
from campaign.experiments.registry import Bench
from campaign.experiments.sequence import SequenceTrials
from campaign.experiments.single_image import SingleImage
from campaign.inspection.case import CONTROLS, Choice, unknown
from campaign.inspection.looks.craters import look_at_detections, look_at_matches
from campaign.inspection.looks.images import look_at_images
from campaign.inspection.looks.orbit import look_at_orbits
from campaign.inspection.looks.parts import Of
from campaign.inspection.looks.sequence import look_at_sequences
from campaign.resolve import ResolvedCampaign
from campaign.store import RunFolder
from campaign.worker import experiment_of
from reports.look import Look
from reports.run_data import RunData
from scenarios.errors import BoresightError


def look_of(campaign: ResolvedCampaign, folder: RunFolder, run: RunData, choice: Choice) -> Look:
    """Collect what is to be seen of one scenario and estimator.

    Raises
    ------
    BoresightError
        If several scenarios or estimators are left to choose from, or the kind of trial has no places in space.
    """
    of = _one(run, choice)
    experiment = experiment_of(campaign, of.scenario, Bench(folder.path, 1, keep_images=False))
    if isinstance(experiment, SingleImage):
        return look_at_images(experiment, run, of)
    if isinstance(experiment, SequenceTrials):
        return look_at_sequences(campaign, folder, run, of)
    if isinstance(experiment, OrbitTrials | CraterNavigationTrials):
        return look_at_orbits(campaign, folder, run, of)
    if isinstance(experiment, CraterMatching):
        return look_at_matches(campaign, folder, run, of, experiment)
    if isinstance(experiment, CraterDetection):
        return look_at_detections(experiment, run, of)
    raise BoresightError(f"{folder.path}: --look: trials of {experiment.kind} have no camera to look at: leave it out")


def _one(run: RunData, choice: Choice) -> Of:
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
    return Of(*chosen)

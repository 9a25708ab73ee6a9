"""Images of a stored run of crater detection with what was there and what was found, made again from their seeds."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from campaign.experiments.crater_detection import CraterDetection
from campaign.experiments.registry import Bench
from campaign.resolve import ResolvedCampaign
from campaign.worker import experiment_of
from reports.crater_figures import example_figure
from reports.named_figure import NamedFigure
from reports.run_data import read_run, select

_EXAMPLES = 2


def crater_examples(campaign: ResolvedCampaign, folder: Path) -> Iterator[NamedFigure]:
    """Draw, for each scenario and detector, the images with the most detectable craters, as figures 2 and 3 do."""
    run = read_run(folder)
    for scenario, images in run.crater_images.groupby("scenario", sort=False):
        richest = images.sort_values(["n_detectable", "trial"], ascending=[False, True])["trial"].head(_EXAMPLES)
        experiment = experiment_of(campaign, str(scenario), Bench(folder, 0, keep_images=False))
        if not isinstance(experiment, CraterDetection):
            continue
        for trial in (int(trial) for trial in richest):
            _, frame, _ = experiment.see(trial)
            for label in campaign.labels:
                rows = select(run.rows, str(scenario), label)
                if (rows.loc[rows["trial"] == trial, "status"] == "ok").any():
                    yield example_figure(run, str(scenario), label, trial, frame.image)

"""Images of a stored run of crater detection with what was there and what was found, made again from their seeds."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from campaign.experiments.crater_detection import CraterDetection
from campaign.experiments.registry import Bench
from campaign.resolve import ResolvedCampaign
from campaign.worker import experiment_of
from estimators.craters.detection.classic import CraterClassic
from reports.crater_figures import example_figure, stages_figure
from reports.named_figure import NamedFigure
from reports.run_data import RunData, read_run, select

_EXAMPLES = 3


def crater_examples(campaign: ResolvedCampaign, folder: Path) -> Iterator[NamedFigure]:
    """Draw the stages of the classic detector, figure 2 of the paper, and what each finds in some images, figure 3."""
    run = read_run(folder)
    for scenario in campaign.scenarios:
        for label in campaign.labels:
            yield from stages_of(campaign, folder, run, scenario.spec.name, label)
        yield from detected(campaign, folder, run, scenario.spec.name, campaign.labels)


def detected(
    campaign: ResolvedCampaign, folder: Path, run: RunData, scenario: str, labels: tuple[str, ...]
) -> Iterator[NamedFigure]:
    """Draw the images of a scenario with the most detectable craters, once for each detector."""
    experiment = _opened(campaign, folder, scenario)
    for trial in _richest(run, scenario):
        _, frame, _ = experiment.of(trial).see(trial)
        for label in labels:
            rows = select(run.rows, scenario, label)
            if (rows.loc[rows["trial"] == trial, "status"] == "ok").any():
                yield example_figure(run, scenario, label, trial, frame.image)


def stages_of(
    campaign: ResolvedCampaign, folder: Path, run: RunData, scenario: str, label: str
) -> Iterator[NamedFigure]:
    """Draw what each stage of the classic detector finds in the image with the most detectable craters."""
    experiment = _opened(campaign, folder, scenario)
    detector = experiment.detectors[label]
    if not isinstance(detector, CraterClassic):
        return
    for trial in _richest(run, scenario)[:1]:
        _, frame, camera = experiment.of(trial).see(trial)
        stages = detector.stages(frame, camera)
        arcs = {"shaded": [a.uv_px for a in stages.shaded], "lit": [a.uv_px for a in stages.lit]}
        small, large = stages.edges
        what = f"{scenario}, {label}, image {trial}"
        yield stages_figure(frame.image, small.mask | large.mask, arcs, stages.detections.ellipses, what)


def _opened(campaign: ResolvedCampaign, folder: Path, scenario: str) -> CraterDetection:
    experiment = experiment_of(campaign, scenario, Bench(folder, 0, keep_images=False))
    if not isinstance(experiment, CraterDetection):
        raise TypeError(f"{folder} holds a run of {type(experiment).__name__}, not of {CraterDetection.__name__}")
    return experiment


def _richest(run: RunData, scenario: str) -> list[int]:
    images = run.crater_images[run.crater_images["scenario"] == scenario]
    ordered = images.sort_values(["n_detectable", "trial"], ascending=[False, True])
    return [int(trial) for trial in ordered["trial"].head(_EXAMPLES)]

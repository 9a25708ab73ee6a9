"""Images of a stored run of crater detection with what was there and what was found, made again from their seeds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from campaign.inspection.case import Case
from campaign.inspection.recompute import recompute
from campaign.kinds.crater_detection.trial import CraterDetection, DetectedImage
from campaign.resolved import ResolvedCampaign
from campaign.store import RunFolder
from campaign.trial.in_turn import part_of
from estimators.craters.detection.classic import CraterClassic
from reports.kinds.crater_detection.figures import example_figure, stages_figure
from reports.run.data import RunData, read_run
from reports.schema.named_figure import NamedFigure

_EXAMPLES = 3


def crater_examples(campaign: ResolvedCampaign, folder: RunFolder) -> Iterator[NamedFigure]:
    """Draw the stages of the classic detector, figure 2 of the paper, and what each finds in some images, figure 3."""
    run = read_run(folder.path)
    for scenario in campaign.scenarios:
        for label in campaign.labels:
            yield from stages_of(campaign, folder, run, scenario.spec.name, label)
        yield from detected(campaign, folder, run, scenario.spec.name, campaign.labels)


def detected(
    campaign: ResolvedCampaign, folder: RunFolder, run: RunData, scenario: str, labels: Sequence[str]
) -> Iterator[NamedFigure]:
    """Draw the images of a scenario with the most detectable craters, once for each detector."""
    for trial in _richest(run, scenario):
        rows = run.rows[
            (run.rows["scenario"] == scenario) & (run.rows["trial"] == trial) & (run.rows["status"] == "ok")
        ]
        done = [label for label in labels if label in set(rows["estimator"])]
        # All detectors see the same image, so one of them is run again for it.
        shown = recompute(campaign, folder, Case(scenario, done[0], trial)).shown if done else None
        if isinstance(shown, DetectedImage):
            for label in done:
                yield example_figure(run, scenario, label, trial, shown.frame.image)


def stages_of(
    campaign: ResolvedCampaign, folder: RunFolder, run: RunData, scenario: str, label: str
) -> Iterator[NamedFigure]:
    """Draw what each stage of the classic detector finds in the image with the most detectable craters."""
    if next(e.name for e in campaign.spec.estimators if e.label == label) != CraterClassic.name:
        return
    for trial in _richest(run, scenario)[:1]:
        again = recompute(campaign, folder, Case(scenario, label, trial))
        shown, trials = again.shown, part_of(again.trials, CraterDetection, trial)
        detector = None if trials is None else trials.detectors[label]
        if not isinstance(shown, DetectedImage) or not isinstance(detector, CraterClassic):
            return
        stages = detector.stages(shown.frame, shown.camera)
        arcs = {"shaded": [a.uv_px for a in stages.shaded], "lit": [a.uv_px for a in stages.lit]}
        small, large = stages.edges
        what = f"{scenario}, {label}, image {trial}"
        yield stages_figure(shown.frame.image, small.mask | large.mask, arcs, stages.detections.ellipses, what)


def _richest(run: RunData, scenario: str) -> list[int]:
    images = run.table("crater_images")[run.table("crater_images")["scenario"] == scenario]
    ordered = images.sort_values(["n_detectable", "trial"], ascending=[False, True])
    return [int(trial) for trial in ordered["trial"].head(_EXAMPLES)]

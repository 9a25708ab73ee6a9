"""The displays of crater detection."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import cast

import numpy as np
import pandas as pd

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
from boresight.campaign.kinds.crater_detection import CraterDetection, DetectedImage
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.store import RunFolder
from boresight.estimators.craters.detection.classic import CraterClassic
from boresight.reports.compare.trials import missed_or_wrong
from boresight.reports.figures.crater_examples import draw_example, ellipses_of, example_figure, stages_figure
from boresight.reports.figures.named import NamedFigure
from boresight.reports.pages.view3d import View3D
from boresight.reports.run.data import RunData, read_run
from boresight.scenarios.craters.simulated import NO_CRATER
from boresight.scenarios.errors import BoresightError

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
        if shown is not None:
            for label in done:
                yield example_figure(run, scenario, label, trial, shown.observation.frame.image)


def stages_of(
    campaign: ResolvedCampaign, folder: RunFolder, run: RunData, scenario: str, label: str
) -> Iterator[NamedFigure]:
    """Draw what each stage of the classic detector finds in the image with the most detectable craters."""
    if next(e.name for e in campaign.spec.estimators if e.label == label) != CraterClassic.name:
        return
    for trial in _richest(run, scenario)[:1]:
        again = recompute(campaign, folder, Case(scenario, label, trial))
        shown, detector = again.shown, again.trials.methods[label]
        if shown is None or not isinstance(detector, CraterClassic):
            return
        stages = detector.stages(shown.observation.frame, shown.observation.camera)
        arcs = {"shaded": [a.uv_px for a in stages.shaded], "lit": [a.uv_px for a in stages.lit]}
        small, large = stages.edges
        what = f"{scenario}, {label}, image {trial}"
        yield stages_figure(
            shown.observation.frame.image, small.mask | large.mask, arcs, stages.detections.ellipses, what
        )


def _richest(run: RunData, scenario: str) -> list[int]:
    images = run.table("crater_images")[run.table("crater_images")["scenario"] == scenario]
    ordered = images.sort_values(["n_detectable", "trial"], ascending=[False, True])
    return [int(trial) for trial in ordered["trial"].head(_EXAMPLES)]


def look_at_detections(scene: EstimatorRun) -> View3D:
    """Show the craters by how often they are detected when they could be, and the cameras of all images.

    Of several worlds the first is shown.
    """
    run, experiment = scene.run, cast("CraterDetection", scene.opened())
    rows = run.of(scene.scenario, scene.label)
    rows = rows[rows["trial"] % scene.campaign.spec.databases == 0]
    ground = experiment.world.ground
    if ground is None:
        raise BoresightError(f"{run.folder}: --look: the scenario {scene.scenario} has no craters")
    there = run.table("craters")[
        (run.table("craters")["scenario"] == scene.scenario) & run.table("craters")["detectable"].astype(bool)
    ]
    there = there[there["trial"].isin(rows["trial"])]
    found = run.of(scene.scenario, scene.label, "detections")
    found = found[found["trial"].isin(rows["trial"])]
    found = found[found["kept"].astype(bool) & found["detectable"].astype(bool) & (found["crater"] >= 0)]
    chances = there.groupby("crater").size()
    hits = found.groupby("crater").size().reindex(chances.index).fillna(0)
    outcomes = pd.DataFrame({"chances": chances, "hits": hits})
    places = places_of(ground.rims.centre_m, ground.rims.crater, outcomes)
    marks = [outcome_marks(places, outcomes, ("detected when detectable", "detectable", "detected"))]
    views = {
        int(trial): experiment.world.source.view(experiment.seed, int(trial)).T_cam_body.camera_position_m[None]
        for trial in rows["trial"]
    }
    return crater_look(
        scene, rows, marks, experiment.world.body.mesh, (views, "missed or false craters", missed_or_wrong(run))
    )


def draw_detection(again: Recomputed) -> CaseFigures:
    """Draw an image with the craters that are there and those that were found."""
    shown: DetectedImage = again.shown
    truth = shown.truth
    detections = [record for record in again.records.get("detections", []) if record["kept"]]
    matched = np.array([int(str(record["crater"])) != NO_CRATER for record in detections], dtype=np.bool_)
    figure = draw_example(
        shown.observation.frame.image,
        (truth.ellipses, truth.detectable),
        (ellipses_of(detections), matched),
        "craters",
        str(again.case),
    )
    missed = int(truth.detectable.sum()) - sum(bool(record["detectable"]) for record in detections)
    note = f"{int(truth.detectable.sum())} detectable craters, {missed} of them missed; {int((~matched).sum())} of"
    return CaseFigures(
        [figure], notes=[f"{note} {len(detections)} detections are of no crater, or of one found before."]
    )


def kept(shown: DetectedImage) -> CaseFiles:
    """Return the image that a detector saw."""
    return CaseFiles({"image": shown.observation.frame.image})


SHOW = Show(draw=draw_detection, kept=kept, look=look_at_detections, examples=crater_examples)

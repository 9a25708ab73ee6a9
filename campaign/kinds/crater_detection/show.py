"""The displays of crater detection."""

from __future__ import annotations

import numpy as np
import pandas as pd

from campaign.inspection.case import crater_faults
from campaign.inspection.look import crater_look, outcome_marks, places_of
from campaign.inspection.recompute import Recomputed
from campaign.inspection.show import CaseFigures, CaseFiles, EstimatorRun, Show
from campaign.kinds.crater_detection.examples import crater_examples
from campaign.kinds.crater_detection.trial import CraterDetection, DetectedImage
from reports.kinds.crater_detection.figures import draw_example, ellipses_of
from reports.pages.view3d import View3D
from reports.run.data import select
from scenarios.craters.simulated import NO_CRATER
from scenarios.errors import BoresightError


def look_at_detections(scene: EstimatorRun) -> View3D:
    """Show the craters by how often they are detected when they could be, and the cameras of all images.

    Of several worlds the first is shown.
    """
    experiment, run = scene.opened(CraterDetection), scene.run
    rows = select(run.rows, scene.scenario, scene.label)
    rows = rows[rows["trial"] % scene.campaign.spec.databases == 0]
    ground = experiment.world.ground
    if ground is None:
        raise BoresightError(f"{run.folder}: --look: the scenario {scene.scenario} has no craters")
    there = run.table("craters")[
        (run.table("craters")["scenario"] == scene.scenario) & run.table("craters")["detectable"].astype(bool)
    ]
    there = there[there["trial"].isin(rows["trial"])]
    found = select(run.table("detections"), scene.scenario, scene.label)
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
        scene, rows, marks, experiment.world.body.mesh, (views, "missed or false craters", crater_faults(run))
    )


def draw_detection(again: Recomputed) -> CaseFigures | None:
    """Draw an image with the craters that are there and those that were found."""
    shown, what = again.shown, str(again.case)
    if not isinstance(shown, DetectedImage):
        return None
    truth = shown.truth
    detections = [record for record in again.records.get("detections", []) if record["kept"]]
    matched = np.array([int(str(record["crater"])) != NO_CRATER for record in detections], dtype=np.bool_)
    figure = draw_example(
        shown.frame.image, (truth.ellipses, truth.detectable), (ellipses_of(detections), matched), "craters", what
    )
    missed = int(truth.detectable.sum()) - sum(bool(record["detectable"]) for record in detections)
    note = f"{int(truth.detectable.sum())} detectable craters, {missed} of them missed; {int((~matched).sum())} of"
    return CaseFigures(
        [figure], notes=[f"{note} {len(detections)} detections are of no crater, or of one found before."]
    )


def kept(shown: object) -> CaseFiles:
    """Return the image that a detector saw."""
    return CaseFiles({"image": shown.frame.image}) if isinstance(shown, DetectedImage) else CaseFiles()


SHOW = Show(draw=draw_detection, kept=kept, look=look_at_detections, examples=crater_examples)

"""A look at crater detection: how often each crater is detected, and the cameras of good and bad images."""

from __future__ import annotations

import pandas as pd

from campaign.inspection.crater_look import crater_look, outcome_marks, places_of
from campaign.inspection.ranking import crater_faults
from campaign.inspection.show import Scene
from campaign.kinds.crater_detection.trial import CraterDetection
from reports.pages.look import Look
from reports.run.data import select
from scenarios.errors import BoresightError


def look_at_detections(scene: Scene) -> Look:
    """Show the craters by how often they are detected when they could be, and the cameras of all images.

    Of several worlds the first is shown.
    """
    experiment, run = scene.opened(CraterDetection), scene.run
    rows = select(run.rows, scene.scenario, scene.label)
    rows = rows[rows["trial"] % scene.campaign.spec.databases == 0]
    ground = experiment.world.ground
    if ground is None:
        raise BoresightError(f"{run.folder}: --look: the scenario {scene.scenario} has no craters")
    there = run.craters[(run.craters["scenario"] == scene.scenario) & run.craters["detectable"].astype(bool)]
    there = there[there["trial"].isin(rows["trial"])]
    found = select(run.detections, scene.scenario, scene.label)
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

"""A look at sequences: the trajectories of the middle and of the worst trial, and landmarks by their errors."""

from __future__ import annotations

import numpy as np

from campaign.inspection.case import Case
from campaign.inspection.coarse import coarsened
from campaign.inspection.look_parts import MOST_FACES, middle_and_worst
from campaign.inspection.recompute import recompute
from campaign.inspection.show import Scene
from campaign.kinds.sequence.draw import last_seen
from campaign.kinds.sequence.trial import FollowedSequence, SequenceTrials
from campaign.resolved import ResolvedCampaign
from reports.pages.look import TRUE, Cameras, Look, Marks
from scenarios.bodies import load_body
from scenarios.bodies.embedded import sphere
from scenarios.errors import BoresightError
from scenarios.geometry import TriangleMesh
from scenarios.sequences import MeshGround


def look_at_sequences(scene: Scene) -> Look:
    """Show the trial in the middle and the worst one, in the axes that the body has at each frame."""
    marks, cameras, ground = [], [], None
    for name, colour, case in middle_and_worst(scene):
        again = recompute(scene.campaign, scene.folder, case)
        if not isinstance(again.shown, FollowedSequence) or not isinstance(again.trials, SequenceTrials):
            continue
        ground = again.trials.ground
        marks += _track_marks(again.shown, name)
        cameras += _paths(again.shown, case, name, colour)
    if ground is None:
        raise BoresightError(f"{scene.folder.path}: no trial of {scene.title} has a sequence to look at")
    body = coarsened(
        _mesh_of(scene.campaign, scene.scenario, isinstance(ground, MeshGround), ground.reach_m), MOST_FACES
    )
    note = "The trial of median error and the worst one; a landmark stands where it truly is."
    return Look(scene.title, note, body.vertices_m, body.faces, marks, cameras)


def _mesh_of(campaign: ResolvedCampaign, scenario: str, meshed: bool, radius_m: float) -> TriangleMesh:
    if meshed:
        loaded = campaign.scenario(scenario)
        return load_body(loaded.spec.body, loaded.search_dirs).mesh
    ball = sphere()
    return TriangleMesh(ball.vertices_m * (radius_m / ball.radius_m), ball.faces)


def _track_marks(shown: FollowedSequence, name: str) -> list[Marks]:
    if shown.estimate is None:
        return []
    truth = shown.seen.truth
    ends = last_seen(shown.estimate, shown.seen.sequence, truth)
    tracks = list(ends)
    errors = np.array([float(np.linalg.norm(ends[track][0])) for track in tracks])
    texts = [
        f"track {t}<br>error {e:.3g} m<br>seen in {ends[t][1]} frames" for t, e in zip(tracks, errors, strict=True)
    ]
    return [Marks(f"landmark error, {name} trial", truth.points_m[tracks].reshape(-1, 3), errors, texts, "m")]


def _paths(shown: FollowedSequence, case: Case, name: str, colour: str) -> list[Cameras]:
    frames = () if shown.estimate is None else shown.estimate.frames
    true = np.array([pose.camera_position_m for pose in shown.seen.truth.poses])
    estimated = np.array([frame.position_m for frame in frames]).reshape(-1, 3)
    errors = np.linalg.norm(estimated - true[: len(estimated)], axis=1)
    texts = [f"trial {case.trial}, frame {i}<br>{error:.3g} m from the truth" for i, error in enumerate(errors)]
    truth = Cameras(f"truth, {name} trial", TRUE, true, [f"frame {i}" for i in range(len(true))], joined=True)
    return [truth, Cameras(f"estimate, {name} trial", colour, estimated, texts, joined=True)]

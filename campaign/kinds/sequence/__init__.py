"""Kind of trial: a camera followed by the tracks of a vision layer, every frame scored."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Self

import numpy as np

from boresight.campaign.handles import own_copy
from boresight.campaign.imaging.real_images import open_tracks
from boresight.campaign.imaging.world import check_outside
from boresight.campaign.kinds.sequence.images import OrbitImages, Seen, Watch
from boresight.campaign.kinds.sequence.score import check_sequence, parameter_errors, score_epochs, summary
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.trial.kind import InspectedTrial, Prediction, Record, Records, WorkerContext
from boresight.campaign.trial.runner import MethodRunner
from boresight.campaign.trial.unused import LENS, OF_IMAGES, OF_OBSERVATIONS, SUN_OF_VIEWS
from boresight.estimators.registry import sequence_estimator_class
from boresight.estimators.slam.contract import SequenceEstimate, SequenceEstimator
from boresight.scenarios.bodies import load_body
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.observation import TrackSequence
from boresight.scenarios.sequences import (
    CameraTrajectory,
    LandmarkGround,
    MeshGround,
    OrbitLostError,
    SequenceTruth,
    SphereGround,
    TrackTable,
    draw_real_sequence,
    draw_sequence,
    nominal_trajectory,
)
from boresight.scenarios.spec.scenario import ScenarioSpec
from boresight.scenarios.spec.sequence import SequenceSpec

FollowedSequence = InspectedTrial[SequenceTruth, TrackSequence, SequenceEstimate]
"""A trial of one estimator, for inspection."""


@dataclass(frozen=True, eq=False)
class SequenceTrials(MethodRunner[SequenceEstimator, Seen | Watch, SequenceEstimate]):
    """Trials of estimators of sequences; all see the same tracks, unless an estimator guides the vision layer.

    ``camera`` is an ideal pinhole: tracks come after the correction of a lens. Landmarks lie on ``ground``. ``images``
    is the vision layer that sees images, and ``table`` has real tracks; both are None where tracks are simulated.
    """

    name = "sequence"
    version = 5
    block_trials = 5

    spec: SequenceSpec
    camera: Camera
    ground: LandmarkGround
    images: OrbitImages | None = None
    table: TrackTable | None = None

    @classmethod
    def method_class(cls, name: str) -> type[SequenceEstimator]:
        return sequence_estimator_class(name)

    @classmethod
    def check_scenario(cls, scenario: LoadedScenario) -> None:
        """Refuse a missing section, a way that leads into the body by known forces, and one that shows none of it."""
        section, ground, table = _section(scenario), ground_of(scenario), open_tracks(scenario)
        flown = table or section.trajectory
        if flown is not None and isinstance(ground, MeshGround):
            check_outside(scenario, ground.mesh, flown.states, "sequence")
        if table is not None:
            return  # what the camera saw has been seen
        try:
            views = nominal_trajectory(section, ground).views(scenario.spec.camera.camera().pinhole)
        except OrbitLostError as error:
            raise BoresightError(f"{scenario.path}: sequence.orbit: {error}") from error
        if not any(view.may_show(ground.reach_m) for view in views):
            raise BoresightError(
                f"{scenario.path}: sequence: nothing of the body is in the frame in all {len(views)} frames: check"
                " camera.principal_point_px, and the attitudes of a trajectory"
            )

    @classmethod
    def unused(cls, spec: ScenarioSpec) -> tuple[str, ...]:
        section = spec.sequence
        if section is not None and section.images is not None:
            return (*SUN_OF_VIEWS, *OF_OBSERVATIONS)
        body = () if section is None or section.sphere_radius_m is None else ("body",)
        return (*OF_IMAGES, *OF_OBSERVATIONS, *LENS, *body)

    @classmethod
    def open(
        cls, campaign: ResolvedCampaign, scenario: LoadedScenario, context: WorkerContext, number: int = 0
    ) -> Self:
        """Lay the ground and build the estimators."""
        section, ground, images = _section(scenario), ground_of(scenario), None
        if section.images is not None:
            images = OrbitImages.open(scenario, campaign.variant, campaign.seed)
        camera = scenario.spec.camera.camera().pinhole
        own = {"spec": section, "camera": camera, "ground": ground, "images": images, "table": open_tracks(scenario)}
        return cls.made(campaign, scenario, number, **own)

    def flush(self) -> None:
        if self.images is not None:
            self.images.flush()

    def draw(self, trial: int) -> Seen | Watch:
        """Draw a path and its tracks, simulated, of images or of a file; chance may lead it into the body."""
        if self.images is not None:
            watch = Watch(self.images, self.seed, trial)
            # A vision layer that is guided makes its frames while an estimator follows them.
            if not self.images.spec.guided:
                return watch.whole()
            watch.expose()
            return watch
        return Seen(*self._drawn(trial), vision=[], seconds={})

    def _drawn(self, trial: int) -> tuple[SequenceTruth, TrackSequence]:
        """Draw simulated tracks, or those of a file that are followed."""
        if self.table is not None and isinstance(self.ground, MeshGround):
            return draw_real_sequence(self.spec, self.table, self.camera, self.ground, (self.seed, trial))
        return draw_sequence(self.spec, self.camera, self.ground, self.seed, trial)

    def given(self, drawn: Seen | Watch, label: str) -> Seen | Watch:
        """Return the tracks; where an estimator guides the vision layer, a vision layer of its own."""
        return drawn if isinstance(drawn, Seen) else drawn.anew()

    def predictors(self, trial: int) -> Mapping[str, Prediction]:
        """Draw the geometry of a trial's simulated tracks; none for tracks of images or of a file.

        None either if chance leads the orbit into the body.
        """
        if self.images is not None or self.table is not None:
            return {}
        try:
            truth, sequence = self._drawn(trial)
        except OrbitLostError:
            return {}
        positions_m = np.array([pose.camera_position_m for pose in truth.poses])

        def predict(method: Any) -> Mapping[str, float] | None:
            covariance = method.predict(sequence, positions_m, truth.points_m)
            return None if covariance is None else {"position_m": float(np.sqrt(np.trace(covariance)))}

        return {label: partial(predict, one) for label, one in self.methods.items() if hasattr(one, "predict")}

    def row(self, drawn: Seen | Watch) -> Record:
        return {"range_m": float(np.linalg.norm(drawn.path.poses[-1].translation_m))}

    def ask(self, method: SequenceEstimator, drawn: Seen | Watch) -> SequenceEstimate:
        """Let an estimator follow the camera."""
        return method.follow(own_copy(drawn.sequence))

    def check(self, answer: SequenceEstimate, drawn: Seen | Watch) -> None:
        check_sequence(answer, drawn.seen().sequence)

    def score(self, answer: SequenceEstimate, drawn: Seen | Watch) -> Records:
        """Score every frame, and sum the trial up."""
        seen = drawn.seen()
        epochs = score_epochs(answer, seen.sequence, seen.truth)
        row: Record = {
            **summary(answer, seen.sequence, seen.truth, epochs),
            "status": answer.status,
            "reason": answer.reason,
            "n_landmarks": epochs[-1]["n_landmarks"] if epochs else 0,
        }
        if answer.status == "ok":
            row["position_error_m"] = epochs[-1]["position_error_m"]
        # As in the summary: the first frames of an estimate that failed are the quick ones of a window that is filling.
        seconds = [frame.seconds for frame in answer.frames if answer.status == "ok"]
        numbers = {**answer.diagnostics, **parameter_errors(answer, seen.truth)}
        return {
            "rows": [row],
            "epochs": epochs,
            "diagnostics": [{"name": str(name), "value": float(value)} for name, value in numbers.items()],
            "timings": [{"stage": "cycle", "seconds": float(np.mean(seconds))}] if seconds else [],
        }

    def of_all(self, drawn: Seen | Watch) -> Records:
        seen = drawn.seen()
        timings: list[Record] = [{"stage": stage, "seconds": seconds} for stage, seconds in seen.seconds.items()]
        return {"vision": list(seen.vision), "timings": timings}

    def shown(self, answer: SequenceEstimate | None, drawn: Seen | Watch) -> FollowedSequence:
        return InspectedTrial(drawn.seen().truth, drawn.seen().sequence, answer)

    def known(self, trial: int) -> tuple[CameraTrajectory, TrackSequence]:
        """Draw the motion of a trial and what the spacecraft knows of it; no image is looked at.

        Raise `OrbitLostError` if chance leads the orbit into the body.
        """
        if self.images is not None:
            watch = Watch(self.images, self.seed, trial)
            return watch.path, watch.sequence
        truth, sequence = self._drawn(trial)
        return truth.trajectory, sequence


def _section(scenario: LoadedScenario) -> SequenceSpec:
    if scenario.spec.sequence is None:
        raise BoresightError(f"{scenario.path}: sequence: missing, but the experiment sequence needs it")
    return scenario.spec.sequence


def ground_of(scenario: LoadedScenario) -> LandmarkGround:
    """Take the ideal sphere, or the scenario's body; refuse an orbit that begins in it."""
    section = _section(scenario)
    if section.sphere_radius_m is not None:
        return SphereGround(section.sphere_radius_m)
    mesh = load_body(scenario.spec.body, scenario.search_dirs).mesh
    if section.trajectory is None and section.tracks is None and section.orbit.radius_m <= mesh.radius_m:
        raise BoresightError(
            f"{scenario.path}: sequence.orbit.radius_m: {section.orbit.radius_m:g} m is not above the body, which"
            f" reaches {mesh.radius_m:.6g} m from its origin: choose a larger radius"
        )
    return MeshGround(mesh)


KIND = SequenceTrials

"""The sequence experiment: follow a camera along an orbit by the tracks of a vision layer, score every frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Self

import numpy as np

from boresight.campaign.handles import own_copy
from boresight.campaign.kinds.sequence.images import OrbitImages
from boresight.campaign.kinds.sequence.score import (
    check_sequence,
    parameter_errors,
    score_epochs,
    summary,
)
from boresight.campaign.kinds.sequence.tracks import ImageTracks, Seen, Watch
from boresight.campaign.pool.guard import Call
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.trial.kind import Record, Records, Witness, WorkerContext, add_records, each_trial
from boresight.campaign.trial.methods import Unbuilt, methods, require_built
from boresight.campaign.trial.work import Work
from boresight.estimators.slam.contract import SequenceEstimate, SequenceEstimator
from boresight.estimators.slam.registry import sequence_estimator_class
from boresight.scenarios.bodies import load_body
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.sequences import (
    CameraTrajectory,
    LandmarkGround,
    MeshGround,
    OrbitLostError,
    SequenceTruth,
    SphereGround,
    draw_sequence,
    nominal_trajectory,
)
from boresight.scenarios.spec.sequence import SequenceSpec
from boresight.scenarios.tracks import TrackSequence


@dataclass(frozen=True, slots=True, eq=False)
class FollowedSequence:
    """A trial of one estimator as a witness is shown it; ``estimate`` is None where the estimator raised."""

    seen: Seen
    estimate: SequenceEstimate | None

    @property
    def image(self) -> None:
        """None: a method sees tracks."""

    @property
    def truth(self) -> SequenceTruth:
        """True motion, landmarks and tracks."""
        return self.seen.truth

    @property
    def observation(self) -> TrackSequence:
        """Input of the method."""
        return self.seen.sequence


@dataclass(frozen=True, eq=False)
class SequenceTrials:
    """Trials of one scenario with a set of labelled estimators of sequences; all see the same tracks.

    Parameters
    ----------
    name
        Of the scenario.
    spec
        Its sequence section.
    camera
        An ideal pinhole: tracks come after the correction of a lens.
    ground
        What the landmarks lie on.
    estimators
        Label to estimator; of one that cannot be built, why.
    seed
        Seed of the campaign.
    images
        The vision layer that sees images; None where it is simulated.
    witness
        Shown the `FollowedSequence` of every trial and estimator; or None.
    """

    name: str
    spec: SequenceSpec
    camera: Camera
    ground: LandmarkGround
    estimators: Mapping[str, SequenceEstimator | Unbuilt]
    seed: int
    images: ImageTracks | None = None
    witness: Witness | None = None

    @classmethod
    def method_version(cls, name: str) -> int:
        """Return the version of an estimator of sequences."""
        return sequence_estimator_class(name).version

    @classmethod
    def check_scenario(cls, scenario: LoadedScenario) -> None:
        """Refuse a missing section, and an orbit that leads into the body by known forces."""
        section, ground = _section(scenario), ground_of(scenario)
        if section.orbit.model == "propagated":
            try:
                nominal_trajectory(section, ground)
            except OrbitLostError as error:
                raise BoresightError(f"{scenario.path}: sequence.orbit: {error}") from error

    @classmethod
    def methods(cls, campaign: ResolvedCampaign, scenario: LoadedScenario) -> dict[str, SequenceEstimator | Unbuilt]:
        """Build the estimators; refuse wrong options."""
        return methods(
            campaign, scenario, lambda entry: sequence_estimator_class(entry.name).from_options(entry.options)
        )

    @classmethod
    def open(cls, campaign: ResolvedCampaign, scenario: LoadedScenario, context: WorkerContext) -> SequenceTrials:
        """Lay the ground and build the estimators."""
        del context
        section = _section(scenario)
        camera = scenario.spec.camera.camera().pinhole
        name = scenario.spec.name
        ground, images = ground_of(scenario), None
        if section.images is not None:
            images = ImageTracks(section, ground, OrbitImages.open(scenario, campaign.variant, campaign.seed))
        return cls(name, section, camera, ground, cls.methods(campaign, scenario), campaign.seed, images)

    def watched(self, label: str, witness: Witness) -> Self:
        """Return the same trials of one estimator, shown to a witness."""
        return replace(self, estimators={label: self.estimators[label]}, witness=witness)

    def run(self, trials: range) -> Records:
        """Run trials, in the order of trials and estimators."""
        records = each_trial(trials, self.name, self._run)
        if self.images is not None:
            self.images.images.flush()
        return records

    def _run(self, trial: int) -> dict[str, Records]:
        """Run a trial: the records of each estimator; where chance leads the orbit into the body, none has frames."""
        try:
            seen = self._see(trial)
        except OrbitLostError as error:
            failed: Record = {"status": "failed", "reason": f"there is no such trial: {error}", "n_landmarks": 0}
            row = {**_circumstances(None), **failed}
            return {label: {"rows": [row]} for label in self.estimators}
        found = {}
        for label, estimator in self.estimators.items():
            guided = self.images is not None and self.images.guided
            watch = self.images.watch(self.seed, trial) if self.images is not None and guided else None
            found[label] = self._judged(Call(self.name, trial, label), estimator, seen if watch is None else watch)
            add_records(found[label], _vision(seen if watch is None else watch.seen()))
        return found

    def _judged(self, call: Call, estimator: SequenceEstimator | Unbuilt, view: Seen | Watch) -> Records:
        """Let an estimator follow and score what it returns: records without their key, whatever goes wrong."""
        circumstances = _circumstances(view.path)
        # What a watch has seen is complete, and worked out once, when the estimator is done with it.
        seen_by_then = cache(partial(_seen, view))

        def score(estimate: SequenceEstimate) -> Records:
            seen = seen_by_then()
            return _scored(estimate, seen.sequence, seen.truth, circumstances)

        def show(estimate: SequenceEstimate | None) -> None:
            if self.witness is not None:
                self.witness(FollowedSequence(seen_by_then(), estimate))

        return Work(call, "estimator", circumstances).run(
            lambda: require_built(estimator).follow(own_copy(view.sequence)),
            lambda estimate: check_sequence(estimate, seen_by_then().sequence),
            score,
            show,
        )

    def known(self, trial: int) -> tuple[CameraTrajectory, TrackSequence]:
        """Draw the motion of a trial and what the spacecraft knows of it; no image is looked at.

        Raises
        ------
        OrbitLostError
            If chance leads the orbit into the body.
        """
        if self.images is not None:
            watch = self.images.watch(self.seed, trial)
            return watch.path, watch.sequence
        truth, sequence = draw_sequence(self.spec, self.camera, self.ground, self.seed, trial)
        return truth.trajectory, sequence

    def _see(self, trial: int) -> Seen:
        if self.images is not None:
            return self.images.see(self.seed, trial)
        return Seen(*draw_sequence(self.spec, self.camera, self.ground, self.seed, trial), vision=[], seconds={})


def _seen(view: Seen | Watch) -> Seen:
    return view if isinstance(view, Seen) else view.seen()


def _vision(seen: Seen) -> Records:
    """Tell what the vision layer was like, where it saw images: records without their key."""
    timings: list[Record] = [{"stage": stage, "seconds": seconds} for stage, seconds in seen.seconds.items()]
    return {"vision": list(seen.vision), "timings": timings}


def _scored(
    estimate: SequenceEstimate, sequence: TrackSequence, truth: SequenceTruth, circumstances: Record
) -> Records:
    epochs = score_epochs(estimate, sequence, truth)
    row: Record = {
        **circumstances,
        **summary(estimate, sequence, truth, epochs),
        "status": estimate.status,
        "reason": estimate.reason,
        "n_landmarks": epochs[-1]["n_landmarks"] if epochs else 0,
    }
    if estimate.status == "ok":
        row["position_error_m"] = epochs[-1]["position_error_m"]
    # As in the summary: the first frames of an estimate that failed are the quick ones of a window that is filling.
    seconds = [frame.seconds for frame in estimate.frames if estimate.status == "ok"]
    return {
        "rows": [row],
        "epochs": epochs,
        "diagnostics": [
            {"name": str(name), "value": float(v)}
            for name, v in {**estimate.diagnostics, **parameter_errors(estimate, truth)}.items()
        ],
        "timings": [{"stage": "cycle", "seconds": float(np.mean(seconds))}] if seconds else [],
    }


def _circumstances(path: CameraTrajectory | None) -> Record:
    """Fill the columns of a row that no estimator can change, or that a sequence has no number for."""
    return {
        "image": "",
        "range_m": None if path is None else float(np.linalg.norm(path.poses[-1].translation_m)),
    }


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
    if section.orbit.radius_m <= mesh.radius_m:
        raise BoresightError(
            f"{scenario.path}: sequence.orbit.radius_m: {section.orbit.radius_m:g} m is not above the body, which"
            f" reaches {mesh.radius_m:.6g} m from its origin: choose a larger radius"
        )
    return MeshGround(mesh)

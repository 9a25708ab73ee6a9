"""Kind of trial: the orbit of a spacecraft that comes nearer, from positions that estimators of single images measure.

The camera follows the body, with an error that telemetry reports; all estimators see the same images. Each starts from
the prior of its own orbit by the images before.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Self

import numpy as np
from scipy.spatial.transform import Rotation

from boresight.campaign.handles import own_copy
from boresight.campaign.imaging.image_store import Imager
from boresight.campaign.kinds.orbit_determination import (
    DeterminedOrbit,
    check_orbit,
    checked_orbit_section,
    drawable,
    open_orbit_world,
    scored_orbit,
)
from boresight.campaign.kinds.single_image import ImageMethods
from boresight.campaign.kinds.single_image import check as check_estimate
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.trial.kind import InspectedTrial, Prediction, Record, Records, WorkerContext
from boresight.campaign.trial.runner import GaveUpError, located
from boresight.campaign.trial.unused import LENS, OF_OBSERVATIONS, SUN_OF_VIEWS
from boresight.estimators.contract import Estimator
from boresight.estimators.orbit.batch_filter import BatchFilter
from boresight.estimators.orbit.contract import OrbitEstimate
from boresight.estimators.orbit.fixes import ApproachNavigator, ApproachTask, predict_orbit
from boresight.estimators.registry import estimator_class, fuses_prior, with_bases
from boresight.scenarios.arrays import Image
from boresight.scenarios.draw import Stream, estimator_generator, generator
from boresight.scenarios.dynamics.propagation import OrbitLostError
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, View
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.observation import Observation
from boresight.scenarios.orbits.data import OrbitData
from boresight.scenarios.orbits.draw import OrbitTruth, draw_knowledge, draw_radiometry
from boresight.scenarios.orbits.true_orbit import (
    control_errors,
    epochs_s,
    imaging_of,
    pointed_at,
    propagate_truth,
    true_views,
)
from boresight.scenarios.orbits.world import OrbitWorld
from boresight.scenarios.spec.campaign import EstimatorSpec
from boresight.scenarios.spec.scenario import ScenarioSpec


@dataclass(frozen=True, slots=True, eq=False)
class ApproachDraw:
    """The truth of a trial, for the score alone, and what estimators get: camera, images and a priori knowledge."""

    trial: int
    truth: OrbitTruth
    camera: Camera
    images: tuple[Image, ...]
    task: ApproachTask


@dataclass(frozen=True, slots=True, eq=False)
class ApproachAnswer:
    """The orbit by one estimator, and the data that it rests on."""

    estimate: OrbitEstimate
    data: OrbitData


@dataclass(frozen=True, eq=False)
class ApproachOrbitTrials(ImageMethods[ApproachDraw, ApproachAnswer]):
    """Trials of estimators of single images, each of which feeds a batch filter of its own."""

    name = "approach-orbit"
    version = 3
    block_trials = 2

    world: OrbitWorld
    imager: Imager

    @classmethod
    def method_version(cls, name: str) -> int:
        """Return the version of an estimator with the filter: the sum of both, which only rise."""
        return estimator_class(name).version + BatchFilter.version

    @classmethod
    def check_scenario(cls, scenario: LoadedScenario) -> None:
        """Refuse missing sections, and an orbit that is no approach."""
        section = checked_orbit_section(scenario)
        for name, part in (("imaging", section.imaging), ("arc.approach", section.arc.approach)):
            if part is None:
                raise BoresightError(f"{scenario.path}: orbit.{name}: missing, but the experiment {cls.name} needs it")

    @classmethod
    def unused(cls, spec: ScenarioSpec) -> tuple[str, ...]:
        drawn = ("orbit.sightings", *(f"orbit.imaging.{key}" for key in ("detections", "craters", "errors")))
        return (*SUN_OF_VIEWS, *OF_OBSERVATIONS, *LENS, "craters", *drawn)

    @classmethod
    def build_methods(cls, campaign: ResolvedCampaign, scenario: LoadedScenario) -> Mapping[str, object]:
        """Refuse wrong options, and estimators that may not fuse the prior: it could not be taken out again."""
        found = super().build_methods(campaign, scenario)
        for entry in cls.entries(campaign, scenario):
            with located(campaign, entry.label):
                for name in with_bases(entry.name, entry.options):
                    if not fuses_prior(name):
                        raise BoresightError(
                            f"estimator {name!r} does not say that it fuses the prior (fuses_prior), which {cls.name}"
                            " needs to take the prior out of its estimate: choose centroid, centroid-phase,"
                            " silhouette, limb or approach"
                        )
        return found

    @classmethod
    def open(
        cls, campaign: ResolvedCampaign, scenario: LoadedScenario, context: WorkerContext, number: int = 0
    ) -> Self:
        """Open the world and its camera, and build the estimators."""
        world = open_orbit_world(scenario, campaign.seed, number)
        imager = Imager.open(scenario, campaign.variant, Stream.ORBIT_IMAGES, world.spec.arc, imaging_of(world))
        return cls.opened(campaign, scenario, context, number, world=world, imager=imager)

    def flush(self) -> None:
        self.imager.flush()

    def draw(self, trial: int) -> ApproachDraw:
        """Fly the true orbit and take the images; raise `OrbitLostError` if it leads into the body."""
        truth, views, task = self._flown(trial)
        return ApproachDraw(trial, truth, self.world.camera, self._exposed(views, trial), task)

    @classmethod
    def predicts(cls, entry: EstimatorSpec) -> bool:
        return hasattr(estimator_class(entry.name), "predict_estimate")

    def predictors(self, trial: int) -> Mapping[str, Prediction]:
        """Fly the true orbit of a trial without images; none if it leads into the body."""
        try:
            truth, views, task = self._flown(trial)
        except OrbitLostError:
            return {}
        # The planned orbit is the one that leads through the views.
        task = replace(task, knowledge=replace(task.knowledge, state=truth.states[0]))

        def predict(method: Any) -> Mapping[str, float] | None:
            covariance = predict_orbit(task, BatchFilter(), self.world.camera, views, method.predict_estimate)
            return None if covariance is None else {"position_m": float(np.sqrt(np.trace(covariance[:3, :3])))}

        able = {label: one for label, one in self.methods.items() if hasattr(one, "predict_estimate")}
        return {label: partial(predict, one) for label, one in able.items()}

    def _flown(self, trial: int) -> tuple[OrbitTruth, tuple[View, ...], ApproachTask]:
        """Fly the true orbit: the truth, the views of all images and what is known of them without these."""
        world, times = self.world, epochs_s(self.world)
        flown = propagate_truth(world, times, self.seed, trial)
        errors = Rotation.from_rotvec(control_errors(world, len(times), self.seed, trial)).as_matrix()
        attitudes = errors @ np.stack([pointed_at(state, np.zeros(3)) for state in flown.image_states])
        views = true_views(world, flown, attitudes, self.seed, trial)
        task = ApproachTask(
            times,
            attitudes,
            draw_knowledge(world, flown.wanted_states[0], self.seed, trial),
            world.asteroid.centre_m,
            world.sun_dir,
            draw_radiometry(world, flown, self.seed, trial),
            flown.wanted_s,
        )
        none = np.zeros(0, dtype=np.int64)
        truth = OrbitTruth(
            states=flown.wanted_states,
            image_states=flown.image_states,
            crater=none,
            wrong=none.astype(bool),
            points_body_m=np.zeros((0, 3)),
            gm_m3_s2=world.spec.asteroid.gm_m3_s2,
            light_m_s2=world.light_m_s2,
        )
        return truth, views, task

    def _exposed(self, views: Sequence[View], trial: int) -> tuple[Image, ...]:
        images = []
        for number, view in enumerate(views):
            index = trial * len(views) + number
            image = self.imager.image(view, self.seed, index, generator(self.seed, Stream.DETECTOR, index))[0]
            image.setflags(write=False)
            images.append(image)
        return tuple(images)

    def row(self, drawn: ApproachDraw) -> Record:
        return {"n_landmarks": 0, "range_m": float(np.linalg.norm(drawn.truth.states[0, :3]))}

    def ask(self, method: Estimator, drawn: ApproachDraw) -> ApproachAnswer:
        """Let an estimator measure each image from the prior of its orbit, and the filter determine the orbit."""
        count, navigator = len(drawn.images), ApproachNavigator(drawn.task, BatchFilter())
        random = estimator_generator(self.seed, drawn.trial).spawn(count)
        for number, (image, rng) in enumerate(zip(drawn.images, random, strict=True)):
            frame = navigator.frame(number, image)
            if frame is None:
                raise GaveUpError(f"no orbit is found by the images before image {number + 1} of {count}")
            found = method.estimate(own_copy(Observation(drawn.camera, frame)), rng=rng)
            check_estimate(found)
            navigator.add(number, frame, found)
        return ApproachAnswer(*navigator.result())

    def check(self, answer: ApproachAnswer, drawn: ApproachDraw) -> None:
        check_orbit(answer.estimate, answer.data)

    def score(self, answer: ApproachAnswer, drawn: ApproachDraw) -> Records:
        """Score the orbit."""
        timings: Records = {"timings": [{"stage": "orbit", "seconds": float(answer.estimate.seconds)}]}
        return scored_orbit(answer.estimate, drawn.truth, answer.data, with_residuals=False) | timings

    def shown(self, answer: ApproachAnswer | None, drawn: ApproachDraw) -> DeterminedOrbit | None:
        """Return the orbit by an estimator; None where there is none."""
        if answer is None:
            return None
        return InspectedTrial(drawn.truth, answer.data, drawable(answer.estimate, answer.data))


KIND = ApproachOrbitTrials

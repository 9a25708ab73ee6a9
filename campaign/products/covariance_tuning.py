"""Rehearsals of an estimator, by simulated images or those of a survey, and the factor of its covariance."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain, groupby
from pathlib import Path
from typing import TypeGuard

import numpy as np

from boresight.campaign.imaging.observe import observe
from boresight.campaign.imaging.real_images import open_survey
from boresight.campaign.imaging.world import ImageSetSource, TrialImage, open_world
from boresight.campaign.products.assets import KINDS, BuiltAssets, product_kind
from boresight.campaign.products.databases import ProductKind, map_images
from boresight.estimators.contract import Estimator, NoProductError
from boresight.estimators.landmark.pose.posterior import pose_offset
from boresight.estimators.options import surveyed
from boresight.estimators.registry import estimator_class
from boresight.estimators.tuned import PRODUCT as TUNING
from boresight.estimators.tuned import (
    VERSION,
    CovarianceTuning,
    Rehearsals,
    Rehearsed,
    check_solved,
    fit_tuning,
    phase_rad,
)
from boresight.renderers.detector import Detector
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import MachineError, UndrawableError
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.spec.body import FurtherHeightErrorSpec, RedrawnSpec
from boresight.scenarios.spec.brdf import BrdfSpec
from boresight.scenarios.spec.onboard import DeclaredSpec, OnboardSpec
from boresight.scenarios.spec.scenario import ScenarioSpec

_SEED = 0x7265_6865
"""Added to the seed of rehearsals, so that they do not show the views of a campaign with the same seed."""


def build(scenario: LoadedScenario, options: Rehearsals, folder: Path, jobs: int, variant: str) -> Mapping[str, object]:
    """Rehearse the base of ``options`` and store the factor of its covariance in ``folder``."""
    if scenario.spec.viewpoint is None and scenario.spec.images is None:
        raise NoProductError("its rehearsals need views: give the scenario a viewpoint or images")
    laws, survey = len(_laws(scenario.spec)), _survey(scenario.spec, options)
    if survey:
        if len(survey) == 1:
            raise NoProductError(
                f"images.survey: each image is placed by the others, and {survey[0]} is alone: name two"
            )
        laws, options = 1, options.model_copy(update={"bodies": min(len(survey), options.trials)})
    else:
        _check_declared(scenario.spec, options.bodies)
    with tempfile.TemporaryDirectory() as place:
        # The data bases of the base are made before workers ask for them.
        for number in range(options.bodies):
            _method(rehearsed_scenario(scenario, options, number), options, Path(place) / str(number), jobs, variant)
        # The method takes longer than the image: with the chunks of the image store, few trials would keep few workers.
        most = math.ceil(options.trials / jobs)
        found = map_images(jobs, options.trials, _of_images, scenario, options, variant, Path(place), most_images=most)
    # The surface has one law in all images: the covariance must hold for each.
    shares = [[t for t in range(options.trials) if _number(options, t) % laws == law] for law in range(laws)]
    solved = [[one for one in (found[t] for t in share) if one is not None] for share in shares]
    check_solved(laws * min(map(len, solved)), options.trials, options.base)
    tunings = [fit_tuning(own, len(share)) for own, share in zip(solved, shares, strict=True)]
    tuning = max(tunings, key=lambda one: math.prod(one.factors))
    tuning.save(folder)
    solved_of = f"{tuning.solved} of {tuning.trials}"
    return {"covariance_factors": _factors(tuning), "solved": solved_of, "wrong": tuning.wrong}


def _factors(tuning: CovarianceTuning) -> str:
    """Write the factors at the least and at the largest phase angle."""
    return " to ".join(f"{factor:.4g}" for factor in tuning.factors)


def _number(options: Rehearsals, trial: int) -> int:
    """Return the number of the rehearsed body of a trial."""
    return trial * options.bodies // options.trials


def _declared(spec: ScenarioSpec) -> DeclaredSpec:
    return spec.onboard.declared or DeclaredSpec()


def _laws(spec: ScenarioSpec) -> Sequence[BrdfSpec]:
    return _declared(spec).brdf or (spec.brdf,)


def _check_declared(spec: ScenarioSpec, bodies: int) -> None:
    """Refuse declared errors that the shape on board cannot have, and more reflectances than rehearsed ``bodies``."""
    errors, detail = _declared(spec), spec.body.detail
    if len(_laws(spec)) > bodies:
        raise NoProductError(
            f"onboard.declared.brdf: {len(_laws(spec))} reflectances, and each rehearsed body has one: give the"
            f" estimator at least as many tuning.bodies, not {bodies}"
        )
    if detail is not None and errors.detail is not None:
        raise NoProductError(
            "onboard.declared.detail: the shape on board has detail: declare facets and relief_below_m"
        )
    if detail is None and (errors.facets is not None or errors.relief_below_m is not None):
        raise NoProductError("onboard.declared: the shape on board has no detail: leave facets and relief_below_m out")


def _survey(spec: ScenarioSpec, options: Rehearsals) -> tuple[str, ...]:
    """Name the real images of which the base has landmarks: each is placed by those of the others, as a rehearsal."""
    return spec.images.survey if spec.images is not None and surveyed(options.options) else ()


def _method(scenario: LoadedScenario, options: Rehearsals, folder: Path, jobs: int | None, variant: str) -> Estimator:
    assets = BuiltAssets(scenario, folder, jobs, variant).for_estimator()
    return estimator_class(options.base).from_options(options.options, assets)


def _of_images(
    scenario: LoadedScenario, options: Rehearsals, variant: str, folder: Path, trials: Sequence[int]
) -> list[Rehearsed | None]:
    """Rehearse some trials; None where the base failed, or chance drew no image."""
    found: list[Rehearsed | None] = []
    for number, own in groupby(trials, lambda trial: _number(options, trial)):
        played = rehearsed_scenario(scenario, options, number)
        method = _method(played, options, folder / str(number), None, variant)
        shown = None
        if _survey(scenario.spec, options):
            shown = ImageSetSource(open_survey(scenario), 1).trial_image(0, number)
        found += [_rehearse(method, played, options, variant, trial, shown) for trial in own]
    return found


def _rehearse(
    method: Estimator, played: LoadedScenario, options: Rehearsals, variant: str, trial: int, shown: TrialImage | None
) -> Rehearsed | None:
    """Estimate the pose of a real image that is ``shown``, or of one that is rendered."""
    world, seed = open_world(played, variant), options.seed + _SEED
    try:
        image = world.source.trial_image(seed, trial) if shown is None else shown
    except UndrawableError:
        return None
    observation = observe(world, image, seed, trial)
    try:
        answer = method.estimate(observation, rng=np.random.default_rng((seed, trial)))
    except MachineError:
        raise
    except Exception:  # noqa: BLE001  a method may raise anything; in a campaign that is one row
        return None
    if answer.status != "ok" or answer.pose is None or not _is_covariance(answer.covariance):
        return None
    error = pose_offset(image.view.T_cam_body, answer.pose)
    frame = observation.frame
    # The few images of a survey do not tell how errors follow the phase angle.
    phase = phase_rad(frame) if shown is None else 0.0
    return Rehearsed(error, answer.covariance, frame.prior_covariance, phase)


def _is_covariance(covariance: FloatArray | None) -> TypeGuard[FloatArray]:
    """Tell whether a method gave a (6, 6) covariance that is finite and positive."""
    if covariance is None or covariance.shape != (6, 6) or not np.isfinite(covariance).all():
        return False
    sigmas = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    return bool(np.linalg.eigvalsh(covariance / np.outer(sigmas, sigmas))[0] > 0.0)


def rehearsed_scenario(scenario: LoadedScenario, options: Rehearsals, number: int) -> LoadedScenario:
    """Return the scenario of a rehearsal: a body like the one on board, and what is known of it, with declared errors.

    Where the base has landmarks of a survey, it is the scenario without the survey's image of that ``number``. Else,
    as in flight, the method has the errors and the images have not. Relief is drawn anew with the statistics of that on
    board, which has false relief of its own: images of it would tell the method more than images of the true body do.
    A shape without ``detail`` is taken as it is, with the relief that is declared to lack. Views of real images are
    rendered. Bodies have the declared reflectances in turn. The camera has
    artefacts of the kind and size of the flight camera's, and another pattern of pixels.
    """
    errors, spec, seed = _declared(scenario.spec), scenario.spec, _SEED + options.seed + number
    if spec.images is not None and (survey := _survey(spec, options)):
        others = spec.images.model_copy(update={"survey": survey[:number] + survey[number + 1 :]})
        return replace(scenario, spec=spec.model_copy(update={"images": others}))
    body, heights = spec.body, errors.height_error
    known: dict[str, object] = {}
    if heights is not None:
        heights = heights.model_copy(update={"seed": seed})
    if body.detail is not None:
        like = body.detail.model_copy(update={"seed": seed, "redrawn": None})
        body = body.model_copy(update={"detail": like, "height_error": None})
        if errors.facets is not None:
            finer = like.model_copy(update={"facets": errors.facets})
            body, known["detail"] = body.model_copy(update={"detail": finer}), like
        if errors.relief_below_m is not None:
            small = RedrawnSpec(below_m=errors.relief_below_m, seed=seed + options.bodies)
            known["detail"] = like.model_copy(update={"redrawn": small})
    elif body.height_error is not None and heights is not None:
        heights = FurtherHeightErrorSpec(**dict(heights), on=body.height_error)
    if heights is not None:
        known["height_error"] = heights
    onboard = OnboardSpec(body=body.model_copy(update=known), brdf=spec.brdf, sun_error_deg=errors.sun_error_deg)
    if errors.detail is not None:
        body = body.model_copy(update={"detail": errors.detail.model_copy(update={"seed": seed})})
    law = _laws(spec)[number % len(_laws(spec))]
    changes: dict[str, object] = {"body": body, "brdf": law, "onboard": onboard}
    if spec.images is not None:
        changes["images"] = spec.images.as_rendered()
    if spec.detector is not None and spec.detector.pixels is not None:
        pixels = spec.detector.pixels.model_copy(update={"seed": (spec.detector.pixels.seed + seed) % 2**32})
        changes["detector"] = spec.detector.model_copy(update={"pixels": pixels})
    return replace(scenario, spec=spec.model_copy(update=changes))


def _versions() -> list[int]:
    """Return the versions of the rehearsal, of the detector and of all that a base may ask for."""
    others = [product_kind(kind).versions() for kind in KINDS if kind != TUNING]
    return [VERSION, Detector.version, *chain.from_iterable(others)]


PRODUCTS = {
    TUNING: ProductKind(
        options=Rehearsals,
        versions=_versions,
        announce=lambda options: f"{options.trials} images with {options.base}",
        build=build,
        load=CovarianceTuning.load,
        about=lambda tuning: {"covariance_factors": _factors(tuning), "solved": tuning.solved, "trials": tuning.trials},
        of_views=True,
    )
}

"""The estimator ``approach``: methods that follow each other as the body grows in the image."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from pydantic import Field, JsonValue

from boresight.estimators.approach.body import sphere_px
from boresight.estimators.contract import Assets, Estimate, Estimator, Predictor
from boresight.estimators.options import parse_options
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.observation import Observation
from boresight.scenarios.spec.base import SpecModel, rule


class ApproachOptions(SpecModel):
    """Options of ``approach``."""

    far: str = Field("centroid", description="The estimator of a small body, and the last one that is tried")
    far_options: Mapping[str, JsonValue] = Field(default_factory=dict, description="Options of the far estimator")
    middle_px: float = Field(32.0, gt=0, description="Diameter of the body from which the middle estimator is tried")
    middle: str = Field("limb", description="The estimator of a body with an outline")
    middle_options: Mapping[str, JsonValue] = Field(default_factory=dict, description="Options of the middle estimator")
    near_px: float | None = Field(
        None,
        gt=0,
        description="Diameter of the body from which the near estimator is tried; null: the diagonal of the image",
    )
    near: str | None = Field(None, description="The estimator of a body that fills the frame; null: none")
    near_options: Mapping[str, JsonValue] = Field(default_factory=dict, description="Options of the near estimator")

    @rule
    def _check(self) -> None:
        if self.near_px is not None and self.near_px < self.middle_px:
            raise ValueError(f"near_px: {self.near_px:g} is less than middle_px, {self.middle_px:g}")
        if self.near is None and self.near_options:
            raise ValueError("near_options: near names no estimator that they are of")


@dataclass(frozen=True, slots=True)
class Phase:
    """A phase of the approach: the name of its estimator, the estimator, and the least diameter of the body, px.

    The estimator is None if the options name none.
    """

    method: str
    estimator: Estimator | None
    least_px: float


class ApproachEstimator:
    """Chooses an estimator by the size that the body should have in the image.

    The size is the diameter of the sphere about the origin that holds the onboard shape, at the range of the prior. The
    near estimator is tried first if that is at least ``near_px``, then the middle one if it is at least ``middle_px``,
    then the far one: where one fails, the next coarser one is tried. The first estimate is the answer, with its
    covariance. Each starts from the prior.

    Use it when
    -----------
    One configuration has to hold from the first pixels of the body until it fills the frame. For the near range name an
    estimator of landmarks: ``near: lmaps``.

    It fails when
    -------------
    All estimators that are tried fail; the reason names each. Without ``near``, a body that fills the frame is left to
    the middle one, which needs the limb. A wrong estimate with the status ok is not replaced.

    Cost
    ----
    That of the estimators that are tried.

    Source
    ------
    Ours.
    """

    name: ClassVar[str] = "approach"
    version: ClassVar[int] = 1
    fuses_prior: ClassVar[bool] = True
    options_model: ClassVar[type[SpecModel]] = ApproachOptions
    far: ClassVar[str] = "centroid"
    middle: ClassVar[str] = "limb"
    near: ClassVar[str] = ""

    def __init__(self, phases: tuple[Phase, ...], radius_m: float) -> None:
        self._phases, self._radius_m = phases, radius_m

    @classmethod
    def from_options(cls, options: Mapping[str, object], assets: Assets) -> Self:
        """Build from a campaign's options, which name the estimators and give their options."""
        from boresight.estimators.registry import built_base  # the registry imports this module by name

        parsed, camera = parse_options(ApproachOptions, options, cls.name), assets.camera
        diagonal_px = float(np.hypot(camera.width_px, camera.height_px))
        near_px = max(diagonal_px, parsed.middle_px) if parsed.near_px is None else parsed.near_px
        phases = []
        for phase, least_px in (("near", near_px), ("middle", parsed.middle_px), ("far", 0.0)):
            method, section = getattr(parsed, phase), f"{phase}_options"
            built = None if method is None else built_base(method, getattr(parsed, section), assets, section)
            phases.append(Phase(method or phase, built, least_px))
        return cls(tuple(phases), assets.shape().radius_m)

    def estimate(self, observation: Observation, *, rng: np.random.Generator) -> Estimate:
        """Estimate with the first method that does not fail, each with random numbers of its own.

        Diagnostics are those of the method, ``predicted_px`` (the body's diameter by the prior), ``method``,
        ``fallbacks`` (the number of finer methods that failed) and ``failed_before`` (why).
        """
        prior = observation.frame.prior_T_cam_body
        size_px, reasons, seconds = sphere_px(self._radius_m, prior, observation.camera), [], Counter[str]()
        for phase, own in zip(self._phases, rng.spawn(len(self._phases)), strict=True):
            if size_px < phase.least_px:
                continue
            if phase.estimator is None:
                reasons.append(f"{phase.method} names no estimator")
                continue
            found = phase.estimator.estimate(observation, rng=own)
            seconds.update(found.timings_s)
            if found.status == "ok":
                told = {**found.diagnostics, "predicted_px": size_px, "method": phase.method}
                told |= {"fallbacks": len(reasons), "failed_before": "; ".join(reasons)}
                return replace(found, diagnostics=told, timings_s=dict(seconds))
            reasons.append(f"{phase.method}: {found.reason}")
        return Estimate("failed", "; ".join(reasons), diagnostics={"predicted_px": size_px}, timings_s=dict(seconds))

    def predict(self, planned: Observation) -> FloatArray | None:
        """Predict the covariance (6, 6) of the method that is tried first; None if it has no predictor."""
        size_px = sphere_px(self._radius_m, planned.frame.prior_T_cam_body, planned.camera)
        large = (phase.estimator for phase in self._phases if size_px >= phase.least_px)
        first = next((estimator for estimator in large if estimator is not None), None)
        return first.predict(planned) if isinstance(first, Predictor) else None

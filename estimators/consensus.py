"""Two estimators on one image: an answer where they agree, a failure where they contradict each other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
from pydantic import Field, JsonValue
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

from boresight.estimators.contract import Assets, Estimate, Estimator, Stage
from boresight.estimators.landmark.pose.posterior import GaussianPose
from boresight.estimators.options import parse_options
from boresight.estimators.prior import floor_variances, free_directions
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.observation import Observation
from boresight.scenarios.spec.base import SpecModel


class ConsensusOptions(SpecModel):
    """Options of ``consensus``."""

    base: str = Field("lmaps", description="The first estimator")
    options: Mapping[str, JsonValue] = Field(default_factory=dict, description="Options of the first")
    second: str = Field("photometric", description="The second estimator")
    second_options: Mapping[str, JsonValue] = Field(default_factory=dict, description="Options of the second")
    significance: float = Field(
        0.001,
        gt=0,
        lt=1,
        description="Share of images in which two independent true covariances count as a contradiction",
    )


@dataclass(frozen=True, slots=True)
class Agreement:
    """The distance between two answers, and the pose fused from both.

    ``distance2`` is the squared Mahalanobis distance of the two, of ``freedom`` degrees: six, less the directions in
    which neither has an error. ``weight`` is that of the first in the fused pose.
    """

    distance2: float
    freedom: int
    weight: float
    fused: GaussianPose


def agreement(first: GaussianPose, second: GaussianPose) -> Agreement:
    """Compare two answers, and fuse them by covariance intersection.

    With d the pose of the second less that of the first, [rotation_rad, translation_m] in camera axes, the distance is
    d^T (P_1 + P_2)^-1 d. Both answers rest on one image, prior and shape, so their errors are correlated, and nobody
    knows by how much: P^-1 = w P_1^-1 + (1 - w) P_2^-1 is not below the true covariance for any correlation if both
    are true. The weight w in [0, 1] makes det(P) least. Julier and Uhlmann (1997), A non-divergent estimation algorithm
    in the presence of unknown correlations.
    """
    offset = first.offset(second.T_cam_body)
    one, two = floor_variances(first.covariance), floor_variances(second.covariance)
    # In units of the first's sigmas: radians and metres differ by orders of magnitude.
    sigmas = np.sqrt(np.diag(one))
    ours, theirs = (np.linalg.inv(each / np.outer(sigmas, sigmas)) for each in (one, two))

    def less_information(weight: float) -> float:
        return -float(np.linalg.slogdet(weight * ours + (1.0 - weight) * theirs)[1])

    inner = minimize_scalar(less_information, bounds=(0.0, 1.0), method="bounded", options={"xatol": 1e-6})
    weight = min((0.0, 1.0, float(inner.x)), key=less_information)
    covariance = np.linalg.inv(weight * ours + (1.0 - weight) * theirs) * np.outer(sigmas, sigmas)
    step: FloatArray = sigmas * (covariance / np.outer(sigmas, sigmas) @ ((1.0 - weight) * theirs @ (offset / sigmas)))
    distance2 = float(offset @ np.linalg.solve(one + two, offset))
    freedom = free_directions(first.covariance + second.covariance)
    return Agreement(
        distance2, freedom, weight, GaussianPose(first.T_cam_body.perturbed(step[:3], step[3:]), covariance)
    )


class ConsensusEstimator:
    """Two estimators, whose answers are fused where they agree. Where they do not, the image is not solved.

    They contradict each other where the squared Mahalanobis distance of their poses is above a quantile of a
    chi-square. A method that is wrong and sure of itself is found by that if the other one is as sure and does not err
    in the same way. The test takes the errors for independent: what both have from the prior makes contradictions
    rarer.

    Use it when
    -----------
    A wrong answer costs more than none, and the two find the pose by different means. Take bases with a true covariance
    (``tuned``): with covariances that are too small right answers are refused.

    It fails when
    -------------
    Either base fails, gives no covariance, or contradicts the other. A wrong answer passes where the other base knows
    little more than the prior.

    Cost
    ----
    That of both.

    Source
    ------
    Julier and Uhlmann (1997) for the fusion; the test is ours.
    """

    name: ClassVar[str] = "consensus"
    version: ClassVar[int] = 1
    options_model: ClassVar[type[SpecModel]] = ConsensusOptions
    base: ClassVar[str] = "lmaps"
    second: ClassVar[str] = "photometric"

    def __init__(self, bases: Mapping[str, Estimator], significance: float) -> None:
        self._bases = bases
        self._significance = significance

    @classmethod
    def from_options(cls, options: Mapping[str, object], assets: Assets) -> Self:
        """Build from a campaign's options, which name both bases and give their options."""
        from boresight.estimators.registry import built_base  # the registry imports this module by name

        parsed = parse_options(ConsensusOptions, options, cls.name)
        if parsed.base == parsed.second and parsed.options == parsed.second_options:
            raise BoresightError(
                f"estimator {cls.name}: second: it is the first again, which agrees with itself: give another"
            )
        first = built_base(parsed.base, parsed.options, assets)
        second = built_base(parsed.second, parsed.second_options, assets, "second_options")
        names = (parsed.base, parsed.second) if parsed.base != parsed.second else ("first", "second")
        return cls(dict(zip(names, (first, second), strict=True)), parsed.significance)

    def estimate(self, observation: Observation, *, rng: np.random.Generator) -> Estimate:
        """Estimate with both, each with random numbers of its own."""
        found = {}
        for (name, base), own in zip(self._bases.items(), rng.spawn(2), strict=True):
            answer = base.estimate(observation, rng=own)
            if answer.status != "ok" or answer.pose is None:
                return Estimate("failed", f"{name}: {answer.reason}")
            if answer.covariance is None:
                return Estimate("failed", f"{name} gives no covariance to compare with")
            found[name] = GaussianPose(answer.pose, answer.covariance)
        stages = tuple(Stage(name, pose.T_cam_body) for name, pose in found.items())
        both = agreement(*found.values())
        diagnostics = {"disagreement": both.distance2, "weight_of_first": both.weight}
        if both.distance2 > chi2.isf(self._significance, max(both.freedom, 1)):
            reason = f"{' and '.join(found)} contradict each other"
            return Estimate("failed", reason, stages=stages, diagnostics=diagnostics)
        fused = both.fused
        stages = (*stages, Stage("fused", fused.T_cam_body))
        return Estimate("ok", "", fused.T_cam_body, fused.covariance, stages=stages, diagnostics=diagnostics)

"""Another estimator with a covariance tuned by rehearsals: simulations with the errors that the spacecraft may have."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
from pydantic import Field, JsonValue
from scipy.optimize import brentq
from scipy.stats import chi2

from boresight.estimators.contract import Assets, Estimate, Estimator, NoProductError, typed_product
from boresight.estimators.options import parse_options
from boresight.estimators.prior import calibration_in_posterior, floor_variances, free_directions, shares_of_prior
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.observation import CameraSigma, Frame, Observation
from boresight.scenarios.reading import CONTENT_FAULTS
from boresight.scenarios.spec.base import SpecModel

PRODUCT = "covariance-tuning"
FILE = "tuning.json"
VERSION = 4
"""Version of the rehearsal and of the fit: raise it when factors change."""

_LEAST_SOLVED = 20
_LARGEST_FACTOR = 1e8
_LARGEST_RATIO = 1e4
"""Of the factors at the two ends of the phase angles."""
_LEAST_WIDTH_RAD = 1e-3
_CAP_SHARE, _WRONG_SHARE = 0.99, 0.999


class TuningOptions(SpecModel):
    """How often the base is rehearsed."""

    trials: int = Field(60, ge=_LEAST_SOLVED, le=100_000, description="Rehearsed images")
    bodies: int = Field(4, ge=1, le=1000, description="Draws of the shape's errors, among which images are divided")
    seed: int = Field(0, ge=0, description="Seed of the rehearsals, which share no random number with the campaign")


class Rehearsals(TuningOptions):
    """Options of the product: the base, which is rehearsed, and its version."""

    base: str
    options: Mapping[str, JsonValue]
    version: int
    source: str | None = None


class TunedOptions(SpecModel):
    """Options of ``tuned``."""

    base: str = Field("photometric", description="The estimator whose covariance is tuned")
    options: Mapping[str, JsonValue] = Field(default_factory=dict, description="Options of the base")
    tuning: TuningOptions = TuningOptions()


@dataclass(frozen=True, slots=True, eq=False)
class Rehearsed:
    """A rehearsed image that was solved.

    Parameters
    ----------
    error
        (6,) error of the pose [rotation_rad, translation_m], camera axes: the estimate is ``true.perturbed(error)``.
    covariance, prior_covariance
        (6, 6) stated by the base, and that of the prior.
    phase_rad
        See `phase_rad`.
    """

    error: FloatArray
    covariance: FloatArray
    prior_covariance: FloatArray
    phase_rad: float


def phase_rad(frame: Frame) -> float:
    """Return the phase angle, Sun - body - camera, at the pose of the prior."""
    towards_body = frame.prior_T_cam_body.translation_m / np.linalg.norm(frame.prior_T_cam_body.translation_m)
    return float(np.arccos(np.clip(-towards_body @ frame.sun_dir_cam, -1.0, 1.0)))


@dataclass(frozen=True, slots=True)
class CovarianceTuning:
    """By how much a method understates the errors of its image, and how many rehearsals say so.

    The factor follows the phase angle: ``factors`` are at the least and the largest of the rehearsals, ``phases_rad``.
    Of several declared reflectances it is of the one with the greatest factors. ``wrong`` of the ``solved`` images have
    an error beyond the 99.9 % quantile of the tuned covariance.
    """

    phases_rad: tuple[float, float]
    factors: tuple[float, float]
    wrong: int
    solved: int
    trials: int

    def factor(self, phase_rad: float) -> float:
        """Return the factor at a phase angle: its logarithm is linear, and constant beyond the ends."""
        return float(np.exp(np.interp(phase_rad, self.phases_rad, np.log(self.factors))))

    def save(self, folder: Path) -> None:
        """Write the tuning into ``folder``."""
        (folder / FILE).write_text(json.dumps(asdict(self)), encoding="utf-8")

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read a stored tuning; raise BoresightError if it cannot be read."""
        path = folder / FILE
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
            phases, factors = ((float(low), float(high)) for low, high in (found["phases_rad"], found["factors"]))
            return cls(phases, factors, *(int(found[name]) for name in ("wrong", "solved", "trials")))
        except CONTENT_FAULTS as error:
            raise BoresightError(f"{path}: cannot be read as a tuning: {error}; run the campaign again") from error


def tuned_covariance(covariance: FloatArray, prior_covariance: FloatArray, factor: float) -> FloatArray:
    """Divide the information of the image by a factor, and leave that of the prior.

    P' = ((P^-1 - P_0^-1) / k + P_0^-1)^-1 for the covariance P, that of the prior P_0 and the factor k. Where P is
    not below P_0, as a method that does not use the prior may state it, it is left as it is.

    Parameters
    ----------
    covariance, prior_covariance
        (6, 6).
    factor
        Above 0.
    """
    shares, axes = shares_of_prior(covariance, floor_variances(prior_covariance))
    inverse = np.linalg.inv(axes)
    return np.asarray(inverse.T @ (_tuned(shares, factor)[:, None] * inverse), dtype=np.float64)


def _tuned(shares: FloatArray, factor: float | FloatArray) -> FloatArray:
    # 1 / share = 1 + information of the image.
    return np.where(shares < 1.0, factor / (1.0 - shares + factor * shares), 1.0) * shares


def fit_tuning(rehearsed: Sequence[Rehearsed], trials: int) -> CovarianceTuning:
    """Return the factors with which e^T P'^-1 e over rehearsals is that of a chi-square, on average up to its 99 %.

    The mean of min(e^T P'^-1 e, c) is that of a chi-square, c its quantile (Huber 1981, section 6.4, proposal 2): a few
    wrong answers, which no covariance covers, move the factor as little as answers at c. It has 6 degrees of freedom,
    less those in which the prior has no error. The logarithm of the factor is linear in the phase angle, with the slope
    at which these values do not lean on it. The factor is within 1e-8 and 1e8, at both ends within 1e4 of one another.
    """
    freedom = float(np.mean([free_directions(one.prior_covariance) for one in rehearsed]))
    cap = chi2.ppf(_CAP_SHARE, freedom)
    # The mean of a chi-square up to c is that of its density times x, which has 2 degrees of freedom more.
    expected = freedom * chi2.cdf(cap, freedom + 2.0) + cap * (1.0 - _CAP_SHARE)
    parts = [shares_of_prior(one.covariance, floor_variances(one.prior_covariance)) for one in rehearsed]
    shares = np.array([of for of, _ in parts])
    squares = np.array([(axes.T @ one.error) ** 2 for (_, axes), one in zip(parts, rehearsed, strict=True)])
    phases = np.array([one.phase_rad for one in rehearsed])
    ends = np.array([phases.min(), phases.max()])
    width, middle = float(np.ptp(ends)), float(phases.mean())
    beside = (phases - middle) / (width or 1.0)

    def weighed(level: float, slope: float) -> FloatArray:
        factors = np.exp(level + slope * beside)
        return np.asarray(np.sum(squares / _tuned(shares, factors[:, None]), axis=1), dtype=np.float64)

    def excess(level: float, slope: float) -> FloatArray:
        return np.minimum(weighed(level, slope), cap) - expected

    def level_at(slope: float) -> float:
        return _root(lambda level: float(excess(level, slope).mean()), float(np.log(_LARGEST_FACTOR)))

    # Rehearsals of one phase angle have no slope.
    leans = width > _LEAST_WIDTH_RAD
    slope = (
        _root(lambda one: float(beside @ excess(level_at(one), one)), float(np.log(_LARGEST_RATIO))) if leans else 0.0
    )
    level = level_at(slope)
    low, high = np.exp(level + slope * (ends - middle) / (width or 1.0)).tolist()
    wrong = int((weighed(level, slope) > chi2.ppf(_WRONG_SHARE, freedom)).sum())
    return CovarianceTuning((float(ends[0]), float(ends[1])), (low, high), wrong, len(rehearsed), trials)


def _root(falling: Callable[[float], float], most: float) -> float:
    """Return the zero of a falling function between -most and most, or the end that is nearer to it."""
    if falling(most) >= 0.0:
        return most
    if falling(-most) <= 0.0:
        return -most
    return float(brentq(falling, -most, most, xtol=1e-6))


def check_solved(solved: int, trials: int, base: str) -> None:
    """Refuse to tune on few answers."""
    if solved < _LEAST_SOLVED:
        raise NoProductError(
            f"{base} solved {solved} of {trials} rehearsed images, and {_LEAST_SOLVED} are needed: raise tuning.trials,"
            " or look at the reasons in a run of the base alone"
        )


class TunedEstimator:
    """Another estimator with the covariance that its errors in rehearsals have.

    Before the first image, the base is tried on simulated ones, seen as the scenario says: of a body with relief like
    that of the shape on board, which the base knows with the errors that the mission declares (``onboard.declared``).
    A factor, which follows the phase angle, divides the information that the base states, so that its NEES over these
    trials is that of a true covariance, where a few wrong answers count as little as answers at the 99 % ellipsoid; of
    several reflectances that are declared, the greatest factor counts. A base with landmarks of a survey
    (``source: survey``) is tried on the real images of the survey instead, each placed by the landmarks of the others
    and compared with its reference pose: so the factor holds errors of shape, light and reference that differ from
    image to image. It is one for all phase angles then, and what is declared has no part in it. The calibration's part
    (``onboard.camera_sigma``) is added afterwards. The pose is that of the base.

    Use it when
    -----------
    A filter or a person takes the covariance for true.

    It fails when
    -------------
    The base solves fewer than 20 rehearsed images. The factor holds for errors as large as was declared, on average
    over the views of a phase angle: not for each view. It is too small where the shape on board is a file with errors
    as large as its relief, for these are relief of the rehearsed body too. That of a survey rests on as many errors as
    it has images, and an error that all of them share is not in it. Wrong answers are not covered: the build
    says how many there were in rehearsals; ``consensus`` refuses them where another method contradicts.

    Cost
    ----
    That of its base. Before the campaign it makes the data bases of the base ``tuning.bodies`` times, of a survey once
    for each of its images, and estimates ``tuning.trials`` images.

    Source
    ------
    Ours.
    """

    name: ClassVar[str] = "tuned"
    version: ClassVar[int] = 5
    options_model: ClassVar[type[SpecModel]] = TunedOptions
    base: ClassVar[str] = "photometric"

    def __init__(self, base: Estimator, tuning: CovarianceTuning) -> None:
        self._base = base
        self._tuning = tuning

    @classmethod
    def from_options(cls, options: Mapping[str, object], assets: Assets) -> Self:
        """Build from a campaign's options, which name the base and give its options."""
        # It imports this module by name.
        from boresight.estimators.registry import bases_of, built_base, estimator_class, source_digest

        parsed = parse_options(TunedOptions, options, cls.name)
        found = estimator_class(parsed.base)
        if bases_of(parsed.base, parsed.options):
            raise BoresightError(f"estimator {cls.name}: base: {parsed.base} builds on another itself: tune that one")
        base = built_base(parsed.base, parsed.options, assets)
        asked = Rehearsals(
            **dict(parsed.tuning),
            base=parsed.base,
            options=parsed.options,
            version=found.version,
            source=source_digest(parsed.base),
        )
        return cls(base, typed_product(assets, PRODUCT, asked, CovarianceTuning, cls.name))

    def estimate(self, observation: Observation, *, rng: np.random.Generator) -> Estimate:
        """Estimate with the base, and tune its covariance."""
        estimate = self._base.estimate(replace(observation, camera_sigma=CameraSigma()), rng=rng)
        if estimate.status != "ok" or estimate.pose is None:
            return estimate
        if estimate.covariance is None:
            return Estimate("failed", "the base gives no covariance to tune")
        prior, factor = observation.frame.prior_covariance, self._tuning.factor(phase_rad(observation.frame))
        tuned = tuned_covariance(estimate.covariance, prior, factor)
        return replace(
            estimate,
            covariance=tuned + calibration_in_posterior(observation, estimate.pose, estimate.covariance),
            common=None,
            diagnostics={**estimate.diagnostics, "covariance_factor": factor},
        )

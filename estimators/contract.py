"""The interface of every estimator: an observation in, an estimate or a failure with its reason out."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import ClassVar, Literal, Protocol, Self, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Pose, TriangleMesh, View
from boresight.scenarios.observation import Observation
from boresight.scenarios.spec.base import SpecModel
from boresight.scenarios.stars import StarCatalog

T = TypeVar("T")
Table = Mapping[str, NDArray[np.generic]]


class NoProductError(BoresightError):
    """A product that an estimator needs cannot be built from the scenario: too few landmarks, too small a shape.

    This depends on the scenario alone and not on a trial: all trials of the estimator in that scenario are errors, and
    the other estimators continue. The message gives the options to change, with their values.
    """


class ImageRenderer(Protocol):
    """A renderer of noise-free images of a mesh."""

    def render(self, view: View) -> NDArray[np.float32]:
        """(H, W) radiance factor of the mesh seen from ``view``; 0 off the body and in shadow."""
        ...


@runtime_checkable
class DifferentiableRenderer(ImageRenderer, Protocol):
    """A renderer that also gives the derivatives of its images by the pose, if ``differentiable`` is true."""

    @property
    def differentiable(self) -> bool:
        """Whether `render_with_derivatives` works on this machine."""
        ...

    def render_with_derivatives(self, view: View) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(H, W) image of ``render``, to rounding, and (6, H, W) its derivatives by the pose.

        The parameters are [rotation_rad, translation_m] of ``Pose.perturbed``; the Sun is fixed in camera axes.
        """
        ...


class Assets(Protocol):
    """The resources that a campaign gives to an estimator when it is built; none contains the truth of a trial."""

    @property
    def camera(self) -> Camera:
        """The camera of the scenario."""
        ...

    def mesh_renderer(
        self, mesh: TriangleMesh, samples_per_pixel: int = 1, *, other_law: bool = False
    ) -> ImageRenderer:
        """Return a renderer of ``mesh`` with the onboard BRDF and self-shadowing.

        With ``other_law`` it has a law that darkens the limb differently: Lommel and Seeliger's where the onboard one
        is Lambert's or Oren and Nayar's, else Lambert's.
        """
        ...

    def shape(self) -> TriangleMesh:
        """Return the full onboard shape (metres, body frame)."""
        ...

    def stars(self) -> StarCatalog:
        """Return the catalogue of the stars behind the body; raise `NoProductError` if images show none."""
        ...

    def product(self, kind: str, options: Mapping[str, object]) -> object:
        """Return a product built beforehand from the scenario, by its kind (for example ``landmark-database``).

        Raise `NoProductError` if it cannot be built.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """The pose after one stage of an estimator, for reports of the errors by stage."""

    name: str
    T_cam_body: Pose


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """The result of an estimator for one observation.

    Parameters
    ----------
    status
        ``ok`` or ``failed``; an image that cannot be solved is a failure with a reason, not an exception.
    reason
        Reason of the failure; empty when ok.
    pose
        T_cam_body; None when failed.
    covariance
        (6, 6) of [rotation_rad, translation_m] in camera axes: the covariance that the method states for its error,
        including the prior where it uses one; None if the method gives none.
    bound
        (6, 6), same parameters: Cramer-Rao bound of the observations used, under their calibrated noise (including
        the prior's information where the method uses the prior); None if the method gives none.
    common
        (6,) one standard deviation, same parameters, of an error that all images of the method share, such as that by a
        bias in pixels; ``covariance`` contains its square. None if the method states none.
    stages
        Poses after the named stages, in order, also where a later stage failed.
    details
        Tables by name, each a mapping of equally long columns (for example recognised landmarks).
    diagnostics
        Scalars by name, stored with the row.
    timings_s
        Wall time by stage.
    """

    status: Literal["ok", "failed"]
    reason: str = ""
    pose: Pose | None = None
    covariance: NDArray[np.float64] | None = None
    bound: NDArray[np.float64] | None = None
    common: NDArray[np.float64] | None = None
    stages: tuple[Stage, ...] = ()
    details: Mapping[str, Table] = field(default_factory=dict)
    diagnostics: Mapping[str, float | int | str] = field(default_factory=dict)
    timings_s: Mapping[str, float] = field(default_factory=dict)


class Estimator(Protocol):
    """An estimator of the pose from one observation.

    ``version`` is part of the key of every result: raise it when results change. Some class attributes are optional:
    ``sensors``, the names of the sensors that it needs in addition to the camera; ``fuses_prior``, true if pose and
    covariance of every estimate contain the prior, as by a Kalman update; and ``base`` and ``second``, or
    ``far``, ``middle`` and ``near``, the names of estimators that it builds on unless options of these names give
    others ('' for none), with their options in ``options``, ``second_options`` and so on. Their versions are part of
    the key.
    """

    name: ClassVar[str]
    version: ClassVar[int]

    @classmethod
    def from_options(cls, options: Mapping[str, object], assets: Assets) -> Self:
        """Build from a campaign's options; raise BoresightError on a wrong option, and pass on NoProductError."""
        ...

    def estimate(self, observation: Observation, *, rng: np.random.Generator) -> Estimate:
        """Estimate the pose of the frame. Must not change its input or keep state between calls."""
        ...


@runtime_checkable
class Predictor(Protocol):
    """An estimator that predicts its covariance without an image: an optional part of the contract.

    Estimators of sequences and orbits may have a ``predict`` as well, see their contracts. For the orbit of an approach
    an estimator also needs ``predict_estimate(planned) -> Estimate | None``: the same covariance with the ``common``
    error, or None.
    """

    def predict(self, planned: Observation) -> NDArray[np.float64] | None:
        """(6, 6) covariance of the error, [rotation_rad, translation_m] in camera axes, that an estimate will have.

        ``planned`` has an image of (0, 0) pixels, and its prior pose is the one that the geometry is taken from. The
        covariance is linear: errors are small enough for the derivatives at that pose. Result None: the geometry
        does not allow an estimate.
        """
        ...


def typed_product(assets: Assets, kind: str, options: SpecModel, expected: type[T], estimator: str) -> T:
    """Return the product of a kind that was built with ``options``, for the estimator of that name.

    Raise `BoresightError` if the product is not an object of the class ``expected``.
    """
    product = assets.product(kind, options.model_dump(mode="json"))
    if not isinstance(product, expected):
        raise BoresightError(f"{estimator}: the product {kind!r} is a {type(product).__name__}")
    return product


class Stopwatch:
    """Wall time of an estimate by stage, accumulated; each estimate needs its own."""

    def __init__(self) -> None:
        self._seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Time the body of a ``with`` statement."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self._seconds[stage] = self._seconds.get(stage, 0.0) + time.perf_counter() - start

    @property
    def seconds(self) -> dict[str, float]:
        """Seconds by stage so far."""
        return dict(self._seconds)

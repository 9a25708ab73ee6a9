"""The contract of every estimator: an observation in, an estimate or a reasoned failure out."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import ClassVar, Literal, Protocol, Self, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from scenarios.errors import BoresightError
from scenarios.geometry import Camera, Pose, TriangleMesh, View
from scenarios.observation import Observation
from scenarios.spec.base import SpecModel

T = TypeVar("T")
Table = Mapping[str, NDArray[np.generic]]


class NoProductError(BoresightError):
    """What an estimator is to be lent cannot be made of the scenario: too few landmarks, a shape that is too small.

    The scenario alone decides that, and no trial: all of the estimator's trials there are errors, others go on. The
    message names the options that decide, with their values.
    """


class ImageRenderer(Protocol):
    """What an estimator needs of a renderer: noise-free images of a mesh."""

    def render(self, view: View) -> NDArray[np.float32]:
        """(H, W) radiance factor of the mesh seen from ``view``; 0 off the body and in shadow."""
        ...


@runtime_checkable
class DifferentiableRenderer(ImageRenderer, Protocol):
    """A renderer that also tells how its images change with the pose, where its ``differentiable`` says so."""

    @property
    def differentiable(self) -> bool:
        """Whether `render_with_derivatives` works on this machine."""
        ...

    def render_with_derivatives(self, view: View) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(H, W) as ``render`` but for rounding, and (6, H, W) its derivatives by the pose.

        The parameters are [rotation_rad, translation_m] of ``Pose.perturbed``; the Sun stands still in the camera.
        """
        ...


class Assets(Protocol):
    """What the campaign lends to an estimator when it is built; none of it knows a trial's truth."""

    @property
    def camera(self) -> Camera:
        """The camera of the scenario."""
        ...

    def mesh_renderer(self, mesh: TriangleMesh, samples_per_pixel: int = 1) -> ImageRenderer:
        """Lend a renderer of ``mesh`` in the BRDF that the spacecraft believes in, with self-shadowing."""
        ...

    def shape(self) -> TriangleMesh:
        """Lend the full shape that the spacecraft carries, (metres, body frame)."""
        ...

    def product(self, kind: str, options: Mapping[str, object]) -> object:
        """Lend a product built beforehand from the scenario's shape, by kind (for example a landmark data base).

        Raises
        ------
        NoProductError
            If none can be made.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """The pose after one stage of an estimator, so that a report can follow its progress."""

    name: str
    T_cam_body: Pose


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """What an estimator returns.

    Parameters
    ----------
    status
        ``ok`` or ``failed``; a hard image is a failure with a reason, not an exception.
    reason
        Why it failed; empty when ok.
    pose
        T_cam_body; None when failed.
    covariance
        (6, 6), [rotation_rad, translation_m] in camera axes: what the method believes its error to be, prior included
        where it uses it; None where the method has none.
    bound
        (6, 6), in the same parameters: the Cramer-Rao bound of the observations that the estimate rests on, under
        their calibrated noise (with the prior's information where the method uses the prior); None where the method
        has none.
    stages
        Poses after the named stages, in order, also where a later stage failed.
    details
        Tables by name, each a mapping of equally long columns (for example recognised landmarks).
    diagnostics
        Scalars by name that go into the row.
    timings_s
        Wall time by stage.
    """

    status: Literal["ok", "failed"]
    reason: str = ""
    pose: Pose | None = None
    covariance: NDArray[np.float64] | None = None
    bound: NDArray[np.float64] | None = None
    stages: tuple[Stage, ...] = ()
    details: Mapping[str, Table] = field(default_factory=dict)
    diagnostics: Mapping[str, float | int | str] = field(default_factory=dict)
    timings_s: Mapping[str, float] = field(default_factory=dict)


class Estimator(Protocol):
    """Anything that turns an observation into an estimate.

    ``version`` is part of every result's key: raise it when results change. Two things are optional: a class attribute
    ``sensors``, the names of the sensors beside the camera that it needs, and a class attribute ``base``, the name of
    another estimator that it builds on unless the option ``base`` says otherwise; its version is part of the key too.
    """

    name: ClassVar[str]
    version: ClassVar[int]

    @classmethod
    def from_options(cls, options: Mapping[str, object], assets: Assets) -> Self:
        """Build from a campaign's options; raise BoresightError on a wrong one, let NoProductError pass."""
        ...

    def estimate(self, observation: Observation, *, rng: np.random.Generator) -> Estimate:
        """Estimate the pose of the frame. Must not change its input or keep state between calls."""
        ...


def typed_product(assets: Assets, kind: str, options: SpecModel, expected: type[T], estimator: str) -> T:
    """Return the product of a kind that was built with ``options``, for the estimator of that name.

    Raises
    ------
    BoresightError
        If the product is not an object of the class ``expected``.
    """
    product = assets.product(kind, options.model_dump(mode="json"))
    if not isinstance(product, expected):
        raise BoresightError(f"{estimator}: the product {kind!r} is a {type(product).__name__}")
    return product


class Stopwatch:
    """Adds up the wall time spent under each name; one for each estimate, never shared."""

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

"""Find estimators by name: our own, and those of other packages by their entry points."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Generic, TypeVar, cast

from boresight.scenarios.errors import BoresightError, one_line

if TYPE_CHECKING:
    from boresight.estimators.contract import Estimator

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Registry(Generic[T]):
    """Classes that satisfy one interface, by name.

    Parameters
    ----------
    own
        Our own classes: name to "module:attribute".
    group
        Entry-point group of classes of other packages.
    parts
        Attributes that a class must have.
    """

    own: Mapping[str, str]
    group: str
    parts: tuple[str, ...]

    def names(self) -> tuple[str, ...]:
        """All names, sorted; third-party ones included."""
        return tuple(sorted({*self.own, *(point.name for point in entry_points(group=self.group))}))

    def find(self, name: str) -> type[T]:
        """Import the class of a name; our own names take precedence over those of other packages.

        Raises
        ------
        BoresightError
            If the name is unknown, or a class of another package cannot be imported or lacks an attribute.
        """
        if name in self.own:
            module, attribute = self.own[name].split(":")
            return cast("type[T]", getattr(import_module(module), attribute))
        points = [point for point in entry_points(group=self.group) if point.name == name]
        if not points:
            near = difflib.get_close_matches(name, self.names(), n=1)
            hint = f"did you mean {near[0]}?" if near else f"there are: {', '.join(self.names())}"
            raise BoresightError(f"estimator {name!r} is unknown; {hint}")
        try:
            found = points[0].load()
        except Exception as error:  # a foreign module may raise anything
            said = one_line(error) or type(error).__name__
            raise BoresightError(f"estimator {name!r} cannot be imported from {points[0].value}: {said}") from error
        missing = [part for part in self.parts if not hasattr(found, part)]
        if missing:
            raise BoresightError(f"estimator {name!r} ({points[0].value}) lacks {', '.join(missing)} of the contract")
        return cast("type[T]", found)


_ESTIMATORS: Registry[Estimator] = Registry(
    own={
        "centroid": "boresight.estimators.landmark.centroiding:CentroidAligner",
        "landmark-harris": "boresight.estimators.landmark.recognizer:LandmarkRecognizer",
        "landmark-altimeter": "boresight.estimators.altimeter:AltimeterEstimator",
        "landmark-orb": "boresight.estimators.descriptors.recognizer:OrbNavigator",
        "landmark-sift": "boresight.estimators.descriptors.recognizer:SiftNavigator",
        "landmark-ransac": "boresight.estimators.landmark.robust.estimator:ConsensusRecognizer",
        "whole-image": "boresight.estimators.dense.whole_image:WholeImageRecognizer",
        "photometric": "boresight.estimators.dense.photometric:PhotometricEstimator",
        "lmaps": "boresight.estimators.maplets.recognizer:MapletNavigator",
        "crater-pose": "boresight.estimators.craters.pose:CraterPose",
        "prior": "boresight.estimators.prior:PriorEstimator",
    },
    group="boresight.estimators",
    parts=("name", "version", "from_options", "estimate"),
)
estimator_names, estimator_class = _ESTIMATORS.names, _ESTIMATORS.find


def needed_sensors(name: str) -> frozenset[str]:
    """Return the sensors that an estimator needs in addition to the camera; empty for most."""
    return frozenset(getattr(estimator_class(name), "sensors", ())) if name in estimator_names() else frozenset()


def base_of(name: str, options: Mapping[str, object]) -> str | None:
    """Return the name of the estimator that another builds on, by option or class attribute; None for most."""
    base = getattr(estimator_class(name), "base", None) if name in estimator_names() else None
    return None if base is None else str(options.get("base", base))

"""Find estimators by name: our own, those of other packages by their entry points, and classes of modules and files."""

from __future__ import annotations

import difflib
import hashlib
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from importlib.metadata import EntryPoints, entry_points
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Generic, TypeVar, cast

from boresight.estimators.options import OptionsError
from boresight.scenarios.errors import BoresightError, one_line

if TYPE_CHECKING:  # the contracts load compiled kernels, which names need not
    from boresight.estimators.contract import Assets, Estimator
    from boresight.estimators.craters.contract import CraterDetector, CraterMatcher
    from boresight.estimators.orbit.contract import OrbitEstimator
    from boresight.estimators.slam.contract import SequenceEstimator

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Registry(Generic[T]):
    """Classes that satisfy one interface, by name.

    ``own`` maps our names to "module:attribute", ``group`` is the entry-point group of classes of other packages, and
    ``parts`` are the attributes that a class must have.
    """

    own: Mapping[str, str]
    group: str
    parts: tuple[str, ...]

    def __contains__(self, name: str) -> bool:
        return name in self.own or any(point.name == name for point in _entry_points(self.group))

    def names(self) -> tuple[str, ...]:
        """All names, sorted; third-party ones included."""
        return tuple(sorted({*self.own, *(point.name for point in _entry_points(self.group))}))

    def find(self, name: str) -> type[T]:
        """Import the class of a name, ``module:Class`` or ``file.py:Class``; our own names come before foreign ones.

        Raise `BoresightError` if the name is unknown, or a foreign class cannot be imported or lacks an attribute.
        """
        if name in self.own:
            module, attribute = self.own[name].split(":")
            return cast("type[T]", getattr(import_module(module), attribute))
        points = [point for point in _entry_points(self.group) if point.name == name]
        if not points and ":" not in name:
            near = difflib.get_close_matches(name, self.names(), n=1)
            hint = f"did you mean {near[0]}?" if near else f"there are: {', '.join(self.names())}"
            raise BoresightError(f"estimator {name!r} is unknown; {hint}")
        place = points[0].value if points else name
        found = _imported(name, place, points[0].load) if points else class_at(name)
        missing = [part for part in self.parts if not hasattr(found, part)]
        if missing:
            raise BoresightError(f"estimator {name!r} ({place}) lacks {', '.join(missing)} of the contract")
        return cast("type[T]", found)


def _entry_points(group: str) -> EntryPoints:
    """Return the entry points of a group, read again where a folder of ``sys.path`` has changed.

    Reading them takes 5 ms, and a campaign asks for each of its estimators in each scenario.
    """
    return _read_entry_points(group, tuple((place, _changed_ns(place)) for place in sys.path))


def _changed_ns(folder: str) -> int:
    """Return the time of the last change of a folder; 0 where it cannot be read."""
    try:
        return Path(folder).stat().st_mtime_ns
    except OSError:
        return 0


@lru_cache(maxsize=8)
def _read_entry_points(group: str, _path: tuple[tuple[str, int], ...]) -> EntryPoints:
    return entry_points(group=group)


def file_of(name: str) -> Path | None:
    """Return the file of ``file.py:Class``; None for every other name."""
    file = name.rpartition(":")[0]
    return Path(file) if file.endswith(".py") else None


def source_digest(name: str) -> str | None:
    """Return the digest of the file of ``file.py:Class``; None for every other name.

    Raise `OSError` if the file cannot be read.
    """
    file = file_of(name)
    return None if file is None else hashlib.sha256(file.read_bytes()).hexdigest()


def class_at(name: str) -> object:
    """Import the attribute that ``module:Class`` or ``file.py:Class`` names.

    A file is a module by its content: one that was changed is imported again. What lies beside it can be imported.
    Raise `BoresightError` if it cannot be imported.
    """
    place, _, attribute = name.rpartition(":")
    file = file_of(name)
    if file is None:
        return _imported(name, place, lambda: getattr(import_module(place), attribute))
    return _imported(name, place, lambda: getattr(_module(file, f"{file.stem}_{source_digest(name)}"), attribute))


def _module(file: Path, called: str) -> ModuleType:
    """Import a file under a name of its own."""
    if called not in sys.modules:
        folder = str(file.absolute().parent)
        if folder not in sys.path:
            sys.path.append(folder)
        spec = spec_from_file_location(called, file)
        if spec is None or spec.loader is None:
            raise ImportError(f"{file} is no Python file")
        sys.modules[called] = module_from_spec(spec)
        try:
            spec.loader.exec_module(sys.modules[called])
        except BaseException:
            del sys.modules[called]
            raise
    return sys.modules[called]


def _imported(name: str, place: str, load: Callable[[], object]) -> object:
    try:
        return load()
    except Exception as error:  # a foreign module may raise anything
        said = one_line(error) or type(error).__name__
        raise BoresightError(f"estimator {name!r} cannot be imported from {place}: {said}") from error


ESTIMATORS: Registry[Estimator] = Registry(
    own={
        "approach": "boresight.estimators.approach.handover:ApproachEstimator",
        "centroid": "boresight.estimators.approach.centroid:CentroidEstimator",
        "centroid-phase": "boresight.estimators.approach.matching:LambertCorrelation",
        "limb": "boresight.estimators.approach.limb:LimbEstimator",
        "silhouette": "boresight.estimators.approach.matching:SilhouetteEstimator",
        "landmark-harris": "boresight.estimators.landmark.recognizer:LandmarkRecognizer",
        "landmark-altimeter": "boresight.estimators.altimeter:AltimeterEstimator",
        "landmark-orb": "boresight.estimators.descriptors.recognizer:OrbNavigator",
        "landmark-sift": "boresight.estimators.descriptors.recognizer:SiftNavigator",
        "landmark-ransac": "boresight.estimators.landmark.robust.estimator:ConsensusRecognizer",
        "whole-image": "boresight.estimators.dense.photometric:WholeImageRecognizer",
        "photometric": "boresight.estimators.dense.photometric:PhotometricEstimator",
        "lmaps": "boresight.estimators.maplets.recognizer:MapletNavigator",
        "crater-pose": "boresight.estimators.craters.pose:CraterPose",
        "tuned": "boresight.estimators.tuned:TunedEstimator",
        "consensus": "boresight.estimators.consensus:ConsensusEstimator",
        "stars": "boresight.estimators.stars.navigator:StarNavigator",
        "prior": "boresight.estimators.prior:PriorEstimator",
    },
    group="boresight.estimators",
    parts=("name", "version", "from_options", "estimate"),
)
estimator_names, estimator_class = ESTIMATORS.names, ESTIMATORS.find

SEQUENCE_ESTIMATORS: Registry[SequenceEstimator] = Registry(
    own={
        "dead-reckoning": "boresight.estimators.slam.following:DeadReckoning",
        "ba-slam": "boresight.estimators.slam.keyframes.bundle:BundleSlam",
        "batch": "boresight.estimators.slam.smoothing.smoother:BatchAdjustment",
        "dynamic-smoother": "boresight.estimators.slam.smoothing.dynamic_smoother:DynamicSmoother",
        "consistent-ekf-slam": "boresight.estimators.slam.filters.ekf:ConsistentEkfSlam",
        "ekf-slam": "boresight.estimators.slam.filters.ekf:EkfSlam",
        "loop-smoother": "boresight.estimators.slam.smoothing.loop_smoother:LoopSmoother",
        "gtsam-fixed-lag": "boresight.estimators.slam.smoothing.gtsam_smoothers:GtsamFixedLag",
        "gtsam-isam2": "boresight.estimators.slam.smoothing.gtsam_smoothers:GtsamIsam2",
        "fixed-lag": "boresight.estimators.slam.smoothing.smoother:FixedLagSmoother",
        "iterated-ekf-slam": "boresight.estimators.slam.filters.ekf:IteratedEkfSlam",
    },
    group="boresight.sequence_estimators",
    parts=("name", "version", "from_options", "follow"),
)
EXTRAS = {"gtsam-fixed-lag": "gtsam", "gtsam-isam2": "gtsam", "crater-onnx": "onnxruntime"}
"""Estimators that need an extra of the installation, and the package of the same name that it installs."""
FILE_OPTIONS = {"crater-onnx": "model"}
"""Estimators with an option that names a file, whose content decides about the rows, and that option."""

sequence_estimator_names, sequence_estimator_class = SEQUENCE_ESTIMATORS.names, SEQUENCE_ESTIMATORS.find

DETECTORS: Registry[CraterDetector] = Registry(
    own={
        "crater-classic": "boresight.estimators.craters.detection.classic:CraterClassic",
        "crater-heat-map": "boresight.estimators.craters.learned.heat_map_detector:CraterHeatMap",
        "crater-learned": "boresight.estimators.craters.learned.detector:CraterLearned",
        "crater-onnx": "boresight.estimators.craters.learned.onnx_detector:CraterOnnx",
    },
    group="boresight.crater_detectors",
    parts=("name", "version", "from_options", "detect"),
)
crater_detector_names, crater_detector_class = DETECTORS.names, DETECTORS.find


def named_detector_versions() -> list[int]:
    """Return the versions of the detectors of craters that a name alone makes, without a file."""
    return [crater_detector_class(name).version for name in crater_detector_names() if name not in FILE_OPTIONS]


MATCHERS: Registry[CraterMatcher] = Registry(
    own={
        "context": "boresight.estimators.craters.matching.context:ContextMatcher",
        "correlation": "boresight.estimators.craters.matching.correlation:CorrelationMatcher",
        "hybrid": "boresight.estimators.craters.matching.hybrid:HybridMatcher",
        "invariants": "boresight.estimators.craters.matching.invariants:InvariantMatcher",
        "vote": "boresight.estimators.craters.matching.vote:VoteMatcher",
    },
    group="boresight.crater_matchers",
    parts=("name", "version", "from_options", "match"),
)
crater_matcher_names, crater_matcher_class = MATCHERS.names, MATCHERS.find

ORBIT_ESTIMATORS: Registry[OrbitEstimator] = Registry(
    own={"batch-filter": "boresight.estimators.orbit.batch_filter:BatchFilter"},
    group="boresight.orbit_estimators",
    parts=("name", "version", "from_options", "determine"),
)
orbit_estimator_names, orbit_estimator_class = ORBIT_ESTIMATORS.names, ORBIT_ESTIMATORS.find


def needed_sensors(name: str) -> frozenset[str]:
    """Return the sensors that an estimator needs in addition to the camera; empty for most."""
    return frozenset(cast("Iterable[str]", _said_by(name, "sensors", ())))


def fuses_prior(name: str) -> bool:
    """Whether the class of an estimator declares that it fuses the prior."""
    return _said_by(name, "fuses_prior", False) is True


BASES = {
    "base": "options", "second": "second_options",
    "far": "far_options", "middle": "middle_options", "near": "near_options",
}  # fmt: skip
"""Options and class attributes that name an estimator that another builds on, with the section of its options."""


@dataclass(frozen=True, slots=True)
class Base:
    """An estimator that another builds on: the option that names it, its name, the key of its options and these."""

    key: str
    name: str
    section: str
    options: Mapping[str, object]


def bases_of(name: str, options: Mapping[str, object]) -> tuple[Base, ...]:
    """Return the estimators that another builds on, by its options or class attributes; none for most."""
    found = []
    for key, section in BASES.items():
        default, given = _said_by(name, key, None), options.get(section)
        if isinstance(default, str) and (chosen := options.get(key, default)):
            of_base = cast("Mapping[str, object]", given) if isinstance(given, Mapping) else {}
            found.append(Base(key, str(chosen), section, of_base))
    return tuple(found)


def with_bases(name: str, options: Mapping[str, object]) -> tuple[str, ...]:
    """Return the name of an estimator, those of the ones that it builds on, and of those that these build on."""
    return name, *(found for base in bases_of(name, options) for found in with_bases(base.name, base.options))


def can_predict(name: str, options: Mapping[str, object]) -> bool:
    """Return whether an estimator can predict its covariance; one that builds on others needs one that can."""
    bases = bases_of(name, options)
    able = not bases or any(can_predict(base.name, base.options) for base in bases)
    return able and hasattr(estimator_class(name), "predict")


def built_base(name: str, options: Mapping[str, object], assets: Assets, section: str = "options") -> Estimator:
    """Build an estimator for another one that has its options in ``section``.

    Raise `BoresightError` if it cannot be built; errors of its options name the section.
    """
    try:
        return estimator_class(name).from_options(options, assets)
    except OptionsError as error:
        error.sections = (section, *error.sections)
        raise


def _said_by(name: str, attribute: str, default: object) -> object:
    """Return an attribute of an estimator's class; the default where it has none, or the name is of another kind."""
    if ":" in name or name in ESTIMATORS:
        return getattr(class_at(name) if ":" in name else estimator_class(name), attribute, default)
    return default

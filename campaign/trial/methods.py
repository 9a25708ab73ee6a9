"""Build the methods of a campaign: wrong options are refused, a method that cannot be built fails in its own rows."""

from __future__ import annotations

import json
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import NoReturn, TypeVar, cast

from boresight.campaign.pool.guard import unmoved
from boresight.campaign.products import MissingProduct
from boresight.campaign.resolved import ResolvedCampaign
from boresight.estimators.contract import Assets, NoProductError
from boresight.estimators.options import OptionsError
from boresight.estimators.registry import estimator_class
from boresight.scenarios.errors import BoresightError, MachineError, text_of
from boresight.scenarios.geometry import Camera
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.onboard import onboard_camera
from boresight.scenarios.spec.campaign import EstimatorSpec

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Unbuilt:
    """Reason and traceback of a method that could not be built for a scenario."""

    reason: str
    trace: str


def build_all(
    campaign: ResolvedCampaign,
    scenario: LoadedScenario,
    entries: Sequence[EstimatorSpec],
    make: Callable[[EstimatorSpec], T],
) -> dict[str, T | Unbuilt]:
    """Build the methods of a campaign that need no assets, by their labels; refuse wrong options."""
    found: dict[str, T | Unbuilt] = {}
    for entry in entries:
        with located(campaign, entry.label):
            found[entry.label] = try_build(entry, scenario.spec.name, partial(make, entry), BoresightError)
    return found


@contextmanager
def located(campaign: ResolvedCampaign, label: str) -> Iterator[None]:
    """Add file and line to errors about an estimator of a campaign, or its options."""
    try:
        yield
    except (MachineError, NoProductError):
        raise
    except BoresightError as error:
        one = campaign.entry("estimators", label)
        if one is None:
            raise
        for name, options in (one.section or {}).items():
            if isinstance(error, OptionsError):
                raise error.located(options, name) from error
        raise BoresightError(f"{one.place}: {error}") from error


def try_build(
    entry: EstimatorSpec, scenario: str, make: Callable[[], T], refused: type[BoresightError] = MachineError
) -> T | Unbuilt:
    """Build a method for a scenario; return the reason if it cannot be built.

    Raise BoresightError if ``make`` raises one of the kind ``refused``, which ends the run.
    """
    try:
        with unmoved():
            return make()
    except (KeyboardInterrupt, refused):
        raise
    except NoProductError as error:
        return Unbuilt(str(error), _trace(error))
    except BaseException as error:  # noqa: BLE001  whatever a method raises is its own fault
        options = f"its options are {json.dumps(entry.options)}" if entry.options else "its options are the defaults"
        reason = f"{entry.label} cannot be built for {scenario}: {text_of(error)}; {options}"
        return Unbuilt(reason, _trace(error))


def require_built(method: T | Unbuilt) -> T:
    """Return a method that was built.

    Raise `NoProductError` if it could not be built, with the traceback as a note. Each call raises a new exception: the
    traceback of one that is raised again would grow with each trial.
    """
    if not isinstance(method, Unbuilt):
        return method
    error = NoProductError(method.reason)
    error.add_note(method.trace)
    raise error


def unbuilt_products(scenario: LoadedScenario, found: Mapping[str, object]) -> list[MissingProduct]:
    """List the methods, by their labels, that could not be built."""
    name = scenario.spec.name
    return [MissingProduct(name, label, one.reason) for label, one in found.items() if isinstance(one, Unbuilt)]


def check_options(campaign: ResolvedCampaign, scenario: LoadedScenario, entries: Sequence[EstimatorSpec]) -> None:
    """Refuse wrong options of estimators before any product is built.

    An estimator reads its options before it requests a shape, a renderer or a product. Later errors, and those that are
    no `BoresightError`, are reported when the estimator is built.
    """
    for entry in entries:
        assets = _CameraAlone(onboard_camera(scenario.spec))
        try:
            with unmoved(), located(campaign, entry.label):
                estimator_class(entry.name).from_options(entry.options, cast("Assets", assets))
        except KeyboardInterrupt:
            raise
        except BoresightError as error:
            if not (assets.requested or isinstance(error, NoProductError)):
                raise
        except BaseException:  # noqa: BLE001, S112  raised again when the estimator is built
            continue


class _CameraAlone:
    """Assets with only the camera; ``requested``: whether anything else was requested."""

    def __init__(self, camera: Camera) -> None:
        self.camera = camera
        self.requested = False

    def __getattr__(self, name: str) -> NoReturn:
        self.requested = True
        raise NoProductError("options are checked before anything is built")


def _trace(error: BaseException) -> str:
    return "".join(traceback.format_exception(error))

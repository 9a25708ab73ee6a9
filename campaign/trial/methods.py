"""Methods as a campaign builds them: wrong options are refused first, what cannot be built costs its own rows alone."""

from __future__ import annotations

import json
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import NoReturn, TypeVar

from boresight.campaign.pool.guard import unmoved
from boresight.campaign.products import MissingProduct
from boresight.campaign.resolved import ResolvedCampaign
from boresight.estimators.contract import ImageRenderer, NoProductError
from boresight.estimators.options import OptionsError
from boresight.estimators.registry import estimator_class
from boresight.scenarios.errors import BoresightError, MachineError, text_of
from boresight.scenarios.geometry import Camera, TriangleMesh
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.onboard import onboard_camera
from boresight.scenarios.spec.campaign import EstimatorSpec

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Unbuilt:
    """Why a method cannot be built in a scenario, and the trace of that."""

    reason: str
    trace: str


def methods(
    campaign: ResolvedCampaign, scenario: LoadedScenario, make: Callable[[EstimatorSpec], T]
) -> dict[str, T | Unbuilt]:
    """Build the methods of a campaign by their labels, where they are lent nothing; wrong options are refused."""
    found: dict[str, T | Unbuilt] = {}
    for entry in campaign.spec.estimators:
        with located(campaign, entry.label):
            found[entry.label] = built(entry, scenario.spec.name, partial(make, entry), BoresightError)
    return found


@contextmanager
def located(campaign: ResolvedCampaign, label: str) -> Iterator[None]:
    """Put file and line before what is raised about an estimator of a campaign, or its options."""
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


def built(
    entry: EstimatorSpec, scenario: str, make: Callable[[], T], refused: type[BoresightError] = MachineError
) -> T | Unbuilt:
    """Build a method for a scenario, or say why it cannot be.

    Raises
    ------
    BoresightError
        If ``make`` raises one of the kind ``refused``, which ends the run.
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


def able(method: T | Unbuilt) -> T:
    """Return a method.

    Raises
    ------
    NoProductError
        If there is none, with the trace of why. It is another one each time: the traceback of one that is raised again
        grows with each trial.
    """
    if not isinstance(method, Unbuilt):
        return method
    error = NoProductError(method.reason)
    error.add_note(method.trace)
    raise error


def missing(scenario: LoadedScenario, found: Mapping[str, object]) -> list[MissingProduct]:
    """List the methods, by their labels, that could not be built."""
    name = scenario.spec.name
    return [MissingProduct(name, label, one.reason) for label, one in found.items() if isinstance(one, Unbuilt)]


def check_options(campaign: ResolvedCampaign, scenario: LoadedScenario) -> None:
    """Refuse wrong options of estimators, before anything is built that one of them asks for.

    An estimator reads its options before it asks for a shape, a renderer or a product. What it raises later, or what is
    no `BoresightError`, is told when it is built.
    """
    for entry in campaign.spec.estimators:
        nothing = _NothingYet(onboard_camera(scenario.spec))
        try:
            with unmoved(), located(campaign, entry.label):
                estimator_class(entry.name).from_options(entry.options, nothing)
        except KeyboardInterrupt:
            raise
        except BoresightError as error:
            if not (nothing.asked or isinstance(error, NoProductError)):
                raise
        except BaseException:  # noqa: BLE001, S112  it comes again when the estimator is built
            continue


class _NothingYet:
    """Assets of which only the camera can be lent yet; ``asked`` tells whether another was asked for."""

    def __init__(self, camera: Camera) -> None:
        self.camera = camera
        self.asked = False

    def mesh_renderer(self, mesh: TriangleMesh, samples_per_pixel: int = 1) -> ImageRenderer:
        """Lend nothing."""
        self._refuse()

    def shape(self) -> TriangleMesh:
        """Lend nothing."""
        self._refuse()

    def product(self, kind: str, options: Mapping[str, object]) -> object:
        """Lend nothing."""
        self._refuse()

    def _refuse(self) -> NoReturn:
        self.asked = True
        raise NoProductError("options are checked before anything is built")


def _trace(error: BaseException) -> str:
    return "".join(traceback.format_exception(error))

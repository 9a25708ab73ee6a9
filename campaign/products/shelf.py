"""Where estimators find the products of a scenario, and where those are built."""

from __future__ import annotations

import json
import shutil
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from campaign.draft import drafted
from campaign.imaging.world import believed
from campaign.products.databases import differs, of_database, with_knowledge, with_world
from campaign.products.keys import content_key
from campaign.products.kinds import product_kind
from estimators.contract import ImageRenderer, NoProductError
from renderers.mitsuba3 import MitsubaRenderer, choose_variant
from scenarios.atomic import explain_write_error
from scenarios.bodies import load_body
from scenarios.cache import default_cache
from scenarios.errors import BoresightError, MachineError, text_of
from scenarios.geometry import Camera, TriangleMesh
from scenarios.load import LoadedScenario
from scenarios.spec.base import SpecModel

_UNMADE = "unmade.txt"
"""The file that says, in place of a product, why it cannot be made."""

_TRACE = "traceback.txt"
"""Beside it the trace, where making the product failed for another reason than that the scenario has none."""


def product_key(scenario: LoadedScenario, kind: str, options: SpecModel, variant: str) -> str:
    """Return the content hash of a product: whatever would change it changes the key."""
    return content_key(scenario, kind, options, product_kind(kind).versions(), variant)


@dataclass(frozen=True, slots=True)
class BuiltProduct:
    """A product that an estimator asked for.

    Its kind, for whom it is, its folder below ``RUN/products``, and the number of the data base that it belongs to.
    """

    kind: str
    scenario: str
    estimator: str
    folder: str
    database: int = 0


@dataclass(frozen=True, slots=True)
class MissingProduct:
    """A product that cannot be made: in which scenario, for whom, and why."""

    scenario: str
    estimator: str
    reason: str


class Shelf:
    """Lends assets to estimators: camera, shape, renderers of meshes, and products kept in the run folder.

    All of it is made from what the spacecraft believes of the scenario, which is the truth wherever the section
    ``onboard`` says nothing else.

    Parameters
    ----------
    scenario
        The scenario whose products are on the shelf, as it is in truth.
    folder
        ``RUN/products``: each product in a folder of its own, so that a run stands alone.
    jobs
        Workers to build with; 0 where nothing may be built (in a worker).
    variant
        The Mitsuba variant.
    tell
        Told before something is built.
    draft
        Share of the images that data bases are made of, see `campaign.draft`.
    database
        Number of the data base, see `campaign.products.databases`.
    """

    def __init__(
        self,
        scenario: LoadedScenario,
        folder: Path,
        jobs: int,
        variant: str,
        tell: Callable[[str], None] | None = None,
        draft: float = 1.0,
        database: int = 0,
    ) -> None:
        self._true_scenario = scenario
        self._database = database
        self._scenario = believed(with_knowledge(with_world(scenario, database), database))
        self._folder = folder
        self._jobs = jobs
        self._variant = variant
        self._tell = tell
        self._draft = draft
        self._lent: list[tuple[str, str]] = []
        self._has_lent_shape = False

    def empty(self, database: int = 0) -> Shelf:
        """Return the same shelf of a data base with nothing lent yet."""
        return Shelf(self._true_scenario, self._folder, self._jobs, self._variant, self._tell, self._draft, database)

    @property
    def has_lent_what_is_drawn(self) -> bool:
        """Tell whether what was lent would be another thing in another data base."""
        drawn = differs(self._true_scenario)
        return bool(self._lent) or "world" in drawn or ("knowledge" in drawn and self._has_lent_shape)

    @property
    def camera(self) -> Camera:
        """The pinhole that the spacecraft calculates with: the images that estimators see have been resampled to it."""
        return self._scenario.spec.camera.camera().pinhole

    def shape(self) -> TriangleMesh:
        """Return the full shape that the spacecraft carries."""
        self._has_lent_shape = True
        return load_body(self._scenario.spec.body, self._scenario.search_dirs).mesh

    def mesh_renderer(self, mesh: TriangleMesh, samples_per_pixel: int = 1) -> ImageRenderer:
        """Return a renderer of ``mesh`` in the BRDF that the spacecraft believes in."""
        return MitsubaRenderer(
            mesh,
            self._scenario.spec.brdf,
            samples_per_pixel=samples_per_pixel,
            shading="flat",
            variant=choose_variant(self._variant),
        )

    def product(self, kind: str, options: Mapping[str, object]) -> object:
        """Return a product, built first where that is allowed.

        Raises
        ------
        NoProductError
            If it cannot be made of the scenario; that is kept in place of the product.
        MachineError
            If the machine cannot make, store or read it.
        """
        maker = product_kind(kind)
        wanted = of_database(drafted(maker.parse(options), self._draft), self._database)
        folder = self._folder / f"{kind}-{product_key(self._scenario, kind, wanted, self._variant)}"
        if not folder.exists():
            self._fetch(kind, wanted, folder)
        if (folder / _UNMADE).exists():
            raise self._unmade(kind, folder)
        self._lent.append((kind, folder.name))
        try:
            return maker.load(folder)
        except BoresightError as error:
            raise MachineError(str(error)) from error

    def _unmade(self, kind: str, folder: Path) -> NoProductError:
        """Read why a product cannot be made."""
        reason = (folder / _UNMADE).read_text(encoding="utf-8")
        error = NoProductError(f"the {_words(kind)} of {self._scenario.spec.name} cannot be made: {reason}")
        if (folder / _TRACE).exists():
            error.add_note((folder / _TRACE).read_text(encoding="utf-8"))
        return error

    def lent_to(self, estimator: str) -> list[BuiltProduct]:
        """List the products that were asked for so far, as those of an estimator."""
        name = self._scenario.spec.name
        return [BuiltProduct(kind, name, estimator, folder, self._database) for kind, folder in self._lent]

    def _fetch(self, kind: str, options: SpecModel, folder: Path) -> None:
        if self._jobs == 0:
            raise MachineError(f"{folder}: the product is missing from the run folder: run the campaign again")
        maker, started = product_kind(kind), time.perf_counter()

        def build(place: Path) -> None:
            if self._tell is not None:
                name = self._scenario.spec.name
                which = f", number {self._database}" if self._database else ""
                self._tell(f"building the {_words(kind)} of {name}{which}: {maker.announcement(options)}")
            try:
                facts = maker.build(self._scenario, options, place, self._jobs, self._variant) or {}
            except NoProductError as error:
                (place / _UNMADE).write_text(str(error), encoding="utf-8")
                return
            seconds = {"seconds": time.perf_counter() - started}
            (place / "built.json").write_text(json.dumps({**seconds, **facts}), encoding="utf-8")
            if self._tell is not None and facts:
                self._tell("; ".join(f"{name.replace('_', ' ')}: {value}" for name, value in facts.items()))

        try:
            cached = default_cache().folder(kind, folder.name.rsplit("-", 1)[1], build)
        except (KeyboardInterrupt, MachineError):
            raise
        except BaseException as error:  # noqa: BLE001  one product less must not end the run
            _raise_of_machine(folder, error)
            # Not in the cache: a later run may have the memory, or the version, that this one lacks.
            _place_unmade(folder, error, options)
            return
        _place(cached, folder)


def _words(kind: str) -> str:
    return kind.replace("-", " ")


def _raise_of_machine(folder: Path, error: BaseException) -> None:
    """Raise a fault of the machine as one: a full disk makes a product fail that the same command can make later."""
    if isinstance(error, OSError):
        raise MachineError(explain_write_error(error.filename or folder, error)) from error
    if isinstance(error, BoresightError) and isinstance(error.__cause__, OSError):
        raise MachineError(str(error)) from error


def _place(cached: Path, folder: Path) -> None:
    """Copy a product into the run."""

    def copy(place: Path) -> None:
        for file in sorted(cached.iterdir()):
            shutil.copy2(file, place)

    _fill(folder, copy)


def _place_unmade(folder: Path, error: BaseException, options: SpecModel) -> None:
    """Keep in the run why a product could not be made."""
    given = options.model_dump_json(exclude_defaults=True)
    asked = "the defaults" if given == "{}" else f"{given}, others the defaults"

    def write(place: Path) -> None:
        (place / _UNMADE).write_text(f"{text_of(error)}; its options are {asked}", encoding="utf-8")
        (place / _TRACE).write_text("".join(traceback.format_exception(error)), encoding="utf-8", errors="replace")

    _fill(folder, write)


def _fill(folder: Path, fill: Callable[[Path], None]) -> None:
    """Let a folder of the run be filled, whole or not at all."""
    temporary = folder.with_name(f".{folder.name}.tmp")
    try:
        shutil.rmtree(temporary, ignore_errors=True)
        temporary.mkdir(parents=True)
        fill(temporary)
        temporary.replace(folder)
    except OSError as error:
        shutil.rmtree(temporary, ignore_errors=True)
        raise MachineError(explain_write_error(folder, error)) from error

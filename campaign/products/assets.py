"""Assets of estimators: camera, shape, renderers, and products that are built once and stored in the run folder."""

from __future__ import annotations

import json
import shutil
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import cast

from boresight.campaign.handles import Handle, target_of
from boresight.campaign.imaging.world import believed
from boresight.campaign.products.databases import (
    ProductKind,
    content_key,
    drawn_per_database,
    with_database_craters,
    with_database_knowledge,
    with_database_seed,
)
from boresight.campaign.resolved import drafted
from boresight.campaign.threads import one_blas_thread
from boresight.estimators.contract import ImageRenderer, NoProductError
from boresight.renderers.mitsuba3 import MitsubaRenderer, choose_variant
from boresight.scenarios.atomic import explain_write_error
from boresight.scenarios.bodies import Body, load_body
from boresight.scenarios.cache import default_cache
from boresight.scenarios.errors import BoresightError, MachineError, text_of
from boresight.scenarios.geometry import Camera, TriangleMesh
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.spec.base import SpecModel
from boresight.scenarios.spec.brdf import LambertSpec, LommelSeeligerSpec, OrenNayarSpec
from boresight.scenarios.spec.stars import open_stars
from boresight.scenarios.stars import StarCatalog

_FAILURE = "unmade.txt"
"""File with the reason why a product cannot be built, in place of the product."""

_BYTES = 12
"""Bytes that a vertex or a facet takes on board: three numbers of 32 bits."""

_TRACE = "traceback.txt"
"""File with the traceback, if the build failed by an unexpected exception."""

KINDS = {
    "landmark-database": "landmark_database",
    "maplets": "landmark_database",
    "descriptors": "landmark_database",
    "crater-database": "crater_database",
    "covariance-tuning": "covariance_tuning",
}
"""Kinds of products, with the modules of this folder that build them, imported when a method asks for one."""


def product_kind(name: str) -> ProductKind[SpecModel, object]:
    """Look up a kind; raise BoresightError if there is none of that name."""
    if name not in KINDS:
        raise BoresightError(f"no product is called {name!r}; there are: {', '.join(sorted(KINDS))}")
    module = import_module(f"boresight.campaign.products.{KINDS[name]}")
    return cast("ProductKind[SpecModel, object]", module.PRODUCTS[name])


def product_key(scenario: LoadedScenario, kind: str, options: SpecModel, variant: str) -> str:
    """Return the hash of everything that determines a product."""
    product = product_kind(kind)
    return content_key(scenario, kind, options, product.versions(), variant, product.of_views)


@dataclass(frozen=True, slots=True)
class BuiltProduct:
    """A product used by an estimator.

    Its kind, scenario and estimator, its folder below ``RUN/products``, and the number of its data base.
    """

    kind: str
    scenario: str
    estimator: str
    folder: str
    database: int = 0


@dataclass(frozen=True, slots=True)
class MissingProduct:
    """A product that cannot be built: its scenario and estimator, and the reason."""

    scenario: str
    estimator: str
    reason: str


@dataclass(frozen=True, slots=True)
class OnboardShape:
    """The size of the shape that an estimator has on board: its ``facets``, and ``bytes`` for them and the vertices."""

    scenario: str
    estimator: str
    facets: int
    bytes: int


Prepared = BuiltProduct | MissingProduct | OnboardShape
"""What a method is found to need before the first trial."""


class EstimatorAssets(Handle):
    """The `Assets` that an estimator gets: a handle of `BuiltAssets`, which hold scenarios and folders."""

    __slots__ = ()

    @property
    def camera(self) -> Camera:
        """The camera of the scenario."""
        return _built(self).camera

    def shape(self) -> TriangleMesh:
        """Return the full onboard shape."""
        return _built(self).shape()

    def stars(self) -> StarCatalog:
        """Return the catalogue of stars."""
        return _built(self).stars()

    def mesh_renderer(
        self, mesh: TriangleMesh, samples_per_pixel: int = 1, *, other_law: bool = False
    ) -> ImageRenderer:
        """Return a renderer of ``mesh`` with the onboard BRDF, or another law."""
        return _built(self).mesh_renderer(mesh, samples_per_pixel, other_law=other_law)

    def product(self, kind: str, options: Mapping[str, object]) -> object:
        """Return a product."""
        return _built(self).product(kind, options)


def _built(handle: EstimatorAssets) -> BuiltAssets:
    return cast("BuiltAssets", target_of(handle))


class BuiltAssets:
    """Assets of the estimators of a scenario: camera, shape, renderers of meshes, and products in the run folder.

    All of them come from the believed scenario, which equals the true ``scenario`` except for the section ``onboard``.
    ``folder`` is ``RUN/products``, with a folder for each product, so that a run is self-contained. With ``jobs`` None,
    in a worker, nothing is built, and a missing product is an error. ``report`` is called with a message before and
    after each build. ``draft`` is the fraction of the images of data bases, see `as_draft`, ``database`` the
    number of the data base, see `campaign.products.databases`. The last shape is held in ``kept``: the next method, and
    with a list for several scenarios the next of these, mostly asks for the same one.
    """

    def __init__(
        self,
        scenario: LoadedScenario,
        folder: Path,
        jobs: int | None,
        variant: str,
        report: Callable[[str], None] | None = None,
        draft: float = 1.0,
        database: int = 0,
        kept: list[Body] | None = None,
    ) -> None:
        self._true_scenario = scenario
        self._database = database
        self._scenario = believed(with_database_knowledge(with_database_craters(scenario, database), database))
        self._folder = folder
        self.jobs = jobs
        self._variant = variant
        self.report = report
        self._draft = draft
        self._used: list[tuple[str, str]] = []
        self._uses_shape = False
        self._kept = [] if kept is None else kept

    def for_estimator(self) -> EstimatorAssets:
        """Return what an estimator gets of these assets."""
        return EstimatorAssets(self)

    def for_database(self, database: int = 0) -> BuiltAssets:
        """Return the same assets for a data base, with no product used yet."""
        return BuiltAssets(
            self._true_scenario, self._folder, self.jobs, self._variant, self.report, self._draft, database, self._kept
        )

    @property
    def depends_on_database(self) -> bool:
        """Whether the assets used so far differ between data bases."""
        drawn = drawn_per_database(self._true_scenario)
        return bool(self._used) or "world" in drawn or ("knowledge" in drawn and self._uses_shape)

    @property
    def camera(self) -> Camera:
        """Pinhole camera that the spacecraft assumes, to which the images of estimators are resampled."""
        return self._scenario.spec.camera.camera().pinhole

    def shape(self) -> TriangleMesh:
        """Return the full believed shape."""
        self._uses_shape = True
        self._kept[:] = [load_body(self._scenario.spec.body, self._scenario.search_dirs)]
        return self._kept[0].mesh

    def stars(self) -> StarCatalog:
        """Return the catalogue of the scenario's stars; raise `NoProductError` if it has none."""
        spec = self._scenario.spec
        if spec.stars is None:
            raise NoProductError(f"{spec.name}: stars: missing, so the images show none: add the section")
        return open_stars(spec.stars, self._scenario.search_dirs)

    def mesh_renderer(
        self, mesh: TriangleMesh, samples_per_pixel: int = 1, *, other_law: bool = False
    ) -> ImageRenderer:
        """Return a renderer of ``mesh`` with the believed BRDF, or with a law that darkens the limb differently."""
        brdf = self._scenario.spec.brdf
        if other_law:
            diffuse = isinstance(brdf, LambertSpec | OrenNayarSpec)
            brdf = LommelSeeligerSpec(kind="lommel-seeliger") if diffuse else LambertSpec()
        return MitsubaRenderer(
            mesh,
            brdf,
            samples_per_pixel=samples_per_pixel,
            shading="flat",
            variant=choose_variant(self._variant),
        )

    def product(self, kind: str, options: Mapping[str, object]) -> object:
        """Return a product, building it if it is missing and builds are allowed.

        Raise `NoProductError` if it cannot be built from the scenario; the reason is stored in place of the product.
        Raise `MachineError` if the machine cannot build, store or read it.
        """
        product = product_kind(kind)
        wanted = with_database_seed(drafted(product.options.model_validate(options), self._draft), self._database)
        folder = self._folder / f"{kind}-{product_key(self._scenario, kind, wanted, self._variant)}"
        if not folder.exists():
            self._build(kind, wanted, folder)
        if (folder / _FAILURE).exists():
            reason = (folder / _FAILURE).read_text(encoding="utf-8")
            failure = NoProductError(f"the {_in_words(kind)} of {self._scenario.spec.name} cannot be made: {reason}")
            if (folder / _TRACE).exists():
                failure.add_note((folder / _TRACE).read_text(encoding="utf-8"))
            raise failure
        self._used.append((kind, folder.name))
        try:
            return product.load(folder)
        except BoresightError as error:
            raise MachineError(str(error)) from error

    def products_of(self, estimator: str) -> list[BuiltProduct]:
        """Return the products used so far, attributed to an estimator."""
        name = self._scenario.spec.name
        return [BuiltProduct(kind, name, estimator, folder, self._database) for kind, folder in self._used]

    def shape_of(self, estimator: str) -> list[OnboardShape]:
        """Return the shape, if it was used so far, attributed to an estimator."""
        if not self._uses_shape:
            return []
        mesh = self.shape()
        size = _BYTES * (len(mesh.vertices_m) + len(mesh.faces))
        return [OnboardShape(self._scenario.spec.name, estimator, len(mesh.faces), size)]

    def _build(self, kind: str, options: SpecModel, folder: Path) -> None:
        jobs = self.jobs
        if jobs is None:
            raise MachineError(f"{folder}: the product is missing from the run folder: run the campaign again")
        product, start_s = product_kind(kind), time.perf_counter()

        def build(place: Path) -> None:
            if self.report is not None:
                name = self._scenario.spec.name
                number = f", number {self._database}" if self._database else ""
                self.report(f"building the {_in_words(kind)} of {name}{number}: {product.announce(options)}")
            try:
                # With one job it is built in this process, with more partly here and partly in workers.
                with one_blas_thread():
                    facts = product.build(self._scenario, options, place, jobs, self._variant) or {}
            except NoProductError as error:
                (place / _FAILURE).write_text(str(error), encoding="utf-8")
                return
            seconds = {"seconds": time.perf_counter() - start_s}
            (place / "built.json").write_text(json.dumps({**seconds, **facts}), encoding="utf-8")
            if self.report is not None and facts:
                self.report("; ".join(f"{name.replace('_', ' ')}: {value}" for name, value in facts.items()))

        try:
            cached = default_cache().folder(kind, folder.name.rsplit("-", 1)[1], build)
        except (KeyboardInterrupt, MachineError):
            raise
        except BaseException as error:
            # A fault of the machine, such as a full disk: the same command can succeed later.
            if isinstance(error, OSError):
                raise MachineError(explain_write_error(error.filename or folder, error)) from error
            if isinstance(error, BoresightError) and isinstance(error.__cause__, OSError):
                raise MachineError(str(error)) from error
            # Not cached: a later run may have more memory, or a corrected version of the code.
            _store_failure(folder, error, options)
            return
        _write_folder(folder, lambda place: [shutil.copy2(file, place) for file in sorted(cached.iterdir())])


def _in_words(kind: str) -> str:
    return kind.replace("-", " ")


def _store_failure(folder: Path, error: BaseException, options: SpecModel) -> None:
    """Store in the run folder why a product could not be built."""
    given = options.model_dump_json(exclude_defaults=True)
    listed = "the defaults" if given == "{}" else f"{given}, others the defaults"

    def write(place: Path) -> None:
        (place / _FAILURE).write_text(f"{text_of(error)}; its options are {listed}", encoding="utf-8")
        (place / _TRACE).write_text("".join(traceback.format_exception(error)), encoding="utf-8", errors="replace")

    _write_folder(folder, write)


def _write_folder(folder: Path, fill: Callable[[Path], object]) -> None:
    """Write a folder of the run atomically."""
    temporary = folder.with_name(f".{folder.name}.tmp")
    try:
        shutil.rmtree(temporary, ignore_errors=True)
        temporary.mkdir(parents=True)
        fill(temporary)
        temporary.replace(folder)
    except OSError as error:
        shutil.rmtree(temporary, ignore_errors=True)
        raise MachineError(explain_write_error(folder, error)) from error

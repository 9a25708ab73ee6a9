"""Where estimators find the products of a scenario, and where those are built."""

from __future__ import annotations

import hashlib
import json
import shutil
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from campaign.products import landmark_database
from campaign.store.atomic import explain
from campaign.world import typical_range_m
from estimators.contract import ImageRenderer
from estimators.landmark.build import METHOD_VERSION, DatabaseOptions
from renderers.mitsuba3 import MitsubaRenderer, choose_variant
from scenarios.bodies import body_digest
from scenarios.cache import default_cache
from scenarios.errors import BoresightError
from scenarios.geometry import Camera, TriangleMesh
from scenarios.load import LoadedScenario, canonical_json


def product_key(scenario: LoadedScenario, kind: str, options: DatabaseOptions, variant: str) -> str:
    """Return the content hash of a product: whatever would change it changes the key."""
    spec = scenario.spec
    parts = {
        "kind": kind,
        "options": json.loads(options.model_dump_json()),
        "body": body_digest(spec.body, scenario.search_dirs),
        "scenario": [canonical_json(part) for part in (spec.camera, spec.brdf, spec.rendering)],
        "shading": spec.body.shading,
        "range_m": typical_range_m(scenario),
        "versions": [landmark_database.VERSION, METHOD_VERSION, MitsubaRenderer.version],
        "variant": variant,
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:20]


@dataclass(frozen=True, slots=True)
class BuiltProduct:
    """A product that an estimator asked for: its kind, for whom it is, and its folder below ``RUN/products``."""

    kind: str
    scenario: str
    estimator: str
    folder: str


class Shelf:
    """Lends assets to estimators: camera, renderers of meshes, and products kept in the run folder.

    Parameters
    ----------
    scenario
        The scenario whose products are on the shelf.
    folder
        ``RUN/products``: each product in a folder of its own, so that a run stands alone.
    jobs
        Workers to build with; 0 where nothing may be built (in a worker).
    variant
        The Mitsuba variant.
    tell
        Told before something is built.
    """

    def __init__(
        self,
        scenario: LoadedScenario,
        folder: Path,
        jobs: int,
        variant: str,
        tell: Callable[[str], None] | None = None,
    ) -> None:
        self._scenario = scenario
        self._folder = folder
        self._jobs = jobs
        self._variant = variant
        self._tell = tell
        self._lent: list[tuple[str, str]] = []

    @property
    def camera(self) -> Camera:
        """The camera of the scenario."""
        return self._scenario.spec.camera.camera()

    def mesh_renderer(self, mesh: TriangleMesh) -> ImageRenderer:
        """Return a renderer of ``mesh`` in the scenario's BRDF."""
        spec = self._scenario.spec
        return MitsubaRenderer(
            mesh, spec.brdf, samples_per_pixel=1, shading="flat", variant=choose_variant(self._variant)
        )

    def product(self, kind: str, options: Mapping[str, object]) -> object:
        """Return a product, built first where that is allowed."""
        if kind != landmark_database.KIND:
            raise BoresightError(f"no product is called {kind!r}: the only kind is {landmark_database.KIND}")
        wanted = DatabaseOptions.model_validate(options)
        folder = self._folder / f"{kind}-{product_key(self._scenario, kind, wanted, self._variant)}"
        if not folder.exists():
            self._fetch(wanted, folder)
        self._lent.append((kind, folder.name))
        return landmark_database.load(folder)

    def lent_to(self, estimator: str) -> list[BuiltProduct]:
        """List the products that were asked for so far, as those of an estimator."""
        return [BuiltProduct(kind, self._scenario.spec.name, estimator, folder) for kind, folder in self._lent]

    def _fetch(self, options: DatabaseOptions, folder: Path) -> None:
        if self._jobs == 0:
            raise BoresightError(f"{folder}: the product is missing from the run folder: run the campaign again")
        started = time.perf_counter()

        def build(place: Path) -> None:
            if self._tell is not None:
                self._tell(f"building the landmark data base of {self._scenario.spec.name}: {options.images} images")
            landmark_database.build(self._scenario, options, place, self._jobs, self._variant)
            about = {"seconds": time.perf_counter() - started, "images": options.images}
            (place / "built.json").write_text(json.dumps(about), encoding="utf-8")

        cached = default_cache().folder(landmark_database.KIND, folder.name.rsplit("-", 1)[1], build)
        _place(cached, folder)


def _place(cached: Path, folder: Path) -> None:
    """Copy a product into the run, whole or not at all."""
    temporary = folder.with_name(f".{folder.name}.tmp")
    try:
        shutil.rmtree(temporary, ignore_errors=True)
        temporary.mkdir(parents=True)
        for file in sorted(cached.iterdir()):
            shutil.copy2(file, temporary)
        temporary.replace(folder)
    except OSError as error:
        shutil.rmtree(temporary, ignore_errors=True)
        raise BoresightError(explain(folder, error)) from error

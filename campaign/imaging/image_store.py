"""Rendered images of a scenario, stored in the cache between runs.

The store contains radiance factors before the detector, which is fast and has a random stream of its own, so that a
changed detector reads the same images. The cache bounds its size; missing or damaged images are rendered again. Images
from the store equal rendered ones bit for bit.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from boresight.campaign.machine import package_versions, processor
from boresight.renderers.detector import Detector
from boresight.renderers.mitsuba3 import (
    BodyRenderer,
    MitsubaRenderer,
    PairRenderer,
    TiledRenderer,
    choose_variant,
    code_generator,
    renderer_version,
)
from boresight.scenarios.arrays import FloatArray, Image
from boresight.scenarios.bodies import load_body
from boresight.scenarios.cache import default_cache
from boresight.scenarios.craters import CrateredSurface, CraterTruth, crater_truth, cratered_surface, shape_digest
from boresight.scenarios.draw import Stream
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import TriangleMesh, View
from boresight.scenarios.load import LoadedScenario, canonical_json
from boresight.scenarios.parquet import PARQUET_FAULTS
from boresight.scenarios.reading import MOST_PIXELS
from boresight.scenarios.spec.base import SpecModel
from boresight.scenarios.spec.distribution import Law, drawn
from boresight.scenarios.spec.scenario import ScenarioSpec

KIND = "images"
SWITCH = "BORESIGHT_IMAGE_STORE"
_FORMAT = 1
_FILE = "images.parquet"
# A chunk is read and written as a whole: as many images as a block of trials, but at most this many pixels.
_CHUNK_IMAGES = 10
_CHUNK_PIXELS = 1 << 25


_SCHEMA = pa.schema(
    {
        "index": pa.int64(),
        "view": pa.binary(),
        "height_px": pa.int32(),
        "width_px": pa.int32(),
        "lit": pa.binary(),
        "values": pa.list_(pa.float32()),
    }
)

_MOST_BYTES = 5 * MOST_PIXELS
"""Largest uncompressed file: 4 bytes and one bit for each pixel, and room for indices and fingerprints."""


@dataclass(frozen=True, slots=True, eq=False)
class StoredImage:
    """Image (H, W) float32 with the fingerprint of its view."""

    image: Image
    view: bytes


def write_images(path: Path, images: Mapping[int, StoredImage]) -> None:
    """Write images by index, without loss of any bit, including negative zeros and NaN."""
    rows = []
    for index, kept in sorted(images.items()):
        pixels = np.ascontiguousarray(kept.image, dtype=np.float32)
        lit = pixels.view(np.uint32) != 0
        height, width = pixels.shape
        rows.append((index, kept.view, height, width, np.packbits(lit).tobytes(), pixels[lit]))
    table = pa.table(dict(zip(_SCHEMA.names, zip(*rows, strict=True), strict=True)), schema=_SCHEMA)
    pq.write_table(
        table,
        path,
        compression="zstd",
        compression_level=1,
        use_dictionary=False,
        use_byte_stream_split=["values.list.element"],
        write_statistics=False,
    )


def read_images(path: Path) -> dict[int, StoredImage]:
    """Read all images of a file as read-only arrays.

    A damaged file raises ValueError, KeyError, TypeError, OSError, or an error of pyarrow.
    """
    images: dict[int, StoredImage] = {}
    for batch in _stored(path).to_batches():
        for row in range(batch.num_rows):
            index, view, height, width, lit = (batch.column(name)[row].as_py() for name in _SCHEMA.names[:-1])
            image = np.zeros((height, width), dtype=np.float32)
            mask = np.unpackbits(np.frombuffer(lit, np.uint8), count=height * width).reshape(height, width)
            image[mask.view(np.bool_)] = batch.column("values")[row].values.to_numpy()
            image.setflags(write=False)
            images[index] = StoredImage(image, view)
    return images


def _stored(path: Path) -> pa.Table:
    """Read the rows of a file, checking the sizes before any image is decompressed."""
    with pq.ParquetFile(path) as file:
        about = file.metadata
        unfolded = sum(about.row_group(number).total_byte_size for number in range(about.num_row_groups))
        if not file.schema_arrow.equals(_SCHEMA) or max(unfolded, 8 * about.num_rows) > _MOST_BYTES:
            raise ValueError(f"{path}: no images, or more than a file holds")
        rows = file.read()
    sizes = rows.select(["height_px", "width_px"]).to_pylist()
    pixels = sum(size["height_px"] * size["width_px"] for size in sizes)
    if min((min(size.values()) for size in sizes), default=1) < 1 or pixels > MOST_PIXELS:
        raise ValueError(f"{path}: no images, or more pixels than a file holds")
    return rows


def store_is_on() -> bool:
    """Return whether the store is in use: $BORESIGHT_IMAGE_STORE is not ``off``."""
    return os.environ.get(SWITCH) != "off"


@contextmanager
def store_switched(on: bool) -> Iterator[None]:
    """Switch the store on or off inside the context, for child processes too."""
    before = os.environ.get(SWITCH)
    os.environ[SWITCH] = "on" if on else "off"
    try:
        yield
    finally:
        os.environ.pop(SWITCH)
        if before is not None:
            os.environ[SWITCH] = before


def image_set_key(scenario: LoadedScenario, variant: str, stream: Stream, laws: Sequence[SpecModel]) -> str:
    """Return the hash of everything that determines a set of rendered images, except the view of each image.

    Random stream and distributions of the views, the ``laws``, distinguish sets of different views.
    """
    spec = scenario.spec
    versions = package_versions()
    compiler = code_generator(choose_variant(variant))
    parts = {
        "format": _FORMAT,
        "body": shape_digest(spec, scenario.search_dirs),
        "shading": spec.body.shading,
        "scenario": [canonical_json(part) for part in (spec.camera, spec.brdf, spec.rendering)],
        "views": [int(stream), *(canonical_json(law) for law in laws)],
        **({} if spec.second_body is None else {"second_body": canonical_json(spec.second_body)}),
        "renderer": [*renderer_version(spec), variant],
        "machine": [versions["mitsuba"], versions["drjit"], compiler, processor()],
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:24]


def fingerprint(view: View) -> bytes:
    """Hash camera, poses and Sun of a view, exactly."""
    second = view.T_body_second
    numbers = [view.T_cam_body.rotation, view.T_cam_body.translation_m, view.sun_dir_body]
    numbers += [] if second is None else [second.rotation, second.translation_m]
    parts = [repr(view.camera).encode(), *(np.ascontiguousarray(n, dtype=np.float64).tobytes() for n in numbers)]
    return hashlib.sha256(b"|".join(parts)).digest()[:16]


@dataclass(slots=True, eq=False)
class ImageStore:
    """Stored images of one set, numbered from 0 for each seed; a process loads one chunk at a time.

    ``key`` is the hash of the set, from `image_set_key`; ``chunk_images`` the number of images in a chunk.
    """

    key: str
    chunk_images: int
    _chunk: str = ""
    _images: dict[int, StoredImage] = field(default_factory=dict)
    _fresh: set[int] = field(default_factory=set)
    _writable: bool = True

    @classmethod
    def open(cls, scenario: LoadedScenario, variant: str, stream: Stream, *laws: SpecModel) -> ImageStore:
        """Open the images of a scenario with views drawn from a stream by given distributions, without reading yet."""
        camera = scenario.spec.camera
        chunk_images = min(_CHUNK_IMAGES, max(1, _CHUNK_PIXELS // (camera.width_px * camera.height_px)))
        return cls(image_set_key(scenario, variant, stream, laws), chunk_images)

    def image(self, seed: int, index: int, view: View, render: Callable[[View], Image]) -> tuple[Image, bool]:
        """Return an image, rendered if it is not stored, and whether it came from the store.

        Rendered images are written when another chunk is needed, and by ``flush``.
        """
        chunk = f"{self.key}-{seed:x}-{index // self.chunk_images:07d}"
        if chunk != self._chunk:
            self.flush()
            folder = default_cache().find(KIND, chunk) if store_is_on() else None
            self._chunk, self._images = chunk, {} if folder is None else read_chunk(folder / _FILE)
        kept = self._images.get(index)
        wanted = fingerprint(view)
        if kept is not None and kept.view == wanted:
            return kept.image, index not in self._fresh
        image = render(view)
        image.setflags(write=False)
        self._images[index] = StoredImage(image, wanted)
        self._fresh.add(index)
        return image, False

    def flush(self) -> None:
        """Write the images rendered since the last call, and release the memory."""
        images = self._images
        if self._fresh and self._writable and store_is_on():
            self._writable = default_cache().put(KIND, self._chunk, lambda folder: write_images(folder / _FILE, images))
        self._chunk, self._images, self._fresh = "", {}, set()


def read_chunk(path: Path) -> dict[int, StoredImage]:
    """Read a chunk; empty if it is damaged, or if another process has just removed it from the cache."""
    try:
        return read_images(path)
    except PARQUET_FAULTS:
        return {}


def open_renderer(scenario: LoadedScenario, variant: str, ground: CrateredSurface | None) -> BodyRenderer:
    """Create the renderer of a scenario's true bodies; ``ground`` is the surface, if it has craters."""
    spec = scenario.spec
    samples, chosen = spec.rendering.samples_per_pixel, choose_variant(variant)
    if ground is not None:
        return TiledRenderer(ground, spec.brdf, samples, chosen)

    def renderer_of(mesh: TriangleMesh, outline_m: FloatArray | None = None) -> MitsubaRenderer:
        return MitsubaRenderer(mesh, spec.brdf, samples, spec.body.shading, chosen, outline_m)

    meshes = [load_body(body, scenario.search_dirs).mesh for body in spec.bodies]
    if spec.second_body is None:
        return renderer_of(meshes[0])
    return PairRenderer(meshes[0], meshes[1], spec.second_body.albedo_ratio, renderer_of)


def open_ground(scenario: LoadedScenario) -> CrateredSurface | None:
    """Return the surface of a scenario's true body with craters; None for a body without."""
    spec = scenario.spec
    return None if spec.craters is None else cratered_surface(spec.body, spec.craters, scenario.search_dirs)


@dataclass(frozen=True, slots=True, eq=False)
class Imager:
    """Renderer, store and detector of a scenario's camera, and the surface of a body with craters.

    Without a detector, images are radiance factors. All are multiplied by a brightness, a factor or its distribution.
    """

    renderer: BodyRenderer
    detector: Detector | None
    store: ImageStore
    ground: CrateredSurface | None
    brightness: Law | float = 1.0

    @classmethod
    def open(cls, scenario: LoadedScenario, variant: str, stream: Stream, *laws: SpecModel) -> Imager:
        """Open the camera of a scenario's true body for views drawn from a stream by given distributions."""
        store = ImageStore.open(scenario, variant, stream, *laws)
        ground = open_ground(scenario)  # once: opening it takes a second, and tens of millions of facets their memory
        return cls(open_renderer(scenario, variant, ground), None, store, ground).of(scenario.spec)

    def of(self, spec: ScenarioSpec) -> Imager:
        """Return it with the detector and the brightness of a scenario, or of a trial of it."""
        detector = None if spec.detector is None else Detector(spec.detector)
        return replace(self, detector=detector, brightness=spec.lighting.brightness)

    def image(
        self,
        view: View,
        seed: int,
        index: int,
        noise: np.random.Generator,
        points_e_per_s: FloatArray | None = None,
        velocity_body_m_s: FloatArray | None = None,
    ) -> tuple[Image, bool]:
        """Return the image (H, W) float32 of a view, and whether it came from the store.

        ``seed`` and ``index`` number it in the store; ``noise`` is the random generator of the detector, and
        ``points_e_per_s`` the light of stars, which needs a detector. ``velocity_body_m_s`` (3,) is the camera's about
        the body, in body axes, of a trajectory that has it.
        """
        radiance, from_store = self.store.image(seed, index, view, self.renderer.render)
        factor = drawn(self.brightness, noise)
        if factor != 1.0:
            radiance = np.float32(factor) * radiance
        if self.detector is None:
            return radiance, from_store
        return self.detector.expose(radiance, noise, points_e_per_s, view, velocity_body_m_s), from_store

    def craters(self, view: View) -> CraterTruth:
        """Find the craters that a view shows; raise BoresightError if the body has none."""
        if self.ground is None or not isinstance(self.renderer, TiledRenderer):
            raise BoresightError("craters: missing, so no crater is seen")
        return crater_truth(self.ground.rims, view, self.renderer)

    def flush(self) -> None:
        """Write the rendered images to the store."""
        self.store.flush()

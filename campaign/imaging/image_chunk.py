"""A few rendered images in one Parquet file: lossless, small and quick to read.

Most of an image is black sky, and the bits of the rest are all but random: each image is kept as the map of its pixels
that are not zero (``lit``, one bit each, row by row) and the values of those (``values``, their bytes split by
significance). A row also holds the image's ``index`` in its set, its shape, and the fingerprint of the ``view`` that it
shows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from scenarios.limits import MOST_PIXELS

Image = NDArray[np.float32]

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
"""Values of 4 bytes and a bit in the map for each pixel, and some room for indices and fingerprints."""


@dataclass(frozen=True, slots=True, eq=False)
class KeptImage:
    """An image (H, W) float32 with the fingerprint of its view."""

    image: Image
    view: bytes


def write_images(path: Path, images: Mapping[int, KeptImage]) -> None:
    """Write images by their index; every bit comes back, negative zeros and NaN included."""
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


def read_images(path: Path) -> dict[int, KeptImage]:
    """Read all images of a file; they are read-only.

    Raises
    ------
    ValueError, KeyError, TypeError, OSError or one of pyarrow's
        If the file is damaged.
    """
    images: dict[int, KeptImage] = {}
    for batch in _stored(path).to_batches():
        for row in range(batch.num_rows):
            index, view, height, width, lit = (batch.column(name)[row].as_py() for name in _SCHEMA.names[:-1])
            image = np.zeros((height, width), dtype=np.float32)
            mask = np.unpackbits(np.frombuffer(lit, np.uint8), count=height * width).reshape(height, width)
            image[mask.view(np.bool_)] = batch.column("values")[row].values.to_numpy()
            image.setflags(write=False)
            images[index] = KeptImage(image, view)
    return images


def _stored(path: Path) -> pa.Table:
    """Read the rows of a file, before any image is unfolded: all of them are no larger than the largest is."""
    with pq.ParquetFile(path) as file:
        about = file.metadata
        unfolded = sum(about.row_group(number).total_byte_size for number in range(about.num_row_groups))
        if not file.schema_arrow.equals(_SCHEMA) or max(unfolded, 8 * about.num_rows) > _MOST_BYTES:
            raise ValueError(f"{path}: no images, or more than a file holds")
        rows = file.read()
    sizes = rows.select(["height_px", "width_px"]).to_pylist()
    if min((min(size.values()) for size in sizes), default=1) < 1 or sum(map(_pixels, sizes)) > MOST_PIXELS:
        raise ValueError(f"{path}: no images, or more pixels than a file holds")
    return rows


def _pixels(size: Mapping[str, int]) -> int:
    return size["height_px"] * size["width_px"]

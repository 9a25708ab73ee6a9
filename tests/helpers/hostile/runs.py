"""Readers of what runs and downloads leave behind, kept images and times; and kernels of SPICE."""

from __future__ import annotations

import io
import tempfile
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from boresight.campaign.cli.bench import read_ratios
from boresight.campaign.imaging.image_store import StoredImage, read_chunk, write_images
from boresight.renderers.spice.instruments import INSTRUMENTS
from boresight.renderers.spice.kernels import loaded_kernels
from hostile import recipes
from hostile.target import Target


def targets() -> dict[str, Target]:
    """The cache and kernels."""
    return {
        "image-chunk": Target(_columns, lambda: (_chunk_recipe(),), _KINDS),
        "image-chunk-bytes": Target(_chunk, lambda: (_written_chunk(),)),
        "bench": Target(_bench, lambda: (_BENCH,), _JSON),
        "kernel": Target(_kernel, lambda: (_KERNEL,), _SPICE),
    }


_JSON = (b"{}", b"[]", b"null", b"NaN", b"Infinity", b"-Infinity", b'"\\ud800"', b'{"a": 1}', b"[[1]]", b'"x"', b"1.5")
_KINDS = (
    b"int64", b"int32", b"binary", b"list<float>", b"list<double>", b"string", b"float", b"null", b"8192", b"67108864",
    b"index", b"view", b"height_px", b"width_px", b"lit", b"values", b"0.5|0.25|nan", b"1|", b"|",
)  # fmt: skip
_SPICE = (
    b"\\begindata", b"\\begintext", b"KPL/LSK", b"DAF/SPK ", b"DAF/CK  ", b"DAS/DSK ", b"+=", b"( 1, 2 )", b"'x'",
    b"@2005",
    b"PATH_VALUES", b"KERNELS_TO_LOAD = ( '/etc/passwd' )", b"KPL/MK", b"'" + b"x" * 200, b"( " + b"1.0 " * 3000 + b")",
)  # fmt: skip
_BENCH = b'{"stages": [{"scenario": "s", "estimator": "e", "stage": "whole", "ratio": 1.5}]}'
_KERNEL = b"""KPL/IK
\\begindata
INS-130102_PIXEL_SAMPLES = ( 64 )
INS-130102_PIXEL_LINES = ( 64 )
INS-130102_CENTER = ( 31.5 31.5 )
INS-130102_PIXEL_SIZE = ( 1.9D-4 )
INS-130102_FOCAL_LENGTH = ( 0.1208 )
INS-130102_OD_K = ( 0.0 2.8D-5 0.0 )
\\begintext
"""


def _laid(content: bytes, path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path


def _written_chunk() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "images.parquet"
        image = np.array([[0.0, 0.5], [0.25, 0.0]], dtype=np.float32)
        write_images(path, {0: StoredImage(image, b"view"), 1: StoredImage(image.T, b"view")})
        return path.read_bytes()


def _chunk_recipe() -> bytes:
    return recipes.table_recipe(pq.read_table(io.BytesIO(_written_chunk())))


def _columns(content: bytes, folder: Path) -> object:
    return _chunk(recipes.parquet(content), folder)


def _chunk(content: bytes, folder: Path) -> object:
    return [kept.image.sum() for kept in read_chunk(_laid(content, folder / "images.parquet")).values()]


def _bench(content: bytes, folder: Path) -> object:
    return read_ratios(_laid(content, folder / "before.json"))


def _kernel(content: bytes, folder: Path) -> object:
    instrument = INSTRUMENTS["hayabusa-amica"]
    with loaded_kernels([_laid(content, folder / "x.ti")]):
        return instrument.camera(instrument.constants())

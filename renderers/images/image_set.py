"""What every set of real images can do, whatever it takes its poses from."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from scenarios.errors import BoresightError
from scenarios.geometry import Camera, View


class ImageSet(Protocol):
    """Real images, each with its time, its Sun and one or more poses."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the images in order."""
        ...

    @property
    def left_out(self) -> tuple[tuple[str, str], ...]:
        """Images that cannot be used, each with the reason."""
        ...

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that results depend on: kernels first, in their order, if there are any."""
        ...

    def __len__(self) -> int: ...

    def time_s(self, index: int) -> float:
        """Return the epoch of an image."""
        ...

    def view(self, index: int, prefix: str | None = None) -> View:
        """Return the view of an image by one of its poses; the one that is scored against by default."""
        ...

    def image(self, index: int) -> NDArray[np.float32]:
        """Read an image, (H, W), the top row first."""
        ...

    def content_digest(self) -> str:
        """Digest (hexadecimal SHA-256) of every file that results depend on."""
        ...

    def check_images(self) -> None:
        """Read every image once, so that a damaged one is found before a campaign starts."""
        ...


def files_digest(paths: Iterable[Path]) -> str:
    """Digest (hexadecimal SHA-256) of the content of files, in their order.

    Raises
    ------
    BoresightError
        If a file cannot be read.
    """
    digest = hashlib.sha256()
    for path in paths:
        try:
            about = path.stat()
            digest.update(_file_digest(path, about.st_size, about.st_mtime_ns))
        except OSError as error:
            raise BoresightError(f"{path}: cannot be read: {error.strerror or error}") from error
    return digest.hexdigest()


@lru_cache(maxsize=4096)
def _file_digest(path: Path, size: int, mtime_ns: int) -> bytes:
    """Digest a file once as long as it stays the same: campaigns ask for it at every block of trials."""
    del size, mtime_ns
    return hashlib.sha256(path.read_bytes()).digest()


def check_size(image: NDArray[np.float32], camera: Camera, path: Path) -> None:
    """Refuse an image that is not of the camera's size."""
    height, width = image.shape
    if (width, height) != (camera.width_px, camera.height_px):
        raise BoresightError(
            f"{path}: the image is {width} x {height} pixels, but the camera has {camera.width_px} x {camera.height_px}"
        )

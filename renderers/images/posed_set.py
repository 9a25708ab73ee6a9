"""A folder of real images with a table of poses, in the place of a renderer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from renderers.images.image_set import check_size, files_digest
from renderers.images.pixels import read_image
from renderers.images.table import PoseTable, read_table
from scenarios.data import find_data_file
from scenarios.errors import BoresightError
from scenarios.geometry import Camera, View
from scenarios.spec.images import ImageSetSpec


@dataclass(frozen=True, slots=True, eq=False)
class PosedImageSet:
    """Real images, each with its time, its Sun and one or more poses.

    ``version`` is part of every result's key: raise it when pixels or views change.
    """

    name: ClassVar[str] = "posed-images"
    version: ClassVar[int] = 1
    left_out: ClassVar[tuple[tuple[str, str], ...]] = ()

    folder: Path
    camera: Camera
    spec: ImageSetSpec
    table: PoseTable

    @classmethod
    def open(cls, spec: ImageSetSpec, camera: Camera, search_dirs: Sequence[Path] = ()) -> Self:
        """Read and check the table, and that every image is there; the images themselves are read later.

        Parameters
        ----------
        spec
            The images section of a scenario.
        camera
            The camera that took them.
        search_dirs
            Folders where a relative ``folder`` is looked for before ``$BORESIGHT_DATA/images`` and ``$BORESIGHT_DATA``.

        Raises
        ------
        BoresightError
            If the table or an image is missing, or the table is wrong.
        """
        path = find_data_file(f"{spec.folder}/{spec.table}", search_dirs, "images", "images.folder")
        folder = path.parent
        table = read_table(path, (spec.truth, *spec.also_score))
        missing = [name for name in table.files if not (folder / name).is_file()]
        if missing:
            raise BoresightError(f"{path}: file: {missing[0]} is not in {folder} ({len(missing)} missing in all)")
        return cls(folder, camera, spec, table)

    def __len__(self) -> int:
        return len(self.table.files)

    @property
    def names(self) -> tuple[str, ...]:
        """File names in the order of the table."""
        return self.table.files

    @property
    def files(self) -> tuple[Path, ...]:
        """The table and the images."""
        return (self.folder / self.spec.table, *(self.folder / name for name in self.names))

    def time_s(self, index: int) -> float:
        """Return the epoch of an image."""
        return float(self.table.times_s[index])

    def view(self, index: int, prefix: str | None = None) -> View:
        """Return the view of an image by the pose under ``prefix``; the one that is scored against by default.

        Raises
        ------
        BoresightError
            If the scenario does not name the prefix in ``truth`` or ``also_score``.
        """
        prefix = self.spec.truth if prefix is None else prefix
        if prefix not in self.table.poses:
            raise BoresightError(f"images: no poses {prefix!r} were read, only {', '.join(self.table.poses)}")
        return View(self.camera, self.table.poses[prefix][index], self.table.sun_dirs_body[index])

    def image(self, index: int) -> NDArray[np.float32]:
        """Read an image, (H, W) float32 in the units of its file, the top row first.

        Raises
        ------
        BoresightError
            If it cannot be read, or is not of the camera's size.
        """
        path = self.folder / self.names[index]
        image = read_image(path)
        check_size(image, self.camera, path)
        return image[::-1].copy() if self.spec.first_row == "bottom" else image

    def content_digest(self) -> str:
        """Digest (hexadecimal SHA-256) of the table and of every image: what results depend on.

        Raises
        ------
        BoresightError
            If a file cannot be read.
        """
        return files_digest(self.files)

    def check_images(self) -> None:
        """Read every image once, so that a damaged one is found before a campaign starts.

        Raises
        ------
        BoresightError
            As ``image``.
        """
        for index in range(len(self)):
            self.image(index)

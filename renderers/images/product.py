"""An image as a mission publishes it: a FITS file, a PDS3 image, or either of them with a detached label."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from renderers.images.fits import read_fits, read_fits_header
from renderers.images.metadata import ImageMetadata, metadata_of
from renderers.images.pds3 import ATTACHED_SUFFIXES, LABEL_SUFFIXES, Label, has_label, parse_label, pixel_file
from renderers.images.pds3 import read_pixels as read_pds3_pixels
from renderers.images.pixels import FITS_SUFFIXES, finite_float32, read_bytes
from scenarios.errors import BoresightError


@dataclass(frozen=True, slots=True, eq=False)
class Product:
    """What is told about one image; its pixels are read when they are wanted.

    Parameters
    ----------
    path
        The file that holds the pixels.
    label
        The PDS3 label, or None for a FITS file by itself.
    keywords
        Keywords of the FITS header, overridden by those of the label.
    files
        Every file that the product consists of.
    """

    path: Path
    label: Label | None
    keywords: Mapping[str, object]
    files: tuple[Path, ...]

    def metadata(self, exposure_unit_s: float = 1.0) -> ImageMetadata:
        """Return the metadata; exposures without a unit are in units of ``exposure_unit_s``."""
        return metadata_of(self.keywords, self.path, exposure_unit_s)

    @property
    def size_px(self) -> tuple[int, int]:
        """Samples and lines as label or header state them; 0 where they do not."""
        image = self.label.part("IMAGE") if self.label is not None else {}
        sizes = [
            image.get("LINE_SAMPLES", self.keywords.get("NAXIS1")),
            image.get("LINES", self.keywords.get("NAXIS2")),
        ]
        samples, lines = (size if isinstance(size, int) else 0 for size in sizes)
        return samples, lines

    def pixels(self) -> NDArray[np.float32]:
        """Read the pixels, (lines, samples), in the order of the file and scaled as it says.

        Raises
        ------
        BoresightError
            If they cannot be read, or are not finite.
        """
        if self.path.suffix.lower() in FITS_SUFFIXES:
            return finite_float32(read_fits(read_bytes(self.path), self.path), self.path)
        if self.label is None:
            raise BoresightError(f"{self.path}: no PDS3 label says how the pixels are stored")
        return finite_float32(read_pds3_pixels(self.label), self.path)


def open_product(path: Path) -> Product:
    """Open a label, a FITS file or a PDS3 image; a label beside a file, of the same name, is read with it.

    Raises
    ------
    BoresightError
        If a file is missing, damaged, or of another format.
    """
    suffix = path.suffix.lower()
    if suffix not in (*LABEL_SUFFIXES, *ATTACHED_SUFFIXES, *FITS_SUFFIXES):
        known = ", ".join((*FITS_SUFFIXES, *LABEL_SUFFIXES, *ATTACHED_SUFFIXES))
        raise BoresightError(f"{path}: not a format of missions that is read: {known}")
    label = _label(path)
    image = path if label is None or suffix in FITS_SUFFIXES else pixel_file(label)
    is_fits = image.suffix.lower() in FITS_SUFFIXES
    header = read_fits_header(read_bytes(image), image) if is_fits else {}
    files = dict.fromkeys([image, *([] if label is None else [label.path])])
    return Product(image, label, {**header, **({} if label is None else label.values)}, tuple(files))


def _label(path: Path) -> Label | None:
    """Parse the label that is in a file or beside it; only a FITS file may do without."""
    content = read_bytes(path)
    if has_label(content) or path.suffix.lower() in LABEL_SUFFIXES:
        return parse_label(content, path)
    beside = [other for other in sorted(path.parent.glob(f"{path.stem}.*")) if other.suffix.lower() in LABEL_SUFFIXES]
    if beside:
        return parse_label(read_bytes(beside[0]), beside[0])
    if path.suffix.lower() in FITS_SUFFIXES:
        return None
    raise BoresightError(f"{path}: has no PDS3 label, neither in it nor beside it ({path.stem}.lbl)")

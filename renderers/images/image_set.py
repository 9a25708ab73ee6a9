"""Sets of real images: their protocol, their digest, and the selection of images by regions that must stay clear."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, RadialDistortion, View
from boresight.scenarios.geometry.lens import Lens

# Largest allowed difference between the cameras of scenario and source, anywhere in the image.
CAMERA_TOLERANCE_PX = 0.01

Rectangle = tuple[float, float, float, float]


class ImageSet(Protocol):
    """Real images, each with an epoch, a direction to the Sun and one or more poses."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the images, in order."""
        ...

    @property
    def left_out(self) -> tuple[tuple[str, str], ...]:
        """Names of images that cannot be used, each with the reason."""
        ...

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that results depend on: SPICE kernels first, in loading order, if there are any."""
        ...

    def __len__(self) -> int: ...

    def time_s(self, index: int) -> float:
        """Epoch of an image, s."""
        ...

    def view(self, index: int, prefix: str | None = None) -> View:
        """View of an image with the pose named ``prefix``, by default the reference pose for scoring."""
        ...

    def covariance(self, index: int) -> FloatArray | None:
        """Covariance (6, 6) of the reference pose, [rotation_rad, translation_m], camera axes; None if unknown."""
        ...

    def image(self, index: int) -> NDArray[np.float32]:
        """Read an image, (H, W), the top row first."""
        ...

    def content_digest(self) -> str:
        """Hexadecimal SHA-256 of every file that results depend on."""
        ...

    def check_images(self) -> None:
        """Read every image, so that a damaged one is found before a campaign starts."""
        ...


class WholeSet:
    """What every `ImageSet` does alike: count, digest and check its images."""

    __slots__ = ()

    def __len__(self: ImageSet) -> int:
        return len(self.names)

    def content_digest(self: ImageSet) -> str:
        """Hexadecimal SHA-256 of every file that results depend on; `BoresightError` if one cannot be read."""
        digest = hashlib.sha256()
        for path in self.files:
            try:
                about = path.stat()
                # Digests of files, not their bytes: fixed lengths keep the borders of files apart.
                digest.update(_file_digest(path, about.st_size, about.st_mtime_ns))
            except OSError as error:
                raise BoresightError(f"{path}: cannot be read: {error.strerror or error}") from error
        return digest.hexdigest()

    def check_images(self: ImageSet) -> None:
        """Read every image, so that a damaged one is found before a campaign starts."""
        for index in range(len(self)):
            self.image(index)


@lru_cache(maxsize=4096)
def _file_digest(path: Path, size: int, mtime_ns: int) -> bytes:
    """Digest a file; cached while size and time stamp stay the same, as campaigns need it at every block of trials."""
    del size, mtime_ns
    return hashlib.sha256(path.read_bytes()).digest()


def check_size(image: NDArray[np.float32], camera: Camera, path: Path) -> None:
    """Raise BoresightError if an image is not of the camera's size."""
    height, width = image.shape
    if (width, height) != (camera.width_px, camera.height_px):
        raise BoresightError(
            f"{path}: the image is {width} x {height} pixels, but the camera has {camera.width_px} x {camera.height_px}"
        )


def check_camera(camera: Camera, known: Camera, owner: str, source: str) -> None:
    """Raise BoresightError if a scenario's camera is not the one that ``source`` states for ``owner``, within 0.01 px.

    The message has the keys of the scenario that would be right.
    """
    if (known.width_px, known.height_px) != (camera.width_px, camera.height_px):
        raise BoresightError(
            f"camera: {camera.width_px} x {camera.height_px} pixels, but {owner} has"
            f" {known.width_px} x {known.height_px}"
        )
    off_px = apart_px(camera, known)
    # Written so that NaN, a pixel that one lens cannot reach, is a difference.
    if not off_px <= CAMERA_TOLERANCE_PX:
        raise BoresightError(
            f"camera: up to {off_px:.3g} pixels off that of {source}: write focal_px: [{known.fx_px:.6f},"
            f" {known.fy_px:.6f}], principal_point_px: [{known.cx_px:g}, {known.cy_px:g}], distortion:"
            f" {_lens_keys(known.distortion)}"
        )


def apart_px(camera: Camera, known: Camera) -> float:
    """Return how far two cameras of one size are apart at most, px.

    They are compared by what both do with the same pixels: equal cameras may be written with other numbers.
    """
    steps = np.linspace(0.0, 1.0, 9)
    uv = np.stack(np.meshgrid(steps * camera.width_px, steps * camera.height_px), axis=-1)
    return float(np.linalg.norm(camera.project(known.unproject(uv)) - uv, axis=-1).max())


def _lens_keys(lens: Lens | None) -> str:
    """Return what a scenario has as ``camera.distortion`` for a lens."""
    if lens is None:
        return "null"
    if isinstance(lens, RadialDistortion):
        return f"{{k1: {lens.k1:.8g}, k2: {lens.k2:.8g}}}"
    return f"{{opencv: [{', '.join(f'{number:.8g}' for number in astuple(lens))}]}}"


@dataclass(frozen=True, slots=True, eq=False)
class Selection(WholeSet):
    """Subset of an image set, in its order; an `ImageSet` too.

    ``kept`` are the indices of the used images, ``left_out`` the names of the others, each with the reason.
    """

    images: ImageSet
    kept: tuple[int, ...]
    left_out: tuple[tuple[str, str], ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the used images."""
        return tuple(self.images.names[index] for index in self.kept)

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file of the whole set, as the selection depends on all of them."""
        return self.images.files

    def time_s(self, index: int) -> float:
        """Epoch of an image, s."""
        return self.images.time_s(self.kept[index])

    def view(self, index: int, prefix: str | None = None) -> View:
        """View of an image."""
        return self.images.view(self.kept[index], prefix)

    def covariance(self, index: int) -> FloatArray | None:
        """Covariance of the reference pose."""
        return self.images.covariance(self.kept[index])

    def image(self, index: int) -> NDArray[np.float32]:
        """Read an image."""
        return self.images.image(self.kept[index])


def split_survey(images: ImageSet, survey: Sequence[str]) -> tuple[Selection, Selection]:
    """Split a set into the images of trials and those of a survey, named so; raise BoresightError for a wrong name."""
    unknown = [name for name in survey if name not in images.names]
    rest = [name for name in images.names if name not in survey]
    if unknown or not rest:
        raise BoresightError(f"images.survey: {f'no image is called {unknown[0]}' if unknown else 'no image remains'}")

    def of(names: Sequence[str], why: str) -> Selection:
        others = tuple((name, why) for name in images.names if name not in names)
        return Selection(images, tuple(images.names.index(name) for name in names), (*images.left_out, *others))

    return of(rest, "an image of the survey"), of(survey, "not of the survey")


def keep_clear(images: ImageSet, outline_m: FloatArray, rectangles: Sequence[Rectangle]) -> Selection:
    """Leave out the images in which the body overlaps given rectangles of the detector.

    The convex hull of ``outline_m`` (N, 3), in the body frame, contains the body. A rectangle is left, top, right and
    bottom, px. Raise `BoresightError` if no image remains.
    """
    reasons = [keep_clear_violation(images.view(index), outline_m, rectangles) for index in range(len(images))]
    kept = tuple(index for index, reason in enumerate(reasons) if not reason)
    left_out = tuple((name, reason) for name, reason in zip(images.names, reasons, strict=True) if reason)
    if not kept:
        raise BoresightError(f"images.keep_clear_px: no image remains of {len(images)}: {left_out[0][0]}: {reasons[0]}")
    return Selection(images, kept, (*images.left_out, *left_out))


def keep_clear_violation(view: View, outline_m: FloatArray, rectangles: Sequence[Rectangle]) -> str:
    """Describe the first rectangle of the detector that the body overlaps; '' if it overlaps none.

    The test uses the convex hull of the projected outline, which contains the image of the body.
    """
    uv = view.camera.project(view.T_cam_body.transform(outline_m))
    seen = uv[np.isfinite(uv).all(axis=1)].astype(np.float32)
    # OpenCV needs three points for a hull.
    if len(seen) < 3:
        return ""
    hull = cv2.convexHull(seen[:, None])[:, 0]
    for left, top, right, bottom in rectangles:
        corners = np.array([[left, top], [right, top], [right, bottom], [left, bottom]], dtype=np.float32)
        # The image of a convex hull is convex, so that the overlap of two convex polygons is the test.
        shared, _ = cv2.intersectConvexConvex(hull, corners)
        if shared > 0.0:
            part = f"[{left:g}, {top:g}, {right:g}, {bottom:g}]"
            return f"the body reaches {shared:.0f} px2 into {part}, which must stay clear"
    return ""

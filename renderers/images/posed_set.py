"""Image set from a folder of images and a CSV table of their poses, their SUM files, or a model of COLMAP.

Columns of the table, in any order; others are not read:

================================== ==================================================================
file                               file name in the folder of the set, unique; of PDS images the label
time_s                             epoch of the exposure, s
PREFIX_qw, _qx, _qy, _qz           quaternion (w, x, y, z) from body to camera axes
PREFIX_tx_m, _ty_m, _tz_m          origin of the body in camera axes, m: x_cam = R(q) x_body + t
sun_body_x, _y, _z                 direction to the Sun in the body frame, normalised here
PREFIX_cov_00, _01, ... _55        of adjusted poses: upper triangle of the covariance of [rotation_rad, translation_m]
                                   in camera axes, as of ``Pose.perturbed``
================================== ==================================================================

A table may contain poses under several prefixes (``ref``, ``label``). Camera axes: x right, y down, z forward.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from boresight.renderers.images import colmap
from boresight.renderers.images.image_set import CAMERA_TOLERANCE_PX, WholeSet, apart_px, check_camera, check_size
from boresight.renderers.images.product import image_files, read_any_image
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.data import find_data_file, is_there
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Pose, View
from boresight.scenarios.reading import LARGEST_NUMBER, number_in
from boresight.scenarios.spc import read_sumfile
from boresight.scenarios.spec.scenario import ColmapSpec, ImageSetSpec

QUATERNION_TOLERANCE = 1e-3
_EXCESS = "\n"  # key of surplus cells: no column can be called so
_SUN = ("sun_body_x", "sun_body_y", "sun_body_z")
_UPPER = [(i, j) for i in range(6) for j in range(i, 6)]


@dataclass(frozen=True, slots=True, eq=False)
class PoseTable:
    """Content of a checked table of N images.

    ``times_s`` (N,) are epochs, ``sun_dirs_body`` (N, 3) unit vectors towards the Sun, ``poses`` N poses T_cam_body for
    each prefix, ``covariances`` (N, 6, 6) those of adjusted poses, [rotation_rad, translation_m], camera axes.
    """

    files: tuple[str, ...]
    times_s: FloatArray
    sun_dirs_body: FloatArray
    poses: Mapping[str, tuple[Pose, ...]]
    covariances: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class _Row:
    """Cells of one line of the table by column, and its place (FILE:LINE) for errors."""

    place: str
    cells: Mapping[str, str | None]

    def number(self, column: str) -> float:
        """Return a cell as a finite number."""
        text = self.cells[column] or ""
        value = number_in(text)
        if not np.isfinite(value):
            raise BoresightError(f"{self.place}: {column}: {text!r} is not a finite number")
        if abs(value) > LARGEST_NUMBER:
            raise BoresightError(f"{self.place}: {column}: {text!r} is larger than anything that this can be")
        return value

    def numbers(self, columns: Sequence[str]) -> FloatArray:
        """Return several cells as an array."""
        return np.array([self.number(column) for column in columns])


def read_table(path: Path, prefixes: Sequence[str], *, adjusted: bool = False) -> PoseTable:
    """Read and check a table of poses, of ``adjusted`` ones of one prefix with their covariances.

    Raise `BoresightError` with file, line and column if the table is missing or no CSV, has no rows, lacks a column or
    contains a wrong value.
    """
    covariances = [f"{prefixes[0]}_cov_{i}{j}" for i, j in _UPPER] if adjusted else []
    rows = _read_rows(path, prefixes, covariances)
    return PoseTable(
        tuple(_files(rows)),
        np.array([row.number("time_s") for row in rows]),
        np.array([_unit(row.numbers(_SUN), f"{row.place}: sun_body_x, _y, _z") for row in rows]),
        {prefix: tuple(_pose(row, prefix) for row in rows) for prefix in prefixes},
        np.stack([_covariance(row, covariances) for row in rows]) if adjusted else None,
    )


def _pose_columns(prefix: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    quaternion = tuple(f"{prefix}_q{axis}" for axis in "wxyz")
    return quaternion, tuple(f"{prefix}_t{axis}_m" for axis in "xyz")


def _read_rows(path: Path, prefixes: Sequence[str], further: Sequence[str]) -> list[_Row]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            reader = csv.DictReader(stream, strict=True)
            columns = [name.strip() for name in reader.fieldnames or ()]
            _check_columns(path, columns, prefixes, further)
            reader.fieldnames = columns
            reader.restkey = _EXCESS
            rows = [_Row(f"{path}:{reader.line_num}", cells) for cells in reader]
    except FileNotFoundError as error:
        raise BoresightError(f"{path}: no such table of poses") from error
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise BoresightError(f"{path}: cannot be read as a CSV table: {error}") from error
    if not rows:
        raise BoresightError(f"{path}: the table has no rows")
    for row in rows:
        if _EXCESS in row.cells:
            raise BoresightError(f"{row.place}: more cells than the {len(columns)} columns of the heading")
    return rows


def _check_columns(path: Path, columns: Sequence[str], prefixes: Sequence[str], further: Sequence[str]) -> None:
    needed = ["file", "time_s", *_SUN, *further]
    for prefix in prefixes:
        needed += [column for group in _pose_columns(prefix) for column in group]
    missing = [column for column in needed if column not in columns]
    if missing:
        found = ", ".join(name.removesuffix("_qw") for name in columns if name.endswith("_qw")) or "none"
        raise BoresightError(f"{path}: missing column {', '.join(missing)} (prefixes with poses: {found})")
    twice = sorted({column for column in columns if columns.count(column) > 1})
    if twice:
        raise BoresightError(f"{path}: column {', '.join(twice)} appears twice")


def _files(rows: Sequence[_Row]) -> list[str]:
    """Return the file names, refusing repeated ones, which would count twice in every statistic."""
    first: dict[str, str] = {}
    for row in rows:
        name = (row.cells["file"] or "").strip()
        if not name:
            raise BoresightError(f"{row.place}: file: no file name")
        paths = (PurePosixPath(name), PureWindowsPath(name))
        if any(path.is_absolute() or path.drive or path.root or ".." in path.parts for path in paths):
            raise BoresightError(f"{row.place}: file: {name!r} leads out of the folder of the image set")
        if name in first:
            raise BoresightError(f"{row.place}: file: {name} appears twice, first at {first[name]}")
        first[name] = row.place
    return list(first)


def _unit(sun: FloatArray, place: str) -> FloatArray:
    length = float(np.linalg.norm(sun))
    if not length > 0.0:
        raise BoresightError(f"{place}: {sun.tolist()} has no direction")
    return sun / length


def _pose(row: _Row, prefix: str) -> Pose:
    quaternion_columns, translation_columns = _pose_columns(prefix)
    quat_wxyz = row.numbers(quaternion_columns)
    length = float(np.linalg.norm(quat_wxyz))
    if abs(length - 1.0) > QUATERNION_TOLERANCE:
        raise BoresightError(
            f"{row.place}: {prefix}_qw, _qx, _qy, _qz: the length is {length:.6g},"
            f" not 1 within {QUATERNION_TOLERANCE:g}"
        )
    translation_m = row.numbers(translation_columns)
    # As in a table whose camera looks along -z.
    if translation_m[2] <= 0.0:
        raise BoresightError(
            f"{row.place}: {prefix}_tz_m: {translation_m[2]:g} puts the body behind the camera: z points forward"
        )
    return Pose.from_quat_wxyz(quat_wxyz, translation_m)


def _covariance(row: _Row, columns: Sequence[str]) -> FloatArray:
    covariance = np.zeros((6, 6))
    covariance[tuple(np.transpose(_UPPER))] = row.numbers(columns)
    covariance += np.triu(covariance, 1).T
    # Scaled first: square radians and square metres are ten orders of magnitude apart.
    sigma = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    if not np.linalg.eigvalsh(covariance / np.outer(sigma, sigma))[0] > 0.0:
        raise BoresightError(f"{row.place}: {columns[0]} to {columns[-1]}: the covariance is not positive definite")
    return covariance


def _table_of_sumfiles(paths: Sequence[Path], spec: ImageSetSpec, camera: Camera) -> PoseTable:
    read = [read_sumfile(path) for path in paths]
    for path, one in zip(paths, read, strict=True):
        check_camera(camera, one.camera, str(path), str(path))
    return PoseTable(
        tuple(one.image for one in spec.sumfiles or ()),
        np.array([one.time_s for one in read]),
        np.array([one.sun_dir_body for one in read]),
        {spec.truth: tuple(one.T_cam_body for one in read)},
    )


def _table_of_colmap(path: Path, spec: ColmapSpec, prefix: str, camera: Camera) -> PoseTable:
    model = colmap.read_colmap(path, {"m": 1.0, "km": 1e3}[spec.unit])
    poses, taken = [], dict[str, str]()
    for one in spec.images:
        # A model names its images from their own folder on, which may lie below that of the set.
        known = [name for name in model if f"/{one.image}".endswith(f"/{name}")]
        if not known:
            raise BoresightError(f"{path}: holds no pose of {one.image}, of {len(model)} images")
        name = max(known, key=len)
        if name in taken:
            raise BoresightError(f"{path}: {taken[name]} and {one.image} have the same pose, that of {name}")
        taken[name] = one.image
        own, pose = model[name]
        first, _ = model[next(iter(taken))]
        if not apart_px(first, own) <= CAMERA_TOLERANCE_PX:
            raise BoresightError(
                f"{path}: {one.image} and {spec.images[0].image} have other cameras: a scenario has one, so give each a"
                " scenario of its own"
            )
        check_camera(camera, own, one.image, str(colmap.cameras_file(path)))
        if pose.translation_m[2] <= 0.0:
            raise BoresightError(f"{path}: {one.image}: the body is behind the camera")
        poses.append(pose)
    return PoseTable(
        tuple(one.image for one in spec.images),
        np.array([one.time_s for one in spec.images]),
        np.array([_unit(np.array(one.sun_body), f"images.colmap: {one.image}: sun_body") for one in spec.images]),
        {prefix: tuple(poses)},
    )


@dataclass(frozen=True, slots=True, eq=False)
class PosedImageSet(WholeSet):
    """Image set whose epochs, directions to the Sun and poses come from files, ``sources``, or from the scenario.

    ``adjusted`` is the table of ``images.adjusted``, with its own directions to the Sun.
    ``version`` enters the digest of every run: raise it when pixels or views change.
    """

    name: ClassVar[str] = "posed-images"
    version: ClassVar[int] = 1
    left_out: ClassVar[tuple[tuple[str, str], ...]] = ()

    folder: Path
    camera: Camera
    spec: ImageSetSpec
    table: PoseTable
    sources: tuple[Path, ...]
    adjusted: PoseTable | None = None

    @classmethod
    def open(cls, spec: ImageSetSpec, camera: Camera, search_dirs: Sequence[Path] = ()) -> Self:
        """Read and check the table or the files of poses, and check that every image exists; the images are read later.

        A relative ``folder`` is searched for in ``search_dirs``, then in ``$BORESIGHT_DATA/images`` and
        ``$BORESIGHT_DATA``. Raise `BoresightError` if a file is missing or contains an error, or if the camera is not
        that of a SUM file or of a model.
        """
        first, key = (spec.table, "table") if spec.sumfiles is None else (spec.sumfiles[0].sumfile, "sumfiles")
        if spec.colmap is not None:
            key = "colmap"
            binary, text = colmap.IMAGES
            is_text = is_there(f"{spec.folder}/{text}", search_dirs, "images")
            first = text if is_text and not is_there(f"{spec.folder}/{binary}", search_dirs, "images") else binary
        sought = key if is_there(spec.folder, search_dirs, "images") else "folder"
        path = find_data_file(f"{spec.folder}/{first}", search_dirs, "images", f"images.{sought}")
        folder = path.parent
        sources: tuple[Path, ...] = (path,)
        if spec.colmap is not None:
            sources = (colmap.cameras_file(path), path)
            table = _table_of_colmap(path, spec.colmap, spec.truth, camera)
        elif spec.sumfiles is None:
            own = None if spec.adjusted is None else spec.adjusted.name
            named, moved = (spec.truth, *spec.also_score), {one.name: one.of for one in spec.moved}
            table = read_table(path, tuple(dict.fromkeys(moved.get(name, name) for name in named if name != own)))
        else:
            sources = tuple(folder / one.sumfile for one in spec.sumfiles)
            table = _table_of_sumfiles(sources, spec, camera)
        missing = [name for name in table.files if not (folder / name).is_file()]
        if missing:
            where = f"{path}: file" if key == "table" else f"images.{key}: image"
            raise BoresightError(f"{where}: {missing[0]} is not in {folder} ({len(missing)} missing in all)")
        adjusted = None
        if spec.adjusted is not None:
            further = find_data_file(spec.adjusted.table, search_dirs, "images", "images.adjusted.table")
            adjusted, sources = read_table(further, (spec.adjusted.name,), adjusted=True), (*sources, further)
            if adjusted.files != table.files:
                raise BoresightError(f"{further}: file: the images are not those of {path}, in the same order")
        images = cls(folder, camera, spec, table, sources, adjusted)
        for one in spec.moved:
            depths_m = [images.view(i, one.name).T_cam_body.translation_m[2] for i in range(len(images))]
            if min(depths_m) <= 0.0:
                name = images.names[int(np.argmin(depths_m))]
                raise BoresightError(f"{path}: images.moved: {one.name} puts the body of {name} behind the camera")
        return images

    @property
    def names(self) -> tuple[str, ...]:
        """File names in the order of the table, of ``sumfiles`` or of ``colmap.images``."""
        return self.table.files

    @property
    def files(self) -> tuple[Path, ...]:
        """The files of poses, and those of the images."""
        return (*self.sources, *(path for name in self.names for path in image_files(self.folder / name)))

    def time_s(self, index: int) -> float:
        """Epoch of an image, s."""
        return float(self.table.times_s[index])

    def view(self, index: int, prefix: str | None = None) -> View:
        """View of an image with the pose under ``prefix``, by default the reference pose ``truth``.

        Raise `BoresightError` if the scenario does not name the prefix in ``truth`` or ``also_score``.
        """
        prefix = self.spec.truth if prefix is None else prefix
        if self.adjusted is not None and prefix in self.adjusted.poses:
            return View(self.camera, self.adjusted.poses[prefix][index], self.adjusted.sun_dirs_body[index])
        moved, sun_dir = self.spec.place_of(prefix), self.table.sun_dirs_body[index]
        of = prefix if moved is None else moved.of
        if of not in self.table.poses:
            raise BoresightError(f"images: no poses {of!r} were read, only {', '.join(self.table.poses)}")
        pose = self.table.poses[of][index]
        if moved is None:
            return View(self.camera, pose, sun_dir)
        turn, origin_m = np.radians(moved.rotation_vector_deg), np.array(moved.origin_m)
        shape = Pose(np.eye(3), np.zeros(3), "body", "body").perturbed(turn, origin_m)
        return View(self.camera, pose @ shape, shape.inverse().rotate(sun_dir))

    def covariance(self, index: int) -> FloatArray | None:
        """Covariance (6, 6) of the reference pose, as of `PoseTable`; None if it has none."""
        if self.adjusted is None or self.adjusted.covariances is None or self.spec.truth not in self.adjusted.poses:
            return None
        return np.asarray(self.adjusted.covariances[index])

    def image(self, index: int) -> NDArray[np.float32]:
        """Read an image, (H, W) float32 in the units of its file, the top row first.

        Raise `BoresightError` if it cannot be read, or is not of the camera's size.
        """
        path = self.folder / self.names[index]
        image = read_any_image(path)
        check_size(image, self.camera, path)
        return image[::-1].copy() if self.spec.first_row == "bottom" else image

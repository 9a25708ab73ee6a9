"""Downloads of data sets: resumed after an interruption, verified by size and checksum, and stored atomically."""

from __future__ import annotations

import errno
import hashlib
import os
import re
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
import requests

from boresight.scenarios.atomic import write_atomically, write_text
from boresight.scenarios.bodies.readers import read_shape
from boresight.scenarios.data import DATA_VARIABLE
from boresight.scenarios.data.datasets import REGISTRY, DataSet, FileSpec, RawFile
from boresight.scenarios.errors import BoresightError

_APOPHIS_KM = 0.375
"""Volume-equivalent diameter of Apophis in Table 1 of Delpech et al. (2015)."""

TIMEOUT_S = 30.0
_CHUNK_BYTES = 1 << 16
Progress = Callable[[str, int, int], None]


def icq(raw: Path) -> bytes:
    """Write the vertices of a PLY, six faces of a cube of (Q + 1)**2 vertices each, as an ICQ of the same unit.

    Raise BoresightError if the file is no PLY or its vertices are not those of six such faces.
    """
    vertices = read_shape(raw, "ply").vertices
    side = round(np.sqrt(len(vertices) / 6.0))
    if 6 * side**2 != len(vertices):
        raise BoresightError(f"{raw}: {len(vertices)} vertices are not six grids of (Q + 1)**2: no ICQ")
    lines = [f"{side - 1}", *("".join(f"{x:10.5f}" for x in vertex) for vertex in vertices)]
    return ("\n".join(lines) + "\n").encode()


def apophis(raw: Path) -> bytes:
    """Scale an OBJ to a volume-equivalent diameter of 0.375 km, with the origin at the centre of volume.

    Raise BoresightError if the file is no OBJ or its faces enclose no volume.
    """
    shape = read_shape(raw, "obj")
    vertices, faces = shape.vertices, shape.faces
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    volumes = np.einsum("fi,fi->f", a, np.cross(b, c))  # six times those of the tetrahedra to the origin
    if not volumes.sum() > 0.0:
        raise BoresightError(f"{raw}: the faces enclose no volume, so it cannot be scaled")
    centre = np.einsum("f,fi->i", volumes, a + b + c) / (4.0 * volumes.sum())
    scale = _APOPHIS_KM / np.cbrt(volumes.sum() / np.pi)
    scaled = (vertices - centre) * scale
    head = (
        "# 99942 Apophis, light-curve inversion shape, km, scaled to a volume-equivalent diameter of"
        f" {_APOPHIS_KM:g} km\n"
    )
    points = "".join("v {:.7f} {:.7f} {:.7f}\n".format(*point) for point in scaled)
    return (head + points + "".join("f {} {} {}\n".format(*face) for face in faces + 1)).encode()


DERIVATIONS: Mapping[str, Callable[[Path], bytes]] = MappingProxyType({"icq": icq, "apophis": apophis})


class _NotThereError(BoresightError):
    """The source does not have the file."""


class _BrokenOffError(requests.exceptions.RequestException):
    """The server sent fewer bytes than the file has."""


@dataclass(frozen=True, slots=True)
class FetchedFile:
    """A file of a data set that is in place: ``how`` is ``there``, ``fetched``, ``derived`` or ``copied``."""

    path: Path
    how: str


def state(dataset: DataSet, root: Path) -> str:
    """Describe how many files of a data set are present, by their names."""
    there = sum((root / dataset.folder / file.name).is_file() for file in dataset.files)
    return (
        "there" if there == len(dataset.files) else f"{there} of {len(dataset.files)} files" if there else "not there"
    )


def bytes_to_come(sets: Sequence[DataSet], root: Path) -> int:
    """Return the size of the files that are not in the data folder, in bytes."""
    files = [(one, file) for one in sets for file in one.files]
    return sum(file.bytes for one, file in files if not (root / one.folder / file.name).is_file())


def check_space(size: int, root: Path) -> None:
    """Raise BoresightError if the disk of the data folder has less space than that, in bytes."""
    there = next(place for place in (root, *root.absolute().parents) if place.is_dir())
    free = shutil.disk_usage(there).free
    if size > free:
        raise BoresightError(
            f"{root}: {size / 1e6:.1f} MB are to come, but the disk has {free / 1e6:.1f} MB left: free some space, or"
            f" set {DATA_VARIABLE} to another folder"
        )


def fetch(dataset: DataSet, root: Path, progress: Progress, source: str = "") -> Iterator[FetchedFile]:
    """Bring the missing files of a data set, verify those present, and store credit and licence next to them.

    ``progress`` is called with the file name, the bytes received and the size of the file. ``source`` is the URL or the
    folder of a mirror, which has the files under their paths in the data folder; '' for the repository. Raise
    BoresightError if the network, the server or the disk fails, or a checksum differs. Complete files remain, and a
    partial file from which the next call resumes.
    """
    folder = root / dataset.folder
    for file in dataset.files:
        yield _bring(dataset, file, root, progress, source)
    origin = f"https://github.com/{dataset.repository}, commit {dataset.commit}"
    names = "".join(f"  {name}\n" for name in dataset.file_names)
    note = f"\n{dataset.note}\n" if dataset.note else ""
    write_text(
        folder / f"{dataset.name}.licence.txt",
        f"{dataset.title}\n\nlicence: {dataset.licence}\ncredit: {dataset.credit}\nfrom: {origin}\n{note}\n{names}",
    )


def _bring(dataset: DataSet, file: FileSpec, root: Path, progress: Progress, source: str) -> FetchedFile:
    """Put one file of a data set in place, by download, copy or derivation."""
    path = root / dataset.folder / file.name
    if _is_there(path, file):
        return FetchedFile(path, "there")
    if file.bundled:
        content = (REGISTRY.parent / file.bundled).read_bytes()
        write_atomically(path, lambda temporary: _write_verified(temporary, content, file, file.bundled))
        return FetchedFile(path, "copied")
    if file.raw is not None and file.by is not None:
        try:
            # A mirror of a data folder has the derived file too.
            if source:
                _download(dataset, file, path, progress, source)
                return FetchedFile(path, "fetched")
        except _NotThereError:
            pass
        raw = path.with_name(file.raw.name)
        if not _is_there(raw, file.raw):
            _download(dataset, file.raw, raw, progress, source)
        derived = DERIVATIONS[file.by](raw)
        write_atomically(path, lambda temporary: _write_verified(temporary, derived, file, f"{raw}: derived from it"))
        return FetchedFile(path, "derived")
    _download(dataset, file, path, progress, source)
    return FetchedFile(path, "fetched")


def _is_there(path: Path, file: RawFile) -> bool:
    """Return whether a file is in place, and refuse one with another checksum."""
    if not path.is_file():
        return False
    found = _sha256(path)
    if found != file.sha256:
        raise BoresightError(
            f"{path}: has the checksum {found[:12]}..., not the registered {file.sha256[:12]}...: move it away to fetch"
            " it again"
        )
    return True


def _write_verified(path: Path, content: bytes, file: RawFile, what: str) -> None:
    if hashlib.sha256(content).hexdigest() != file.sha256:
        raise BoresightError(f"{what}: {file.name} does not have the registered checksum {file.sha256[:12]}...")
    path.write_bytes(content)


def _download(dataset: DataSet, file: RawFile, path: Path, progress: Progress, source: str) -> None:
    """Bring a raw file into a partial file next to its place, verify it, and move it there."""
    where = dataset.url(file)
    if source:
        where = f"{source.rstrip('/')}/{dataset.folder}/{file.name}"
    part = path.with_name(f"{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        resumed = _receive(where, file, part, progress)
        if _sha256(part) != file.sha256 and resumed:
            # The part was of another file: once more from the beginning.
            part.unlink()
            _receive(where, file, part, progress)
        found = _sha256(part)
        if found != file.sha256:
            part.unlink()
            raise BoresightError(
                f"{where}: has the checksum {found[:12]}..., not the registered {file.sha256[:12]}...: nothing was"
                " kept; try again, or another source with --from"
            )
        part.replace(path)
    except requests.exceptions.RequestException as error:
        raise network_fault(where, error) from error
    except OSError as error:
        raise BoresightError(disk_fault(path, error)) from error


def _receive(where: str, file: RawFile, part: Path, progress: Progress) -> bool:
    """Write a file, or what is missing of it, to a partial file; return whether a part was there to begin with."""
    start = part.stat().st_size if part.is_file() else 0
    if start > file.bytes:
        start = 0
    if not re.match(r"https?://", where):
        _copy(Path(where).expanduser(), file, part)
        return False
    if start == file.bytes:
        return True
    # Without the encoding, lengths and ranges would be those of compressed data.
    headers = {"Accept-Encoding": "identity", **({"Range": f"bytes={start}-"} if start else {})}
    with requests.get(where, headers=headers, stream=True, timeout=TIMEOUT_S) as answer:
        if answer.status_code == requests.codes.requested_range_not_satisfiable and start:
            part.unlink()
            return _receive(where, file, part, progress)
        answer.raise_for_status()
        start = _start(answer, start, where)
        length = answer.headers.get("Content-Length", "")
        if length.isdigit() and start + int(length) != file.bytes:
            raise BoresightError(
                f"{where}: has {start + int(length)} bytes, not the registered {file.bytes}; nothing was kept"
            )
        _write(answer, start, file, part, progress)
    return start > 0


def _copy(found: Path, file: RawFile, part: Path) -> None:
    """Copy a file of a folder; a missing one, or one of another size, is refused."""
    if not found.is_file():
        raise _NotThereError(f"{found}: no such file: give the folder that holds {file.name} under its path as --from")
    if found.stat().st_size != file.bytes:
        raise BoresightError(
            f"{found}: has {found.stat().st_size} bytes, not the registered {file.bytes}; nothing was kept"
        )
    shutil.copyfile(found, part)


def _start(answer: requests.Response, wanted: int, where: str) -> int:
    """Return the position in the file at which a response starts: the wanted one, or 0."""
    if answer.status_code != requests.codes.partial_content:
        return 0
    match = re.match(r"bytes (\d+)-", answer.headers.get("Content-Range", ""))
    start = int(match.group(1)) if match else 0
    if start not in (0, wanted):
        raise BoresightError(f"{where}: the server sent bytes from {start} on, not from {wanted}")
    return start


def _write(answer: requests.Response, start: int, file: RawFile, part: Path, progress: Progress) -> None:
    done = start
    with part.open("r+b" if start else "wb") as stream:
        stream.seek(start)
        for chunk in answer.iter_content(_CHUNK_BYTES):
            stream.write(chunk[: file.bytes - done])
            done += len(chunk)
            progress(file.name, min(done, file.bytes), file.bytes)
            if done > file.bytes:
                break
        stream.truncate()
        stream.flush()
        os.fsync(stream.fileno())
    if done > file.bytes:
        part.unlink()
        raise BoresightError(f"{answer.url}: has more than the registered {file.bytes} bytes; nothing was kept")
    if done < file.bytes:
        raise _BrokenOffError(f"{done} of {file.bytes} bytes came")


def network_fault(url: str, error: requests.exceptions.RequestException) -> BoresightError:
    """Describe a network error in one line."""
    if isinstance(error, requests.exceptions.HTTPError) and error.response is not None:
        status = error.response.status_code
        kind = _NotThereError if status == requests.codes.not_found else BoresightError
        return kind(f"{url}: the server says {status} {error.response.reason}: give another source with --from")
    reason = "no connection"
    if isinstance(error, requests.exceptions.Timeout):
        reason = f"no answer within {TIMEOUT_S:.0f} s"
    elif isinstance(error, requests.exceptions.ChunkedEncodingError | _BrokenOffError):
        reason = "the connection broke off"
    elif isinstance(error, requests.exceptions.ProxyError):
        reason = "no connection through the proxy"
    return BoresightError(
        f"{url}: {reason}: check the network, or give a mirror with --from URL or FOLDER; the same command goes on"
        " where this one stopped"
    )


def disk_fault(path: Path, error: OSError) -> str:
    """Describe in one line why a file could not be written."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return f"{path}: the disk is full: free some space; the same command goes on where this one stopped"
    return f"{path}: {error.strerror or error}: set {DATA_VARIABLE} to a folder that can be written"


def _sha256(path: Path) -> str:
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise BoresightError(disk_fault(path, error)) from error

"""Downloads of registered data sets, resumable, verified by checksums and stored atomically."""

from __future__ import annotations

import errno
import hashlib
import json
import logging
import os
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urljoin, urlparse

import pooch
import requests

from scenarios.atomic import write_text
from scenarios.data import DATA_VARIABLE
from scenarios.data.datasets import FILE_NAME, DataSetSpec, FileSpec
from scenarios.errors import BoresightError
from scenarios.reading import read_json

_CHECKSUM_FILE = ".boresight-fetched.json"
_REGISTERED, _FIRST, _NOTHING = "registration", "first fetch", "nothing"

TIMEOUT_S = 30.0
_CHUNK_BYTES = 1 << 16
Progress = Callable[[str, int, int | None], None]


class _BrokenOffError(requests.exceptions.RequestException):
    """The server sent fewer bytes than announced."""


class ResumingDownloader:
    """Downloader into a partial file, which resumes an interrupted download.

    It is resumed only if the file on the server is unchanged (HTTP header If-Range).

    Parameters
    ----------
    part
        The partial file; its version on the server is stored in a second file with the suffix ``-of``.
    size_bytes
        Size of the file, or None if it is unknown.
    progress
        Called with the name, the bytes received and the size of the file (None if unknown).
    """

    def __init__(self, part: Path, size_bytes: int | None, progress: Progress) -> None:
        self._part = part
        self._tag = part.with_name(f"{part.name}-of")
        self._size_bytes = size_bytes
        self._progress = progress

    def __call__(self, url: str, output_file: str, _pooch: object) -> None:
        """Download a file for pooch, which then verifies the checksum and moves the file to its destination."""
        tag = self._tag.read_text(encoding="utf-8") if self._tag.is_file() else ""
        have = self._part.stat().st_size if tag and self._part.is_file() else 0
        headers = {"Range": f"bytes={have}-", "If-Range": tag} if have else {}
        headers["Accept-Encoding"] = "identity"  # otherwise lengths and ranges refer to compressed data
        with requests.get(url, headers=headers, stream=True, timeout=TIMEOUT_S) as answer:
            if answer.status_code == requests.codes.requested_range_not_satisfiable:
                self._delete_part()
                return self(url, output_file, _pooch)
            answer.raise_for_status()
            start = _start(answer)
            if start not in (0, have):
                raise BoresightError(f"{url}: the server sent bytes from {start} on, not from {have}")
            total = _total(answer, start)
            self._check_size(url, total, start)
            self._tag.write_text(_version_tag(answer), encoding="utf-8")
            self._write(answer, start, total, url)
        Path(self._part).replace(output_file)
        self._tag.unlink(missing_ok=True)
        return None

    def _check_size(self, url: str, total: int | None, start: int) -> None:
        if total is not None and self._size_bytes is not None and total != self._size_bytes:
            raise BoresightError(f"{url}: has {total} bytes, not the registered {self._size_bytes}; nothing was kept")
        free = shutil.disk_usage(self._part.parent).free
        if total is not None and total - start > free:
            raise BoresightError(
                f"{self._part.parent}: {(total - start) / 2**20:.0f} MiB are to come, but the disk has"
                f" {free / 2**20:.0f} MiB left"
            )

    def _write(self, answer: requests.Response, start: int, total: int | None, url: str) -> None:
        done = start
        with self._part.open("r+b" if start else "wb") as stream:
            stream.seek(start)
            for chunk in answer.iter_content(_CHUNK_BYTES):
                stream.write(chunk)
                done += len(chunk)
                self._progress(self._part.name.removesuffix(".part"), done, total)
            stream.truncate()
            stream.flush()
            os.fsync(stream.fileno())
        if total is not None and done != total:
            raise _BrokenOffError(f"{done} of {total} bytes came")

    def _delete_part(self) -> None:
        self._part.unlink(missing_ok=True)
        self._tag.unlink(missing_ok=True)


def _start(answer: requests.Response) -> int:
    """Return the position in the file at which a response starts."""
    if answer.status_code != requests.codes.partial_content:
        return 0
    match = re.match(r"bytes (\d+)-", answer.headers.get("Content-Range", ""))
    return int(match.group(1)) if match else 0


def _total(answer: requests.Response, start: int) -> int | None:
    """Return the size of the whole file, or None if the server does not state it."""
    length = answer.headers.get("Content-Length", "")
    return start + int(length) if length.isdigit() else None


def _version_tag(answer: requests.Response) -> str:
    """Return an identifier of the file's version (ETag or modification time); '' if the server sends none."""
    tag = answer.headers.get("ETag", "")
    return tag if tag and not tag.startswith("W/") else answer.headers.get("Last-Modified", "")


def network_fault(url: str, error: requests.exceptions.RequestException) -> str:
    """Describe a network error in one line."""
    if isinstance(error, requests.exceptions.HTTPError) and error.response is not None:
        return f"{url}: the server says {error.response.status_code} {error.response.reason}"
    reason = "no connection"
    if isinstance(error, requests.exceptions.Timeout):
        reason = f"no answer within {TIMEOUT_S:.0f} s"
    elif isinstance(error, requests.exceptions.ChunkedEncodingError | _BrokenOffError):
        reason = "the connection broke off"
    return f"{url}: {reason}: check the network; the same command goes on where this one stopped"


def disk_fault(path: Path, error: OSError) -> str:
    """Describe in one line why a file could not be written."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return f"{path}: the disk is full: free some space; the same command goes on where this one stopped"
    return f"{path}: {error.strerror or error}: set {DATA_VARIABLE} to a folder that can be written"


@dataclass(frozen=True, slots=True)
class FetchedFile:
    """A file of a data set, downloaded or already present.

    Parameters
    ----------
    path
        Its path.
    sha256
        Its checksum.
    how
        ``there`` if it was present, ``fetched`` if it was downloaded.
    trust
        Source of the checksum that it was compared with: ``registration``, ``first fetch``, or ``nothing`` if this is
        the first download, whose checksum is stored for later ones.
    """

    path: Path
    sha256: str
    how: str
    trust: str


def fetch(dataset: DataSetSpec, root: Path, progress: Progress) -> Iterator[FetchedFile]:
    """Download the missing files of a data set, and verify those present.

    Parameters
    ----------
    dataset
        The data set.
    root
        The data folder.
    progress
        Called with the file name, the bytes received and the size of the file (None if unknown).

    Raises
    ------
    BoresightError
        If the network, the server or the disk fails, or a checksum differs. Complete files remain, and a partial file
        from which the next call resumes.
    """
    folder = root / dataset.folder
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BoresightError(disk_fault(folder, error)) from error
    checksums = _ChecksumFile(folder / _CHECKSUM_FILE)
    for file in _files(dataset):
        yield _fetch_file(file, folder, checksums, progress)


def state(dataset: DataSetSpec, root: Path) -> str:
    """Describe how many files of a data set are present, by their names."""
    folder = root / dataset.folder
    if dataset.files is None:
        known = _ChecksumFile(folder / _CHECKSUM_FILE).names()
        there = sum((folder / name).is_file() for name in known)
        return f"{there} files" if there else "not there"
    there = sum((folder / file.file_name).is_file() for file in dataset.files)
    return (
        "there" if there == len(dataset.files) else f"{there} of {len(dataset.files)} files" if there else "not there"
    )


def _fetch_file(file: FileSpec, folder: Path, checksums: _ChecksumFile, progress: Progress) -> FetchedFile:
    path = folder / file.file_name
    known, trust = (file.sha256, _REGISTERED) if file.sha256 else (checksums.sha256(path.name), _FIRST)
    if path.is_file():
        found = _sha256(path)
        if known is not None and found != known:
            raise BoresightError(
                f"{path}: has the checksum {found[:12]}..., not {known[:12]}..., that of the {trust}: move it away to"
                " fetch it anew"
            )
        if known is None:
            checksums.add(file, path, found)
        return FetchedFile(path, found, "there", trust if known else _NOTHING)
    getter = ResumingDownloader(path.with_name(f"{path.name}.part"), file.size_bytes, progress)
    pooch.get_logger().setLevel(logging.ERROR)
    try:
        pooch.retrieve(file.url, f"sha256:{known}" if known else None, path.name, folder, downloader=getter)
    except requests.exceptions.RequestException as error:
        raise BoresightError(network_fault(file.url, error)) from error
    except ValueError as error:
        raise BoresightError(
            f"{file.url}: the checksum is not {str(known)[:12]}..., that of the {trust}: nothing was kept; the file has"
            " changed on the server, or was damaged on the way: try again"
        ) from error
    except OSError as error:
        raise BoresightError(disk_fault(path, error)) from error
    found = _sha256(path)
    checksums.add(file, path, found)
    return FetchedFile(path, found, "fetched", trust if known else _NOTHING)


class _ChecksumFile:
    """JSON file in the folder of a data set with the checksums of the first downloads."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def names(self) -> list[str]:
        return list(self._read())

    def sha256(self, name: str) -> str | None:
        known = self._read().get(name, {}).get("sha256")
        return str(known) if known else None

    def add(self, file: FileSpec, path: Path, sha256: str) -> None:
        about = {"url": file.url, "bytes": path.stat().st_size, "sha256": sha256}
        entry = {**about, "since": datetime.now(UTC).isoformat(timespec="seconds")}
        write_text(self._path, json.dumps({**self._read(), path.name: entry}, indent=1, sort_keys=True))

    def _read(self) -> dict[str, dict[str, Any]]:
        try:
            entries = read_json(self._path, "the checksums of what was fetched")
        except FileNotFoundError:
            return {}
        if not isinstance(entries, dict) or not all(
            isinstance(entry, dict) and re.fullmatch(FILE_NAME, name) for name, entry in entries.items()
        ):
            raise BoresightError(f"{self._path}: does not hold the checksums of what was fetched: move it away")
        return entries


def _files(dataset: DataSetSpec) -> list[FileSpec]:
    """Return the files of a data set, from the server's listing if it is registered as a folder."""
    if dataset.files is not None:
        return list(dataset.files)
    listing = dataset.listing
    if listing is None:
        return []
    try:
        answer = requests.get(listing.url, timeout=TIMEOUT_S)
        answer.raise_for_status()
    except requests.exceptions.RequestException as error:
        raise BoresightError(network_fault(listing.url, error)) from error
    links = _Links()
    links.feed(answer.text)
    names = {unquote(urlparse(urljoin(listing.url, link)).path).rsplit("/", 1)[-1] for link in links.found}
    wanted = sorted(name for name in names if re.fullmatch(listing.pattern, name))
    if not wanted:
        raise BoresightError(f"{listing.url}: lists no file that matches {listing.pattern!r}")
    for name in wanted:
        if not re.fullmatch(FILE_NAME, name):
            raise BoresightError(f"{listing.url}: lists {name!r}, which is no plain file name: narrow the pattern")
    return [FileSpec(url=urljoin(listing.url, name)) for name in wanted]


class _Links(HTMLParser):
    """Parser that collects the link targets of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Store the target of a link."""
        self.found += [value for name, value in attrs if tag == "a" and name == "href" and value]


def _sha256(path: Path) -> str:
    digest = hashlib.sha256()
    try:
        with path.open("rb") as stream:
            while chunk := stream.read(1 << 20):
                digest.update(chunk)
    except OSError as error:
        raise BoresightError(disk_fault(path, error)) from error
    return digest.hexdigest()

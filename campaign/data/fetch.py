"""Downloads of registered data sets: resumed where they broke off, checked, and whole or not there at all."""

from __future__ import annotations

import hashlib
import json
import logging
import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urljoin, urlparse

import pooch
import requests

from campaign.data.download import TIMEOUT_S, Progress, ResumingDownloader, disk_fault, network_fault
from scenarios.atomic import write_text
from scenarios.data.datasets import FILE_NAME, DataSetSpec, FileSpec
from scenarios.errors import BoresightError
from scenarios.reading import read_json

_LEDGER = ".boresight-fetched.json"
_REGISTERED, _FIRST, _NOTHING = "registration", "first fetch", "nothing"


@dataclass(frozen=True, slots=True)
class Fetched:
    """A file that is now there.

    Parameters
    ----------
    path
        Where it lies.
    sha256
        Its checksum.
    how
        ``there`` already, or ``fetched`` now.
    trust
        Whose checksum it was held against: ``registration``, ``first fetch``, or ``nothing``, because this is the first
        fetch, whose checksum is kept and holds from now on.
    """

    path: Path
    sha256: str
    how: str
    trust: str


def fetch(dataset: DataSetSpec, root: Path, progress: Progress) -> Iterator[Fetched]:
    """Fetch what is not there yet of a data set.

    Parameters
    ----------
    dataset
        The data set.
    root
        The data folder.
    progress
        Told the file, the bytes that are here and those of the whole file, None where they are not known.

    Raises
    ------
    BoresightError
        If the network, the server or the disk fails, or a file is not what it should be. What is whole stays; a part
        of a file stays under another name, from which the next call goes on.
    """
    folder = root / dataset.folder
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BoresightError(disk_fault(folder, error)) from error
    ledger = _Ledger(folder / _LEDGER)
    for file in _files(dataset):
        yield _fetch_file(file, folder, ledger, progress)


def state(dataset: DataSetSpec, root: Path) -> str:
    """Say how much of a data set is there, by the names of its files."""
    folder = root / dataset.folder
    if dataset.files is None:
        known = _Ledger(folder / _LEDGER).names()
        there = sum((folder / name).is_file() for name in known)
        return f"{there} files" if there else "not there"
    there = sum((folder / file.file_name).is_file() for file in dataset.files)
    return (
        "there" if there == len(dataset.files) else f"{there} of {len(dataset.files)} files" if there else "not there"
    )


def _fetch_file(file: FileSpec, folder: Path, ledger: _Ledger, progress: Progress) -> Fetched:
    path = folder / file.file_name
    known, trust = (file.sha256, _REGISTERED) if file.sha256 else (ledger.sha256(path.name), _FIRST)
    if path.is_file():
        found = _sha256(path)
        if known is not None and found != known:
            raise BoresightError(
                f"{path}: has the checksum {found[:12]}..., not {known[:12]}..., that of the {trust}: move it away to"
                " fetch it anew"
            )
        if known is None:
            ledger.add(file, path, found)
        return Fetched(path, found, "there", trust if known else _NOTHING)
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
    ledger.add(file, path, found)
    return Fetched(path, found, "fetched", trust if known else _NOTHING)


class _Ledger:
    """Keeps what was fetched into a folder, with the checksums that hold from the first fetch on."""

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
    """List the files of a data set, asking the server where it says a folder."""
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
    """Collects the links of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Keep the target of a link."""
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

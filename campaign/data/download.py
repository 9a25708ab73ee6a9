"""One file from the net to the disk: resumed where it broke off."""

from __future__ import annotations

import errno
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import requests

from scenarios.data import DATA_VARIABLE
from scenarios.errors import BoresightError

TIMEOUT_S = 30.0
_CHUNK_BYTES = 1 << 16
Progress = Callable[[str, int, int | None], None]


class _BrokenOffError(requests.exceptions.RequestException):
    """Fewer bytes came than the server had promised."""


class ResumingDownloader:
    """Downloads into ``part`` first, and goes on there if an earlier call broke off.

    The server is asked to go on only if the file is still the one that was begun (If-Range).

    Parameters
    ----------
    part
        Where to write; beside it lies what tells the version of the file.
    size_bytes
        Size of the file, or None where it is not known.
    progress
        Told the name, the bytes that are here and those of the whole file, None where they are not known.
    """

    def __init__(self, part: Path, size_bytes: int | None, progress: Progress) -> None:
        self._part = part
        self._tag = part.with_name(f"{part.name}-of")
        self._size_bytes = size_bytes
        self._progress = progress

    def __call__(self, url: str, output_file: str, _pooch: object) -> None:
        """Download for pooch, which checks the checksum and moves the file to its place."""
        tag = self._tag.read_text(encoding="utf-8") if self._tag.is_file() else ""
        have = self._part.stat().st_size if tag and self._part.is_file() else 0
        headers = {"Range": f"bytes={have}-", "If-Range": tag} if have else {}
        headers["Accept-Encoding"] = "identity"  # else lengths and ranges are those of compressed bytes
        with requests.get(url, headers=headers, stream=True, timeout=TIMEOUT_S) as answer:
            if answer.status_code == requests.codes.requested_range_not_satisfiable:
                self._forget()
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

    def _forget(self) -> None:
        self._part.unlink(missing_ok=True)
        self._tag.unlink(missing_ok=True)


def _start(answer: requests.Response) -> int:
    """Return the place in the file at which an answer starts."""
    if answer.status_code != requests.codes.partial_content:
        return 0
    match = re.match(r"bytes (\d+)-", answer.headers.get("Content-Range", ""))
    return int(match.group(1)) if match else 0


def _total(answer: requests.Response, start: int) -> int | None:
    """Return the size of the whole file, as far as the server tells."""
    length = answer.headers.get("Content-Length", "")
    return start + int(length) if length.isdigit() else None


def _version_tag(answer: requests.Response) -> str:
    """Return what tells this version of a file from another; empty where the server does not tell."""
    tag = answer.headers.get("ETag", "")
    return tag if tag and not tag.startswith("W/") else answer.headers.get("Last-Modified", "")


def network_fault(url: str, error: requests.exceptions.RequestException) -> str:
    """Say in one line what went wrong on the net."""
    if isinstance(error, requests.exceptions.HTTPError) and error.response is not None:
        return f"{url}: the server says {error.response.status_code} {error.response.reason}"
    reason = "no connection"
    if isinstance(error, requests.exceptions.Timeout):
        reason = f"no answer within {TIMEOUT_S:.0f} s"
    elif isinstance(error, requests.exceptions.ChunkedEncodingError | _BrokenOffError):
        reason = "the connection broke off"
    return f"{url}: {reason}: check the network; the same command goes on where this one stopped"


def disk_fault(path: Path, error: OSError) -> str:
    """Say in one line why a file could not be kept."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return f"{path}: the disk is full: free some space; the same command goes on where this one stopped"
    return f"{path}: {error.strerror or error}: set {DATA_VARIABLE} to a folder that can be written"

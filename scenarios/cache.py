"""Cache of expensive results on disk, by content key.

Entries are folders ``ROOT/KIND/KEY`` with a manifest of their files' digests. An entry is built in a separate folder
and renamed, so that it is complete or absent; a damaged one is removed and built again. If the cache cannot be
written, the entry is built in a temporary folder of this process, and a warning is logged.

Eviction removes the entries with the largest product of size and time since the last use. Entries of the kinds in
``FOREIGN`` are written and checked by other programs: their folders have no manifest, but they are listed, counted and
removed like the others.
"""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import json
import logging
import os
import re
import shutil
import tempfile
import time
import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import platformdirs

from boresight.scenarios.errors import BoresightError

_log = logging.getLogger(__name__)

FOREIGN = frozenset({"kernels"})

_MANIFEST = "manifest.json"
_STALE_S = 24 * 3600.0  # age at which the folder of a build counts as left behind by a killed process
# Listing the whole cache takes longer than a small write. A process therefore writes up to a share of the free space
# before it lists again (other processes write meanwhile), but at least a share of the limit, or a full cache would be
# listed at each write.
_SHARE_OF_FREE, _SHARE_OF_ALL = 1 / 4, 1 / 50
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,127}")


@dataclass(frozen=True, slots=True)
class CacheEntry:
    """One entry: kind, key, folder, size and time of the last use (seconds since 1970)."""

    kind: str
    key: str
    path: Path
    size_bytes: int
    used_s: float


@dataclass(frozen=True, slots=True)
class Cache:
    """A cache under one folder, created when first needed.

    After a build, entries are removed in descending order of size times time since the last use until the rest fits
    into ``limit_bytes``.
    """

    root: Path
    limit_bytes: int

    def folder(self, kind: str, key: str, build: Callable[[Path], None]) -> Path:
        """Return the folder of an entry, built by ``build(empty_folder)`` if it is missing or damaged.

        Safe for concurrent processes: each builds in a folder of its own, and the first to finish is kept. ``kind`` and
        ``key`` consist of letters, digits and ``._-``; the key must identify everything that the content depends on.
        """
        found = self.find(kind, key)
        if found is not None:
            return found
        final = self._entry_folder(kind, key)
        _discard(final)
        try:
            build_folder = self._new_build_folder()
        except OSError as error:
            return self._uncached(error, build)
        try:
            build(build_folder)
            # The manifest is written last: a folder without one is no entry.
            _write_manifest(build_folder)
            self._publish(build_folder, final)
        except OSError as error:
            return self._uncached(error, build)
        finally:
            shutil.rmtree(build_folder, ignore_errors=True)
        self._evict(keep=final)
        return final

    def find(self, kind: str, key: str) -> Path | None:
        """Return the folder of an entry; None if it is missing or damaged."""
        final = self._entry_folder(kind, key)
        return final if self._is_sound(final) else None

    def put(self, kind: str, key: str, write: Callable[[Path], object]) -> bool:
        """Store an entry made by ``write(empty_folder)``, replacing an older one; return whether it was stored.

        If the cache cannot be written, log a warning and store nothing.
        """
        final = self._entry_folder(kind, key)
        try:
            build_folder = self._new_build_folder()
            try:
                write(build_folder)
                size = sum(file.stat().st_size for file in _files(build_folder))
                _write_manifest(build_folder)
                _discard(final)
                self._publish(build_folder, final)
            finally:
                shutil.rmtree(build_folder, ignore_errors=True)
        except OSError as error:
            _log.warning("%s cannot be written (%s): nothing is kept there", self.root, error.strerror or error)
            return False
        _WRITABLE_BYTES[self] = _WRITABLE_BYTES.get(self, 0.0) - size
        if _WRITABLE_BYTES[self] < 0.0:
            self._evict(keep=final)
        return True

    def entries(self) -> tuple[CacheEntry, ...]:
        """List the entries, least recently used first."""
        marks = [(manifest.parent, manifest) for manifest in self.root.glob(f"*/*/{_MANIFEST}")]
        marks += [(path, path) for kind in sorted(FOREIGN) for path in self.root.glob(f"{kind}/*")]
        found = []
        for path, mark in marks:
            if any(name.startswith(".") for name in (path.name, path.parent.name)):
                continue
            with contextlib.suppress(OSError):
                size = sum(file.stat().st_size for file in _files(path))
                found.append(CacheEntry(path.parent.name, path.name, path, size, mark.stat().st_mtime))
        return tuple(sorted(found, key=lambda entry: (entry.used_s, entry.path)))

    def size_bytes(self, kind: str | None = None) -> int:
        """Return the total size of all entries, or of those of a kind."""
        return sum(entry.size_bytes for entry in self.entries() if kind in (None, entry.kind))

    def clear(self, kind: str | None = None) -> int:
        """Remove all entries, or those of a kind, and the remains of killed builds; return the number of entries."""
        entries = [entry for entry in self.entries() if kind in (None, entry.kind)]
        for entry in entries:
            _discard(entry.path)
        for leftover in self._build_root().glob("*"):
            shutil.rmtree(leftover, ignore_errors=True)
        return len(entries)

    def _entry_folder(self, kind: str, key: str) -> Path:
        for name in (kind, key):
            if not _NAME.fullmatch(name):
                raise BoresightError(f"cache entry {kind}/{key}: a name has only letters, digits and . _ -")
        return self.root / kind / key

    def _build_root(self) -> Path:
        return self.root / ".building"

    def _new_build_folder(self) -> Path:
        self._build_root().mkdir(parents=True, exist_ok=True)
        for leftover in self._build_root().iterdir():
            with contextlib.suppress(OSError):
                if time.time() - leftover.stat().st_mtime > _STALE_S:
                    shutil.rmtree(leftover, ignore_errors=True)
        build_folder = self._build_root() / uuid.uuid4().hex
        build_folder.mkdir()
        return build_folder

    def _is_sound(self, folder: Path) -> bool:
        try:
            digests = json.loads((folder / _MANIFEST).read_text())["sha256"]
            sound: bool = {str(file.relative_to(folder)): _sha256(file) for file in _files(folder)} == digests
        except (OSError, ValueError, KeyError, TypeError):
            return False
        if sound:
            with contextlib.suppress(OSError):
                # The time stamp of the manifest records the last use.
                os.utime(folder / _MANIFEST)
        return sound

    def _publish(self, build_folder: Path, final: Path) -> None:
        """Rename into place; keep an entry that another process has stored meanwhile."""
        final.parent.mkdir(parents=True, exist_ok=True)
        try:
            build_folder.rename(final)
        except OSError:
            # The rename fails if the folder is there: fine if it is the same entry.
            if not self._is_sound(final):
                raise

    def _uncached(self, error: OSError, build: Callable[[Path], None]) -> Path:
        _log.warning("%s cannot be written (%s): working without the cache", self.root, error.strerror or error)
        try:
            folder = Path(tempfile.mkdtemp(prefix="boresight-"))
            atexit.register(shutil.rmtree, folder, ignore_errors=True)
            build(folder)
        except OSError as second:
            raise BoresightError(
                f"{second.filename or tempfile.gettempdir()}: cannot write ({second.strerror or second});"
                " free some space or set BORESIGHT_CACHE to a folder that can be written"
            ) from second
        return folder

    def _evict(self, keep: Path) -> None:
        entries, now_s = self.entries(), time.time()
        total = sum(entry.size_bytes for entry in entries)
        for entry in sorted(entries, key=lambda entry: -entry.size_bytes * max(now_s - entry.used_s, 1.0)):
            if total <= self.limit_bytes:
                break
            if entry.path != keep:
                _discard(entry.path)
                total -= entry.size_bytes
        # An allowance for further writes before the next listing.
        free = self.limit_bytes - total
        _WRITABLE_BYTES[self] = max(_SHARE_OF_FREE * free, _SHARE_OF_ALL * self.limit_bytes)


# Bytes that this process may still write to each cache before it lists the entries again.
_WRITABLE_BYTES: dict[Cache, float] = {}


def default_cache() -> Cache:
    """Open the user's cache: folder $BORESIGHT_CACHE or the platform's, limit $BORESIGHT_CACHE_GB or 4 GB."""
    place = os.environ.get("BORESIGHT_CACHE") or platformdirs.user_cache_dir("boresight")
    limit = os.environ.get("BORESIGHT_CACHE_GB") or "4"
    try:
        limit_bytes = int(float(limit) * 1e9)
    except (ValueError, OverflowError):
        limit_bytes = -1
    if limit_bytes < 0:
        raise BoresightError(f"BORESIGHT_CACHE_GB: {limit!r} is not a size in GB; give a number of 0 or more")
    return Cache(Path(place).expanduser(), limit_bytes)


def _files(folder: Path) -> Iterator[Path]:
    return (file for file in sorted(folder.rglob("*")) if file.is_file() and file.name != _MANIFEST)


def _sha256(file: Path) -> str:
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _write_manifest(folder: Path) -> None:
    digests = {str(file.relative_to(folder)): _sha256(file) for file in _files(folder)}
    (folder / _MANIFEST).write_text(json.dumps({"sha256": digests}))


def _discard(folder: Path) -> None:
    """Rename an entry before removing it, so that no other process sees a part of it."""
    doomed = folder.with_name(f".{folder.name}.{uuid.uuid4().hex}")
    with contextlib.suppress(OSError):
        folder.rename(doomed)
        shutil.rmtree(doomed, ignore_errors=True)

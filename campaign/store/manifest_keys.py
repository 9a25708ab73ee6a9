"""What the entries of a stored manifest are: it may have been damaged, or written by somebody else."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from campaign.store.columns import FORMAT_VERSION
from scenarios.errors import BoresightError
from scenarios.reading import held_to, plain_json, unreadable

_Text = str | None
_Count = Annotated[int, Field(ge=0, lt=2**63)]


class _Entries(BaseModel):
    """What every manifest has from its first writing on, and the kinds of what boresight reads of the rest."""

    model_config = ConfigDict(strict=True, extra="ignore")

    digest: str
    name: str
    seed: int
    trials: _Count
    scenarios: dict[str, dict[str, Any]]
    identity: dict[str, Any] = {}
    title: _Text = ""
    description: _Text = ""
    report: _Text = None
    campaign: dict[str, Any] = {}
    overrides: list[str] = []
    draft: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0
    files: dict[str, list[str]] = {}
    estimators: list[str] = []
    credits: list[str] = []
    created: _Text = ""
    finished: _Text = ""
    updated: _Text = ""
    start: _Count = 0
    command: _Text = ""
    commit: _Text = ""
    versions: dict[str, Any] = {}
    machine: dict[str, Any] = {}
    notes: list[str] = []


def read_manifest(path: Path) -> dict[str, Any]:
    """Read the manifest of a run as it is.

    Raises
    ------
    BoresightError
        If it is none that boresight writes, or that of a run that another version stored in another way.
    """
    try:
        found = plain_json(path)
        manifest: dict[str, Any] = found if isinstance(found, dict) else {}
        _check_version(manifest, path)
        held_to(_Entries, manifest)
    except (OSError, ValueError) as error:
        raise unreadable(path, "a manifest", error) from error
    return manifest


def _check_version(manifest: Mapping[str, Any], path: Path) -> None:
    missing = [key for key, entry in _Entries.model_fields.items() if entry.is_required() and key not in manifest]
    if missing:
        raise BoresightError(
            f"{path}: not a manifest of boresight, which has a {missing[0]}: choose another folder with --out"
        )
    stored = manifest.get("format", "unknown")
    if stored != FORMAT_VERSION:
        raise BoresightError(
            f"{path.parent}: stored in format {stored}, and this version of boresight reads {FORMAT_VERSION}: run the"
            " campaign again, into another folder (--out)"
        )

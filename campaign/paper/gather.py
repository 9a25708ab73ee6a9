"""The newest finished run of each campaign."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from campaign.newest import start_of
from campaign.resolve import ResolvedCampaign, reload
from campaign.store import RunFolder
from reports.content import Content, read_content
from scenarios.errors import BoresightError


@dataclass(frozen=True, eq=False)
class FinishedRun:
    """A stored run that holds all the trials that it was asked for.

    Parameters
    ----------
    folder
        Where it lies.
    manifest
        How it was made.
    """

    folder: RunFolder
    manifest: dict[str, Any]

    @cached_property
    def content(self) -> Content:
        """What its report says."""
        return read_content(self.folder.path)

    def labels(self, method: str) -> list[str]:
        """List the labels under which an estimator ran, by its name."""
        entries = [entry for each in self.manifest["campaign"]["estimators"] for entry in each.items()]
        return [str(options.get("label", name)) for name, options in entries if name == method]

    def campaign(self) -> ResolvedCampaign:
        """Resolve its campaign again, to draw what is not stored.

        Raises
        ------
        BoresightError
            If code or data have changed since, or the data are gone.
        """
        campaign = reload(self.manifest)
        if campaign is None:
            raise BoresightError(
                f"{self.folder.path}: was made by another version of boresight or of its data: "
                f"to draw this, run `boresight run {self.manifest['name']}` again"
            )
        return campaign


def newest_finished(runs: Sequence[Path], name: str, draft: float = 1.0) -> FinishedRun | None:
    """Return the finished run of a campaign that was started last among some folders; None without any.

    Drafts are runs of fewer trials and smaller data bases: those of a scale are asked for by it.

    Runs with ``--set`` are of another world than the paper's, whatever campaign they began from.
    """
    finished = []
    for path in runs:
        folder = RunFolder(path)
        try:
            manifest = folder.read_manifest()
        except BoresightError:
            continue
        if manifest is None or manifest.get("name") != name or manifest.get("overrides"):
            continue
        if float(manifest.get("draft", 1.0)) == draft and _is_whole(folder, manifest):
            finished.append(FinishedRun(folder, manifest))
    return max(finished, key=lambda run: (start_of(run.folder.path), str(run.manifest["finished"])), default=None)


def _is_whole(folder: RunFolder, manifest: dict[str, Any]) -> bool:
    """Tell whether all trials are there: a finished run may have been asked for more afterwards."""
    if not manifest.get("finished"):
        return False
    rows = folder.table("rows")
    wanted = int(manifest["trials"]) * len(manifest["scenarios"])
    return len(rows[["scenario", "trial"]].drop_duplicates()) >= wanted


def run_folders(runs: Path) -> list[Path]:
    """List the folders below ``runs`` that hold a manifest, by name."""
    return sorted(path.parent for path in runs.glob("*/manifest.json"))

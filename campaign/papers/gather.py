"""Search for the newest finished run of each campaign of a paper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.runs.read import campaign_names
from boresight.campaign.runs.resolve import reload
from boresight.campaign.store import RunFolder, start_of
from boresight.reports.kinds import Content
from boresight.reports.pages.content import content_of
from boresight.reports.published import load_published
from boresight.reports.run.data import RunData, read_run
from boresight.scenarios.errors import BoresightError, one_line
from boresight.scenarios.reading import plain_json


@dataclass(frozen=True, eq=False)
class FinishedRun:
    """A stored run that contains all requested trials."""

    folder: RunFolder
    manifest: dict[str, Any]

    @cached_property
    def data(self) -> RunData:
        """Tables of the run; raises BoresightError if they are damaged or of another version."""
        return read_run(self.folder.path)

    @cached_property
    def content(self) -> Content:
        """Content of its report."""
        return content_of(self.data)

    def labels(self, method: str) -> list[str]:
        """Return the labels of an estimator in the run, by its name."""
        entries = [entry for each in self.manifest["campaign"]["estimators"] for entry in each.items()]
        return [str(options.get("label", name)) for name, options in entries if name == method]

    def campaign(self) -> ResolvedCampaign:
        """Resolve its campaign, to draw what is not stored.

        Raise BoresightError if code or data have changed since, or the data are gone.
        """
        campaign = reload(self.manifest)
        if campaign is None:
            option = " --embedded" if self.manifest.get("embedded") else ""
            again = f"run `boresight run {self.manifest['name']}{option}` again"
            if float(self.manifest.get("draft", 1.0)) < 1.0:
                again = "remove this draft and give the same command again"
            raise BoresightError(
                f"{self.folder.path}: was made by another version of boresight or of its data: to draw this, {again}"
            )
        return campaign


@dataclass(frozen=True, slots=True)
class GatheredRuns:
    """The newest readable finished run of each campaign that has one, and a line for each run that cannot be read."""

    found: dict[str, FinishedRun]
    refused: tuple[str, ...]


def gather_runs(
    runs: Sequence[Path], names: Sequence[str], draft: float = 1.0, *, embedded: bool = False
) -> GatheredRuns:
    """Find the newest readable finished run of each campaign among some folders.

    With ``draft`` below 1, a draft of that scale is used where there is no full run; with ``embedded``, a run on
    embedded bodies where there is none on the real ones.
    """
    found: dict[str, FinishedRun] = {}
    refused: list[str] = []
    for name in names:
        for built_in, scale in product((False, True) if embedded else (False,), dict.fromkeys((1.0, draft))):
            finished, unread = finished_runs(runs, name, scale, embedded=built_in)
            refused += unread
            for run in finished:
                try:
                    if run.data.manifest.report:
                        load_published(run.data.manifest.report)
                except BoresightError as error:
                    refused.append(_left_out(run.folder.path, error))
                else:
                    found[name] = run
                    break
            if name in found:
                break
    return GatheredRuns(found, tuple(dict.fromkeys(refused)))


def finished_runs(
    runs: Sequence[Path], name: str, draft: float = 1.0, *, embedded: bool = False
) -> tuple[list[FinishedRun], list[str]]:
    """Return the finished runs of a campaign among some folders, the most recently started first.

    Also return a line for each run that may be of the campaign but cannot be read. ``draft`` selects drafts of that
    scale (fewer trials and smaller data bases). Runs with ``--set`` are ignored, as they differ from the paper's, and
    runs on embedded bodies unless ``embedded`` selects them alone.
    """
    finished, refused = [], []
    for path in runs:
        folder = RunFolder(path)
        try:
            manifest = folder.read_manifest()
            if manifest is None or manifest.get("name") != name or manifest.get("overrides"):
                continue
            if bool(manifest.get("embedded")) != embedded:
                continue
            if float(manifest.get("draft", 1.0)) == draft and _is_whole(folder, manifest):
                finished.append(FinishedRun(folder, manifest))
        except BoresightError as error:
            if _may_be_of(path, name):
                refused.append(_left_out(path, error))
    newest = sorted(finished, key=lambda run: (start_of(run.folder.path), str(run.manifest["finished"])), reverse=True)
    return newest, refused


def _left_out(path: Path, error: BoresightError) -> str:
    said = one_line(error)
    return f"left out: {said}" if str(path) in said else f"left out: {path}: {said}"


def _may_be_of(path: Path, name: str) -> bool:
    """Return whether an unreadable run may be of a campaign, by its manifest or the name of its folder."""
    try:
        content = plain_json(path / "manifest.json")
    except (OSError, ValueError):
        content = None
    own = content.get("name") if isinstance(content, dict) else None
    if isinstance(own, str):
        return own == name
    known = [one for one in campaign_names() if path.name.startswith(f"{one}-")]
    return name in known or not known


def _is_whole(folder: RunFolder, manifest: dict[str, Any]) -> bool:
    """Return whether all trials are stored: more may have been requested after the run finished."""
    if not manifest.get("finished"):
        return False
    rows = folder.table("rows")
    wanted = int(manifest["trials"]) * len(manifest["scenarios"])
    return len(rows[["scenario", "trial"]].drop_duplicates()) >= wanted

"""``fetch``: data sets of missions, by name, by campaign and by paper."""

from __future__ import annotations

import argparse
import difflib
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TransferSpeedColumn

from boresight.campaign.catalog import PAGES
from boresight.campaign.cli.terminal import console
from boresight.campaign.data.fetch import bytes_to_come, check_space, fetch, state
from boresight.campaign.runs.read import CATALOG, campaign_names, needs
from boresight.scenarios.data import data_folder
from boresight.scenarios.data.datasets import DataSet, datasets
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import load_campaign
from boresight.scenarios.load.files import SUFFIXES

ALL = "all"


@dataclass(frozen=True, slots=True)
class Wanted:
    """Data sets that can be fetched, those that a user must bring, and missing files of no known data set."""

    fetched: tuple[DataSet, ...]
    own: tuple[DataSet, ...]
    unknown: tuple[str, ...] = ()


def wanted(name: str) -> Wanted:
    """Return the data sets of a name: a data set, a campaign or its file, a paper, or ``all``.

    Raise BoresightError if there is nothing of that name, or it is a data set that cannot be fetched.
    """
    known = datasets()
    if name == ALL:
        return _sorted_out(known.values())
    if name in known:
        one = known[name]
        if one.repository is None:
            why = ", because its checksum or its licence is not known: bring your own" if one.published else ": it goes"
            raise BoresightError(f"{name}: cannot be fetched{why} into {one.folder}; {one.source}")
        return Wanted((one,), ())
    if name in PAGES:
        # Imported here: a paper's figures take 2 s.
        from boresight.campaign.papers.page import paper_called, paper_campaigns

        return wanted_by(paper_campaigns(paper_called(name)))
    if name in campaign_names() or Path(name).suffix in SUFFIXES:
        return wanted_by([name])
    choices = [ALL, *PAGES, *known, *campaign_names()]
    near = difflib.get_close_matches(name, choices, n=1)
    hint = f"did you mean {near[0]}?" if near else "see: boresight fetch --list"
    raise BoresightError(f"{name}: no such data set, campaign or paper; {hint}")


def wanted_by(campaigns: Iterable[str]) -> Wanted:
    """Return the data sets that campaigns read, named or given as files."""
    found: list[DataSet] = []
    unknown: list[str] = []
    for campaign in campaigns:
        for need in needs(load_campaign(campaign, CATALOG)):
            found += need.data_sets
            unknown += [] if need.data_sets or need.found or not need.kind else [need.name]
    return _sorted_out(found, unknown)


def _sorted_out(found: Iterable[DataSet], unknown: Iterable[str] = ()) -> Wanted:
    sets = list({one.name: one for one in found}.values())
    return Wanted(
        tuple(one for one in sets if one.repository is not None),
        tuple(one for one in sets if one.repository is None),
        tuple(dict.fromkeys(unknown)),
    )


def fetch_command(arguments: argparse.Namespace) -> int:
    """Bring data sets, or list them all."""
    if arguments.list:
        return _list()
    if arguments.name is None:
        raise BoresightError("name a data set, a campaign or a paper, or all; see: boresight fetch --list")
    bring(wanted(arguments.name), arguments.source)
    return 0


def bring_missing(campaigns: Sequence[str], arguments: argparse.Namespace) -> None:
    """Bring the missing data of campaigns if ``--fetch`` asks for it; ``--from`` without it is refused."""
    if arguments.source and not arguments.fetch:
        raise BoresightError("--from says where data are fetched from: give --fetch too")
    if arguments.fetch:
        sets = wanted_by(campaigns)
        if bytes_to_come(sets.fetched, data_folder()):
            bring(sets, arguments.source)


def bring(sets: Wanted, source: str = "") -> None:
    """Print size, licence and credit of data sets, bring them, and print what a user must bring."""
    root, out = data_folder(), console()
    total = bytes_to_come(sets.fetched, root)
    out.print(f"{total / 1e6:.1f} MB to fetch into {root}" + (f" from {source}" if source else ""), soft_wrap=True)
    for one in sets.fetched:
        out.print(
            f"{one.name}: {one.title}; {state(one, root)}, {bytes_to_come([one], root) / 1e6:.1f} MB to come\n"
            f"  licence: {one.licence}\n  credit: {one.credit}",
            soft_wrap=True,
        )
    check_space(total, root)
    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TransferSpeedColumn())
    with Progress(*columns, console=out, transient=True) as bars:
        bar = bars.add_task("", total=None)
        for one in sets.fetched:
            how = Counter(
                file.how
                for file in fetch(
                    one, root, lambda name, done, size: bars.update(bar, description=name, completed=done, total=size),
                    source,
                )
            )  # fmt: skip
            counts = ", ".join(f"{number} {what}" for what, number in how.items())
            note = f"; {one.note}" if one.note else ""
            out.print(f"{one.name}: {counts}; every checksum is right{note}", soft_wrap=True)
    for one in sets.own:
        out.print(
            f"{one.name}: {'bring your own: ' if one.published else ''}{one.title}, into {one.folder}; {one.source}",
            soft_wrap=True,
        )
    for name in sets.unknown:
        out.print(f"{name}: is in no data set: bring your own", soft_wrap=True)


def _list() -> int:
    root, out = data_folder(), console()
    out.print(f"data folder: {root}", soft_wrap=True)
    known = datasets().values()
    fetched = [one for one in known if one.files]
    sizes = [f"{sum(file.bytes for file in one.files) / 1e6:.1f} MB" for one in fetched]
    rows = [(one.name, state(one, root), size, one.title) for one, size in zip(fetched, sizes, strict=True)]
    widths = [max(len(row[k]) for row in rows) for k in range(3)]
    for name, there, size, title in rows:
        out.print(f"{name:<{widths[0]}}  {there:<{widths[1]}}  {size:>{widths[2]}}  {title}", soft_wrap=True)
    own = [(one, one.published) for one in known if one.published is not None]
    made = [(one, one.source) for one in known if one.made_by is not None]
    for head, sets in (("bring your own (no checksum or no licence is known):", own), ("made of others:", made)):
        out.print(head)
        for one, source in sets:
            out.print(f"{one.name:<{widths[0]}}  {one.title}, into {one.folder}; {source}", soft_wrap=True)
    return 0

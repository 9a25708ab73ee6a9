"""``fetch``: data sets of missions, by name, by campaign and by paper."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence

from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TransferSpeedColumn

from boresight.campaign.cli.terminal import console
from boresight.campaign.data.fetch import bytes_to_come, check_space, fetch, state
from boresight.campaign.papers.wanted import Wanted, wanted, wanted_by
from boresight.scenarios.data import data_folder
from boresight.scenarios.data.datasets import datasets
from boresight.scenarios.errors import BoresightError


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
            f"{one.name}: bring your own: {one.title}, into {one.folder}; published at {one.published}", soft_wrap=True
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
    out.print("bring your own (no checksum or no licence is known):")
    for one in known:
        if one.published is not None:
            out.print(f"{one.name:<{widths[0]}}  {one.title}, into {one.folder}; {one.published}", soft_wrap=True)
    return 0

"""``fetch``: data sets of missions."""

from __future__ import annotations

import argparse

from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TransferSpeedColumn
from rich.table import Table

from campaign.cli.terminal import console
from campaign.data.fetch import fetch, state
from scenarios.data import data_folder
from scenarios.data.datasets import dataset_names, load_dataset
from scenarios.errors import BoresightError


def fetch_command(arguments: argparse.Namespace) -> int:
    """Download a data set, or list them all."""
    if arguments.list:
        return _list()
    if arguments.name is None:
        raise BoresightError("name a data set, or see: boresight fetch --list")
    dataset, root, out = load_dataset(arguments.name), data_folder(), console()
    out.print(f"{dataset.name}: {dataset.title}")
    out.print(f"into {root / dataset.folder}")
    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TransferSpeedColumn())
    with Progress(*columns, console=out, transient=True) as bars:
        bar = bars.add_task("", total=None)
        for file in fetch(dataset, root, lambda name, done, total: bars.update(
            bar, description=name, completed=done, total=total
        )):  # fmt: skip
            out.print(f"  {file.path.name}: {file.how}, {_checked(file.trust)}, sha256 {file.sha256}", soft_wrap=True)
    out.print(f"credit: {dataset.credit}")
    out.print(f"licence: {dataset.licence}")
    if dataset.note:
        out.print(dataset.note)
    return 0


def _checked(trust: str) -> str:
    return {
        "registration": "the checksum is the registered one",
        "first fetch": "the checksum is that of the first fetch",
        "nothing": "no checksum is known: this one is kept and holds from now on",
    }[trust]


def _list() -> int:
    root, out = data_folder(), console()
    table = Table("data set", "where it goes", "state", "what it is", box=None, pad_edge=False)
    for name in dataset_names():
        dataset = load_dataset(name)
        table.add_row(name, dataset.folder, state(dataset, root), dataset.title)
    out.print(f"data folder: {root}", soft_wrap=True)
    out.print(table)
    return 0

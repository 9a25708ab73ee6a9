"""``board``: an index page of all runs in a folder."""

from __future__ import annotations

import argparse

from boresight.campaign.cli.terminal import console, writing
from boresight.campaign.papers.gather import run_folders
from boresight.campaign.runs.newest import newest_first
from boresight.reports.pages.board import write_board
from boresight.scenarios.errors import BoresightError, display

_IN_PART = 3


def board_command(arguments: argparse.Namespace) -> int:
    """Write the index page of the runs in a folder."""
    folders = newest_first(run_folders(arguments.folder))
    if not folders:
        raise BoresightError(f"{arguments.folder}: no run in that folder: give one that holds run folders")
    with writing(arguments.folder):
        page, refused = write_board(folders, arguments.folder, arguments.command)
    out = console()
    for line in refused:
        out.print(f"not read: {line}")
    out.print(f"board of {len(folders) - len(refused)} of {len(folders)} runs: {display(page)}")
    return _IN_PART if refused else 0

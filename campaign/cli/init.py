"""``init``: write a commented scenario and campaign to start from."""

from __future__ import annotations

import argparse
import shlex
from importlib import resources
from pathlib import Path

from boresight.campaign.cli.terminal import console
from boresight.scenarios.atomic import explain_write_error
from boresight.scenarios.errors import BoresightError, display

FILES = ("scenario.yaml", "campaign.yaml")


def init_command(arguments: argparse.Namespace) -> int:
    """Write both files into a folder, which is made if it is missing; a file that is there is never changed."""
    folder: Path = arguments.folder
    texts = {
        folder / name: resources.files(__package__ or "").joinpath(f"init_{name}").read_text(encoding="utf-8")
        for name in FILES
    }
    present = [display(file) for file in texts if file.exists() or file.is_symlink()]
    if present:
        raise BoresightError(f"{present[0]}: is there already, and init changes no file: choose another folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for file, text in texts.items():
            # Fails, instead of writing over it, if another program made the file in the meantime.
            with file.open("x", encoding="utf-8") as stream:
                stream.write(text)
    except OSError as error:
        reason = explain_write_error(error.filename or folder, error)
        raise BoresightError(reason.removesuffix(" with --out")) from error
    scenario, campaign = map(display, texts)
    console().print(f"{scenario}: a body, a camera, the errors\n{campaign}: estimators on trials of it")
    console().print(f"next: {shlex.join(['boresight', 'run', campaign])}")
    return 0

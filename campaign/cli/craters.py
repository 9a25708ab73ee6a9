"""``craters``: detect craters in a real image and draw them beside the places where named ones should be."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from campaign.cli.terminal import console
from estimators.craters.registry import crater_detector_class, crater_detector_names
from scenarios.atomic import explain_write_error
from scenarios.errors import BoresightError

if TYPE_CHECKING:
    from argparse import _SubParsersAction


def add_commands(commands: _SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command to the parser."""
    craters = commands.add_parser("craters", help="detect craters in a real image of Eros by NEAR's MSI")
    craters.add_argument("image", type=Path, nargs="?", help="label or FITS file (default: the one in BORESIGHT_DATA)")
    craters.add_argument("--detector", default="crater-classic", help=f"one of {', '.join(crater_detector_names())}")
    craters.add_argument("--out", type=Path, default=Path("figures/craters"), help="folder of figures and tables")
    craters.set_defaults(handler=_craters)


def _craters(arguments: argparse.Namespace) -> int:
    # Imported here: Matplotlib and SPICE take a third of the start-up, and most commands need neither.
    from campaign.data.named_craters import detect_real, write_real

    detector = crater_detector_class(arguments.detector).from_options({})
    found = detect_real(detector, arguments.image)
    try:
        written = write_real(found, arguments.out)
    except OSError as error:
        raise BoresightError(explain_write_error(error.filename or arguments.out, error)) from error
    out = console()
    out.print(f"{found.image.name}: {len(found.detections.ellipses)} craters by {detector.name}")
    for line in found.summary():
        out.print(line)
    out.print(f"figures and tables: {', '.join(str(path) for path in written)}")
    return 0

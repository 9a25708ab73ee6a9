"""``craters``: detect craters in a real image and draw them with the expected places of named ones."""

from __future__ import annotations

import argparse

from boresight.campaign.cli.terminal import console
from boresight.campaign.data.named_craters import detect_real, write_real
from boresight.estimators.craters.registry import crater_detector_class
from boresight.scenarios.atomic import explain_write_error
from boresight.scenarios.errors import BoresightError


def craters_command(arguments: argparse.Namespace) -> int:
    """Detect craters in a real image, and write figures and tables."""
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

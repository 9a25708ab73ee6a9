"""``craters``: detect craters in a real image and draw them with the expected places of named ones."""

from __future__ import annotations

import argparse

from boresight.campaign.cli.terminal import console, writing
from boresight.campaign.data.named_craters import detect_real, write_real
from boresight.estimators.craters.registry import crater_detector_class


def craters_command(arguments: argparse.Namespace) -> int:
    """Detect craters in a real image, and write figures and tables."""
    detector = crater_detector_class(arguments.detector).from_options({})
    found = detect_real(detector, arguments.image)
    with writing(arguments.out):
        written = write_real(found, arguments.out)
    out = console()
    out.print(f"{found.image.name}: {len(found.detections.ellipses)} craters by {detector.name}")
    for line in found.summary():
        out.print(line)
    out.print(f"figures and tables: {', '.join(str(path) for path in written)}")
    return 0

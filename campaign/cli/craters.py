"""``craters``: detect craters in a real image, and compare them with labels, or with named craters of Eros."""

from __future__ import annotations

import argparse

from boresight.campaign.cli.terminal import console, writing
from boresight.campaign.data.crater_labels import PICTURES
from boresight.campaign.data.crater_pictures import OPTIONS, detect_in_picture, write_picture
from boresight.campaign.data.named_craters import detect_real, write_real
from boresight.estimators.craters.registry import crater_detector_class
from boresight.scenarios.errors import BoresightError


def craters_command(arguments: argparse.Namespace) -> int:
    """Detect craters in a real image, and write figures and tables."""
    pictured = arguments.image is not None and arguments.image.suffix.lower() in PICTURES
    options = OPTIONS.get(arguments.detector, {}) if pictured else {}
    detector = crater_detector_class(arguments.detector).from_options(options)
    out = console()
    if arguments.columns and arguments.truth is None:
        raise BoresightError("--columns: names the columns of a table, which --truth gives")
    if pictured:
        picture = detect_in_picture(detector, arguments.image, arguments.sun, arguments.truth, arguments.columns)
        with writing(arguments.out):
            written = write_picture(picture, arguments.out)
        name, count, lines = picture.name, len(picture.detections.ellipses), picture.summary()
    else:
        for key in ("sun", "truth"):
            if getattr(arguments, key) is not None:
                raise BoresightError(f"--{key}: is for pictures ({', '.join(PICTURES)}), not for images of MSI")
        found = detect_real(detector, arguments.image)
        with writing(arguments.out):
            written = write_real(found, arguments.out)
        name, count, lines = found.image.name, len(found.detections.ellipses), found.summary()
    out.print(f"{name}: {count} craters by {detector.name}")
    for line in lines:
        out.print(line)
    out.print(f"figures and tables: {', '.join(str(path) for path in written)}")
    return 0

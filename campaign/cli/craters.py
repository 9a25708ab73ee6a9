"""``craters`` and ``craters-real``: detect craters in real images, and compare them with labels or named craters."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from typing import cast

import numpy as np
import pandas as pd

from boresight.campaign.cli.terminal import console, writing
from boresight.campaign.data.crater_pictures import (
    LARGE_PX,
    OPTIONS,
    PICTURES,
    RADIUS_MIN_PX,
    detect_in_picture,
    write_picture,
)
from boresight.campaign.data.known_ground import detect_on_known_ground
from boresight.campaign.data.label_score import LabelMatches, label_quality, score_table
from boresight.campaign.data.named_craters import detect_real, write_real
from boresight.estimators.craters.contract import CraterDetector
from boresight.estimators.options import model_of
from boresight.estimators.registry import crater_detector_class
from boresight.scenarios.atomic import write_text
from boresight.scenarios.errors import BoresightError, printable
from boresight.scenarios.load.merge import apply, parse_override
from boresight.scenarios.load.yaml_text import entry_of


def craters_command(arguments: argparse.Namespace) -> int:
    """Detect craters in a real image, and write figures and tables."""
    pictured = arguments.image is not None and arguments.image.suffix.lower() in PICTURES
    detector = _detector(arguments.detector, OPTIONS.get(arguments.detector, {}) if pictured else {}, arguments.options)
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


def _detector(name: str, options: Mapping[str, object], given: Sequence[str]) -> CraterDetector:
    """Build a detector of options, and of those that the command line gives as KEY=VALUE."""
    found = crater_detector_class(name)
    models = tuple(filter(None, [model_of(found)]))
    layers = [parse_override(text, f"--option {printable(text)}") for text in given]
    return found.from_options(cast("dict[str, object]", apply(entry_of(options, "options"), layers, models).plain()))


def craters_real_command(arguments: argparse.Namespace) -> int:
    """Detect craters in each image; write tables of recall and false alarms for the Moon, Mars and rendered ground."""
    detector = _detector(arguments.detector, OPTIONS.get(arguments.detector, {}), arguments.options)
    out = console()
    tables = []
    for ground, pictures in detect_on_known_ground(detector, arguments.set):
        parts, kept = [], []
        for found in pictures:
            parts.append(found.matches())
            kept.append(found.above_threshold(parts[-1]))
            out.print(f"{found.name}: {'; '.join(found.summary())}")
        matches = LabelMatches.joined(parts)
        label = matches.label[np.concatenate(kept)]
        out.print(
            f"{ground}: {int((label >= 0).sum())} of {len(matches.radius_px)} labels from {RADIUS_MIN_PX:g} px radius"
            f" found, {int((label == -1).sum())} of {matches.large[np.concatenate(kept)].sum()} detections of that size"
            f" false; {label_quality(matches)}"
        )
        large = LabelMatches.joined([found.matches(LARGE_PX) for found in pictures])
        for least_px, scored in ((RADIUS_MIN_PX, matches), (LARGE_PX, large)):
            told = {"least_px": least_px, "detector": detector.name, "set": arguments.set}
            tables.append(score_table(scored, least_px).assign(ground=ground, images=len(parts), **told))
    scores = pd.concat(tables).round(4)
    with writing(arguments.out):
        arguments.out.mkdir(parents=True, exist_ok=True)
        write_text(arguments.out / "scores.csv", scores.to_csv(index=False, lineterminator="\n"))
    out.print(scores.to_string(index=False))
    return 0

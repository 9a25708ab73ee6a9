"""``tracks``: track features through the images of a scenario, and write the tables that ``sequence.tracks`` reads."""

from __future__ import annotations

import argparse

from boresight.campaign.cli.terminal import console, writing
from boresight.campaign.data.image_tracks import track_images, tracks_folder
from boresight.estimators.slam.vision.image_tracks import TrackingOptions
from boresight.scenarios.errors import display
from boresight.scenarios.load import load_scenario


def tracks_command(arguments: argparse.Namespace) -> int:
    """Write the tables of tracks and of poses, and describe the tracks."""
    scenario, out = load_scenario(arguments.name, arguments.overrides), console()
    options = TrackingOptions(
        arguments.detector, arguments.features, arguments.angle, arguments.following, epipolar_max_px=arguments.epipolar
    )
    found = track_images(scenario, arguments.attitudes, options)
    folder = arguments.out or tracks_folder(scenario.spec.name)
    with writing(folder):
        written = found.write(folder)
    for line in found.summary():
        out.print(line)
    out.print(f"tables: {', '.join(display(path) for path in written)}")
    return 0

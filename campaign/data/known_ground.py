"""Craters that a detector finds where others are known: labelled pictures of the Moon and Mars, and rendered images."""

from __future__ import annotations

from collections.abc import Iterator

from boresight.campaign.data.crater_pictures import PictureDetection, detect_in_image, detect_in_picture
from boresight.campaign.imaging.world import open_world
from boresight.campaign.runs.resolve import resolve
from boresight.estimators.craters.contract import CraterDetector
from boresight.renderers.mitsuba3 import choose_variant
from boresight.scenarios.data import find_data_file
from boresight.scenarios.errors import BoresightError

MOON = {
    "choices": ("M115143943", "M1183658592", "M1231933714", "M1275410097", "M161142858", "M161149639"),
    "report": ("M1155395732", "M1229577647", "M1266003170", "M134022629", "M180000082", "M180007222"),
}
"""Images of LROC NAC: which of them choices may look at, and those of the report. Named before the training.

They alternate in the order of their names, and images of successive orbits, which may show the same ground, stay
together. No network is trained on any of them, nor on their labels.
"""

MARS, MARS_COLUMNS = ("hrsc_mars_craters/tile1_24.pgm", "hrsc_mars_craters/1_24_gt.csv"), "x,y,diameter"
_RENDERED, _IMAGES = "cheng2003-detection", 12


def moon_pictures(chosen: str) -> list[tuple[str, str, str]]:
    """Name image, table of labels and its columns of each picture of the Moon, those of ``MOON[chosen]``."""
    stems = [f"lroc_nac_craters/{name}_mosaic_train_small" for name in MOON[chosen]]
    return [(f"{stem}.png", f"{stem}.txt", "") for stem in stems]


def detect_labelled(detector: CraterDetector, image: str, table: str, columns: str = "") -> PictureDetection:
    """Detect craters in a labelled picture of the data folder; raise BoresightError if it is not there."""
    paths = [find_data_file(f"images/{name}", (), ".", "image") for name in (image, table)]
    return detect_in_picture(detector, paths[0], None, paths[1], columns)


def detect_on_known_ground(detector: CraterDetector, chosen: str) -> Iterator[tuple[str, list[PictureDetection]]]:
    """Yield the detections on each ground: ``moon``, ``mars`` and ``rendered``.

    The rendered images are the first of `cheng2003-detection`. The detector is told of them what it is of pictures, and
    recall is of the craters that can be detected by the definition of that campaign.
    """
    yield "moon", [detect_labelled(detector, *picture) for picture in moon_pictures(chosen)]
    yield "mars", [detect_labelled(detector, *MARS, MARS_COLUMNS)]
    yield "rendered", list(_rendered(detector))


def _rendered(detector: CraterDetector) -> Iterator[PictureDetection]:
    campaign = resolve(_RENDERED, variant=choose_variant().name)
    world = open_world(campaign.scenarios[0], campaign.variant)
    imager = world.source.imager
    if imager is None:
        raise BoresightError(f"{_RENDERED}: its images are not rendered")
    for trial in range(_IMAGES):
        drawn = world.source.trial_image(campaign.seed, trial)
        truth = imager.craters(drawn.view)
        found = detect_in_image(detector, drawn.image)
        yield PictureDetection(f"{_RENDERED} {trial}", drawn.image, *found, truth.ellipses, truth.detectable)

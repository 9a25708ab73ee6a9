"""Columns of crater navigation: images planned, craters found and numbered, an orbit determined."""

from __future__ import annotations

from boresight.reports.schema.column import KindSchema, count, number, text
from boresight.reports.schema.common import KEY
from boresight.reports.schema.kinds.orbit_determination import METRICS, ROW

SCHEMA = KindSchema(
    row=ROW,
    tables={
        "navigation": (
            *KEY,
            count("rounds", "how often matching and orbit determination were done"),
            count("epochs", "times at which an image could have been planned"),
            count("n_images", "images that were planned and taken"),
            count("n_blind", "images in which the detector could see nothing"),
            count("n_detections", "craters that were detected in all images"),
            count("n_false", "those of them that are no crater in truth"),
            count("n_pairs", "pairs of images that were matched in the last round"),
            count("n_correct", "matches that join two detections of one crater"),
            count("n_wrong", "the other matches"),
            count("n_common", "craters detected in both images of a matched pair, over all pairs"),
            count("n_conflicts", "matches refused because an image would have had a number twice"),
            count("n_numbered", "detections with a number"),
            count("n_landmarks", "numbers"),
        ),
        "navigated_images": (
            *KEY,
            count("image", "number of the image"),
            number("time_days", "time after the epoch"),
            text("kind", "why it was planned: nadir, limb or terminator"),
            number("phase_deg", "true phase angle at the body's origin"),
            count("n_detections", "craters that were detected"),
            count("n_false", "those of them that are no crater in truth"),
            count("n_numbered", "detections with a number"),
            text("reason", "why nothing could be seen; empty where the image was searched"),
        ),
        "navigated_landmarks": (
            *KEY,
            count("landmark", "number in the data base"),
            count("hits", "images that show it"),
            count("crater", "true crater that most of its sightings are of; -1 for none"),
            count("n_other", "sightings of another one"),
            count("n_used", "sightings that the orbit rests on; empty without an orbit"),
            number("first_days", "time after the epoch of its first image"),
            number("last_days", "of its last image"),
        ),
    },
    metrics=METRICS,
    nees="orbits",
)

"""Columns of crater matching: pairs of images."""

from __future__ import annotations

from boresight.reports.schema.column import KindSchema, count, measured, number
from boresight.reports.schema.common import KEY, VIEW, share
from boresight.reports.schema.kinds.crater_detection import MISSED

WRONG = "wrong_share"
MATCHING = (MISSED, WRONG)
"""Of a pair of images: craters in both that were not matched, and matches that are wrong, %."""

_SCHEMA = KindSchema(
    row=VIEW,
    tables={
        "crater_matches": (
            *KEY,
            number("view_deg", "angle between the directions to the two cameras"),
            number("sun_deg", "angle between the two directions of the Sun"),
            count("n_first", "detections in the first image"),
            count("n_second", "detections in the second image"),
            count("n_common", "craters of the truth that are detected in both"),
            count("n_correct", "matches that join two detections of one of them"),
            count("n_wrong", "the other matches but those of n_unlisted"),
            count("n_missed", "craters in both without a correct match"),
            count("n_unlisted", "matches of detections that may be craters too small for the list of the truth"),
            measured(
                "epipolar_offset_px", "largest distance of one of them from its epipolar line",
                "largest distance of a crater from its epipolar line",
            ),
        ),
    },
    measures=(
        share(WRONG, "wrong matches", error=True),
        share("matching_recall_share"),
        share("matching_wrong_share"),
        share("mixed_share"),
    ),
    metrics=MATCHING,
)  # fmt: skip

SCHEMAS = {"crater-matching": _SCHEMA}

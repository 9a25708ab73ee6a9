"""Columns of image surveys: arcs of planned images, and the craters in them."""

from __future__ import annotations

from boresight.reports.schema.column import KindSchema, count, number, text
from boresight.reports.schema.common import KEY, plain, share

SCHEMA = KindSchema(
    tables={
        "surveyed_images": (
            *KEY,
            count("image", "number of the image in its plan"),
            number("time_days", "time after the epoch"),
            text("kind", "why it was planned: nadir, limb or terminator"),
            count("n_detections", "craters that were detected, false ones included"),
            count("n_overlapping", "other images of the same area: a tenth of a lit region is in both"),
            count("n_similar", "those of them with the Sun within 10 deg, body axes"),
        ),
        "surveyed_craters": (
            *KEY,
            count("crater", "number of the crater"),
            count("hits", "images in which it was detected"),
        ),
    },
    measures=(
        plain("detections", "craters detected in all images"),
        plain("detections_an_image", "craters detected in an image"),
        share("few_craters_share", "images with 7 craters or fewer"),
        share("similar_image_share", "images with a photometrically similar one"),
        plain("similar_images", "photometrically similar images of an image, median"),
        plain("overlapping_images", "images of the same area, median"),
        plain("craters", "craters detected in any image"),
        plain("hits_a_crater", "images in which a crater is detected"),
        share("seen_once_share", "craters detected in one image alone"),
    ),
    metrics=("detections_an_image", "few_craters_share", "similar_image_share", "hits_a_crater"),
)

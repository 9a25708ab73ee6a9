"""Columns and measures of crater detection and of crater matching."""

from __future__ import annotations

from boresight.reports.schema.column import (
    DATABASE,
    IMAGE_KEY,
    KEY,
    VIEW,
    Columns,
    KindSchema,
    Measure,
    count,
    ellipse,
    flag,
    measured,
    number,
    plain,
    share,
)

MISSED, FALSE_ALARMS, CENTRE_ERROR = "missed_share", "false_alarm_share", "centre_error_px"
COMMON_CENTRE_ERROR = "common_centre_error_px"
DETECTION = (MISSED, FALSE_ALARMS, CENTRE_ERROR, COMMON_CENTRE_ERROR)
"""Of an image: detectable craters that were not found, detections that are no crater, %, and the median error, px, of
the centres of the detectable craters that this method found, and of those that every method of the run found: a method
that leaves the difficult ones out must not look more accurate for it."""

WRONG = "wrong_share"
MATCHING = (MISSED, WRONG)
"""Of a pair of images: craters in both that were not matched, and matches that are wrong, %."""


def _flags(of: str) -> Columns:
    """Columns of the two flags; a detection of a crater that is not detectable is neither found nor false in rates."""
    return (
        flag("detectable", f"{of} 12 px or more, seen, in the frame, lit, and not too worn or cut"),
        flag("clean", f"{of} of these, with a rim within 1 % of an ellipse and an axis ratio over 0.5"),
    )


CRATER_DETECTION = KindSchema(
    row=(*DATABASE, *VIEW),
    tables={
        "crater_images": (
            *IMAGE_KEY,
            number("phase_deg", "true phase angle at the body's origin"),
            number("lit_share", "share of the image above a twentieth of its range"),
            count("n_craters", "craters with a point of the crest in sight, of those that are listed"),
            count("n_detectable", "detectable ones"),
            count("n_clean", "clean ones"),
        ),
        "craters": (
            *IMAGE_KEY,
            count("crater", "number of the crater in its population"),
            *ellipse("the ellipse through its crest"),
            number("deviation", "RMS distance of the crest from the ellipse over the ellipse's radius"),
            number("diameter_m", "of the crest"),
            number("depth_ratio", "depth from the crest to the floor over the diameter"),
            number("degradation", "0 fresh to 1"),
            number("visible", "share of the crest that nothing hides from the camera"),
            number("in_frame", "share of the crest within the image"),
            number("lit", "share of the crest in sunlight"),
            number("cut", "share of the crest that younger craters have taken"),
            number("emission_deg", "angle of the camera from the normal of the crest's plane"),
            number("incidence_deg", "angle of the Sun from it"),
            *_flags("whether it is"),
        ),
        "detections": (
            *KEY,
            count("rank", "place by confidence, from 0"),
            number("confidence", "as the detector gives it"),
            flag("kept", "whether it reaches the detector's threshold"),
            *ellipse("the detection"),
            count("crater", "number of the listed crater that it is matched with; -1 for a false alarm"),
            flag("duplicate", "a false alarm on a crater that a more confident detection is matched with"),
            *_flags("whether that crater is"),
            measured(
                CENTRE_ERROR,
                "distance of its centre from that of the true ellipse",
                "centre error of detectable craters",
                error=True,
                detail=False,
            ),
            number("centre_error_u_px", "column of the same"),
            number("centre_error_v_px", "row of the same"),
            number("major_error_px", "longer semi-axis less the true one"),
            number("minor_error_px", "shorter semi-axis less the true one"),
        ),
    },
    measures=(
        share("detection_share", "detectable craters found"),
        share("clean_detection_share", "clean craters found", detail=False),
        share(MISSED, "craters missed", error=True),
        share(FALSE_ALARMS, "false alarms among detections of detectable craters and false ones", error=True),
        share("listed_false_alarm_share", "false alarms among all detections, any listed crater counting as right"),
        share("beyond_detectable_share", "detections that are of no detectable crater", detail=False),
        share("duplicate_share", "duplicates among the detections", detail=False),
        share("best_false_alarm_share", "false alarms among the 12 most confident of an image"),
        share("best_within_1px_share", "centres within 1 px among those of these 12 that are matched", detail=False),
        plain("best_centre_error_px", "centre error of these 12"),
        plain("best_axes_error_px", "error of a semi-axis of these 12"),
        plain(COMMON_CENTRE_ERROR, "centre error of the craters that all methods found", error=True),
        Measure(name="axes_error_px", label="error of a semi-axis of detectable craters"),
        Measure(name="clean_centre_error_px", label="centre error of clean craters"),
        Measure(name="clean_axes_error_px", label="error of a semi-axis of clean craters"),
        plain("detections_per_image", "detections in an image"),
        plain("craters_per_image"),
        plain("median_craters_per_image"),
    ),
    metrics=DETECTION,
    databases_note=(
        "The world of craters was drawn {n} times; trials have them in turn. Intervals take the world for what is"
        " independent (Student's t over them), so that they tell of other worlds too."
    ),
)
"""Images with their true craters, and what each detector finds."""

CRATER_MATCHING = KindSchema(
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

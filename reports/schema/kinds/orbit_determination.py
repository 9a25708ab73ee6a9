"""Columns of orbit determination, of crater navigation, and of surveys of planned images."""

from __future__ import annotations

from dataclasses import replace

from boresight.reports.schema.column import (
    DATABASE,
    KEY,
    POSE_ERROR,
    VIEW,
    Column,
    Columns,
    KindSchema,
    count,
    flag,
    measured,
    number,
    plain,
    share,
    text,
)


def _of_arc(name: str, meaning: str, label: str = "") -> Column:
    return measured(name, meaning, label, error=True, detail=bool(label))


ROW: Columns = (
    replace(POSE_ERROR[0], meaning="position error at the epoch, inertial axes"),
    number("nees", "error of the state weighted by its covariance (6 degrees of freedom)"),
    number("position_sigma_m", "RMS position error at the epoch that the covariance foretells"),
    *VIEW[:1],
)
_ARC = ("arc_rms_m", "arc_median_m", "arc_p90_m", "predicted_error_m", "residual_rms_px")
ORBIT_COLUMNS = (*_ARC, "wrong_left_share", "right_edited_share")
"""Errors of an orbit in the table ``orbits``; the position error is that at the epoch."""

METRICS = ("position_error_m", *_ARC)

_ORBIT = KindSchema(
    row=(*DATABASE, *ROW),
    tables={
        "orbits": (
            *KEY,
            measured("epoch_error_m", "position error at the epoch, inertial axes", "position error at the epoch"),
            number("epoch_velocity_error_m_s", "velocity error there"),
            number("epoch_nees", "error of the state weighted by its covariance, over 6: 1 is expected"),
            _of_arc(
                "arc_median_m", "median position error over the arc, every 6 h", "median position error over the arc"
            ),
            _of_arc("arc_rms_m", "root mean square of the same", "RMS position error over the arc"),
            _of_arc("arc_p90_m", "90 % of the same"),
            number("arc_nees", "mean over the arc of the position error weighted by its covariance, over 3"),
            _of_arc("predicted_error_m", "position error at the end of the predicted days", "predicted position error"),
            number("predicted_sigma_m", "RMS position error that the covariance foretells there"),
            _of_arc("residual_rms_px", "RMS of a coordinate of the residuals that were not edited"),
            _of_arc("wrong_left_share", "share of wrong sightings among those that were not edited"),
            _of_arc("right_edited_share", "share of the right sightings that were edited"),
            number("gm_error", "relative error of GM"),
            number("solar_pressure_error", "relative error of the size of solar pressure"),
        ),
        "orbit_errors": (
            *KEY,
            number("time_days", "time after the epoch"),
            flag("predicted", "whether it is later than the last image"),
            number("position_error_m", "length of r_est - r_true, inertial axes"),
            number("radial_m", "component of the same away from the body"),
            number("along_m", "component along the true motion, at a right angle to the radial one"),
            number("cross_m", "component along radial x along"),
            number("position_sigma_m", "RMS position error that the covariance foretells"),
        ),
        "residuals": (
            *KEY,
            number("time_days", "time of the image after the epoch; of the first trial alone"),
            number("u_px", "column seen less predicted"),
            number("v_px", "row seen less predicted"),
            flag("used", "whether the sighting was not edited"),
        ),
    },
    metrics=METRICS,
    nees="orbits",
    databases_note=(
        "Positions and prominence of the craters were drawn {n} times; trials have them in turn. Intervals take that"
        " draw for what is independent (Student's t over the draws), so that they include the variation between them."
        " The body and its a priori shape are the same in all trials of a scenario."
    ),
)

_NAVIGATION = KindSchema(
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

_SURVEY = KindSchema(
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

SCHEMAS = {"orbit-determination": _ORBIT, "crater-navigation": _NAVIGATION, "image-survey": _SURVEY}

"""Columns and measures of each kind of trial."""

from __future__ import annotations

from dataclasses import replace

from boresight.reports.schema.column import (
    DATABASE,
    KEY,
    POSE_ERROR,
    POSE_METRICS,
    PRIOR_ERROR,
    SIGHT,
    VIEW,
    Column,
    Columns,
    KindSchema,
    Measure,
    count,
    flag,
    measured,
    names,
    number,
    plain,
    share,
    text,
)
from boresight.reports.schema.craters import CRATER_DETECTION, CRATER_MATCHING


def _pose(prefix: str, what: str) -> Columns:
    return (
        *(number(f"{prefix}q{part}", f"{part} of the quaternion of {what}") for part in "wxyz"),
        *(number(f"{prefix}t{axis}_m", f"{axis} of its translation: the body in the camera") for axis in "xyz"),
    )


_IMAGE = KindSchema(
    row=(
        *PRIOR_ERROR,
        *POSE_ERROR,
        number(
            "nees",
            "error of the pose weighted by the estimator's covariance, with that of the reference pose added if it is"
            " known (6 degrees of freedom)",
        ),
        number("sight_nees", "the same of the error across the direction to the body's origin (2 degrees of freedom)"),
        number("position_sigma_m", "RMS position error that the estimator's covariance foretells"),
        number("attitude_sigma_deg", "RMS attitude error that the estimator's covariance foretells"),
        number("position_bound_m", "RMS position error at the Cramer-Rao bound of its observations"),
        number("attitude_bound_deg", "RMS attitude error at that bound"),
        *DATABASE,
        text("image", "file name of a real image, or of the one whose view is rendered; else empty"),
        *VIEW,
        number("latitude_deg", "true latitude of the camera in the body frame, about its z axis"),
        number("time_s", "epoch of a single image; 0 where the scenario has none"),
        *_pose("", "the estimated T_cam_body of a single image"),
        *_pose("true_", "the true T_cam_body, of a real image the one that is scored against"),
    ),
    tables={
        "stages": (*KEY, text("stage", "prior, or a stage of the estimator"), *POSE_ERROR),
        "references": (*KEY, text("reference", "name of the pose that is scored against"), *POSE_ERROR),
        "landmarks": (
            *KEY,
            count("landmark", "index in the landmark data base"),
            number("u_px", "column of the matched corner, continuous pixels"),
            number("v_px", "row of the matched corner"),
            number("error_m", "distance of the corner's true surface point from the landmark's mean"),
            measured(
                "chi_square", "the same, weighted by the landmark's covariance (3 degrees of freedom)",
                "chi-square of a landmark",
            ),
        ),
    },
    metrics=(*POSE_METRICS, SIGHT),
)  # fmt: skip


def _landmark_errors(over: str) -> Columns:
    what = f"{over} the estimator's landmarks whose tracks are seen in the frame, of |l_est - l_true| in body axes"
    return (
        measured("landmark_rmse_m", what, "landmark RMSE", error=True),
        measured(
            "settled_landmark_rmse_m", "the same without tracks that the frame is the first of",
            "landmark RMSE without new ones", error=True,
        ),
    )  # fmt: skip


def _inertial(prefix: str, what: str) -> Columns:
    return tuple(number(f"{prefix}{axis}_m", f"{axis} of the {what}") for axis in "xyz")


_ENDS: Columns = (
    measured(
        "error_after_1_m", "position error at the frame that ends revolution 1", "position error after 1 revolution",
        error=True,
    ),
    measured("error_after_2_m", "the same of revolution 2", "position error after 2 revolutions", error=True),
    *_landmark_errors("of a sequence that ended: root mean square over all frames and"),
    measured(
        "final_landmark_rmse_m", "of the same: over landmarks seen twice or more, each when it was seen last",
        "landmark RMSE as seen last", error=True,
    ),
    measured(
        "mean_position_nees", "of the same: mean over the frames of nees in epochs",
        "mean NEES of the position (3 expected)", error=True,
    ),
)  # fmt: skip
SEQUENCE_COLUMNS = names(_ENDS)
"""What a whole sequence comes to."""

_VISION = (
    Measure(name="features_per_image", label="features found in an image"),
    share("repeatability_share", "features of the frame before, in sight here, found again", detail=False),
    Measure(name="matches_per_image", label="matches of descriptors"),
    share("right_share", "right ones among the matches", detail=False),
    Measure(name="kept_per_image", label="matches that agree with one motion"),
    share("kept_right_share", "right ones among those that agree", detail=False),
    share("lost_right_share", "right matches that do not agree with it", detail=False),
    share("track_survival_share", "tracks of the frame before that go on", detail=False),
    Measure(name="tracks_per_image", label="tracks seen in a frame"),
    Measure(name="wrong_per_image", label="tracks more than 3 px off"),
    Measure(name="track_error_px", label="RMS error of a coordinate of the others"),
    Measure(name="track_sigma_px", label="standard deviation of a coordinate that estimators are given"),
)

_SEQUENCE = KindSchema(
    row=(POSE_ERROR[0], *VIEW[:1], *DATABASE, *_ENDS),
    tables={
        "epochs": (
            *KEY,
            count("frame", "number of the frame in its sequence, from 0"),
            number("anomaly_deg", "anomaly gone through since the first frame; none along given states"),
            number("time_s", "epoch of the frame; the first is at 0"),
            *_inertial("", "estimated camera position in inertial axes (ACRF), by the known rotation of the body"),
            *_inertial("true_", "true camera position in inertial axes about the body's centre of mass (ACRF)"),
            number("position_error_m", "length of c_est - c_true right after the frame, body frame"),
            number("radial_m", "component of the same away from the body's origin"),
            number("along_m", "component along the true motion, at a right angle to the radial one"),
            number("cross_m", "component along radial x along: the orbit's normal"),
            number("nees", "that error weighted by the estimator's covariance (3 degrees of freedom)"),
            number("position_sigma_m", "RMS position error that the covariance foretells"),
            *_landmark_errors("root mean square over"),
            count("n_tracks", "tracks that are seen in the frame"),
            count("n_landmarks", "landmarks of the estimator among them"),
            count("n_settled", "those of them that the frame before saw too"),
        ),
        "vision": (
            *KEY,
            count("frame", "number of the frame in its sequence, from 0"),
            count("n_features", "features found in its image"),
            number("repeatability", "share of the features of the frame before, in sight here, found again"),
            count("n_matches", "matches of descriptors with the frame before"),
            count("n_kept", "those of them that agree with one motion of the camera"),
            number("right_share", "share of the matches that are right: within 3 px of the true place"),
            number("kept_right_share", "the same of those that were kept"),
            number("survival", "share of the tracks of the frame before that go on"),
            count("n_tracks", "tracks seen in the frame"),
            count("n_wrong", "tracks more than 3 px from the true place of their landmark"),
            number("error_px", "RMS over the others of the error of a coordinate"),
            number("sigma_px", "standard deviation of a coordinate that the vision layer gives estimators"),
        ),
    },
    measures=(
        plain("landmark_error_m", "landmark error"),
        share("error_after_1_reduction", "position error after 1 revolution"),
        share("error_after_2_reduction", "position error after 2 revolutions"),
        plain("error_after_1_ratio", "ratio of the position errors after 1 revolution"),
        plain("error_after_2_ratio", "ratio of the position errors after 2 revolutions"),
        plain("cycle_seconds_ratio", "ratio of the cycle times"),
        *_VISION,
    ),
    metrics=("position_error_m", *SEQUENCE_COLUMNS),
    nees="epochs",
    frames=True,
)
"""A camera that is followed along an orbit or a trajectory."""


def _of_arc(name: str, meaning: str, label: str = "") -> Column:
    return measured(name, meaning, label, error=True, detail=bool(label))


_ORBIT_ROW: Columns = (
    replace(POSE_ERROR[0], meaning="position error at the epoch, inertial axes"),
    number("nees", "error of the state weighted by its covariance (6 degrees of freedom)"),
    number("position_sigma_m", "RMS position error at the epoch that the covariance foretells"),
    *VIEW[:1],
)
_ARC = ("arc_rms_m", "arc_median_m", "arc_p90_m", "predicted_error_m", "residual_rms_px")
ORBIT_COLUMNS = (*_ARC, "wrong_left_share", "right_edited_share")
"""Errors of an orbit in the table ``orbits``; the position error is that at the epoch."""

_ORBIT_METRICS = ("position_error_m", *_ARC)

_ORBIT = KindSchema(
    row=(*DATABASE, *_ORBIT_ROW),
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
    metrics=_ORBIT_METRICS,
    nees="orbits",
    databases_note=(
        "Positions and prominence of the craters were drawn {n} times; trials have them in turn. Intervals take that"
        " draw for what is independent (Student's t over the draws), so that they include the variation between them."
        " The body and its a priori shape are the same in all trials of a scenario."
    ),
)
"""An orbit that is determined from sightings and radiometric data."""

_NAVIGATION = KindSchema(
    row=_ORBIT_ROW,
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
            count("n_used", "sightings that the orbit rests on; empty without an orbit", gaps=True),
            number("first_days", "time after the epoch of its first image"),
            number("last_days", "of its last image"),
        ),
    },
    metrics=_ORBIT_METRICS,
    nees="orbits",
)
"""Orbit determination from images, in which craters are detected and matched."""

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
"""Planned images."""

SCHEMAS = {
    "approach-orbit": replace(_ORBIT, databases_note=""),
    "crater-detection": CRATER_DETECTION,
    "crater-matching": CRATER_MATCHING,
    "crater-navigation": _NAVIGATION,
    "image-survey": _SURVEY,
    "landmark-database": KindSchema(metrics=("landmarks", "facets", "candidates", "kept_clusters")),
    "orbit-determination": _ORBIT,
    "pose-convergence": KindSchema(row=(*PRIOR_ERROR, *POSE_ERROR, *VIEW), metrics=POSE_METRICS),
    "sequence": _SEQUENCE,
    "single-image": _IMAGE,
}
"""By the kind of trial, in the order of their names, in which columns and tables are listed."""

"""The documented columns of every stored table. Raise FORMAT_VERSION when one changes its meaning."""

from __future__ import annotations

from dataclasses import dataclass

import pyarrow as pa

from scenarios.parquet import Layout

FORMAT_VERSION = 2

# Stages of ``timings`` that tell how a trial came by its image: rendered or read in this run, or kept from another.
FRESH_IMAGE, STORED_IMAGE = "image", "stored_image"


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a stored table: name, Arrow type and meaning."""

    name: str
    type: pa.DataType
    meaning: str


def _key() -> tuple[Column, ...]:
    return (
        Column("trial", pa.int64(), "number of the trial, from 0"),
        Column("scenario", pa.string(), "name of the scenario"),
        Column("estimator", pa.string(), "label of the estimator"),
    )


def _pose_error() -> tuple[Column, ...]:
    return (
        Column("position_error_m", pa.float64(), "length of c_est - c_true, the camera in the body frame"),
        Column("attitude_error_deg", pa.float64(), "angle of the rotation from the true to the estimated attitude"),
        Column("position_error_x_m", pa.float64(), "x of R_true (c_est - c_true): camera axes, right"),
        Column("position_error_y_m", pa.float64(), "y of the same: down"),
        Column("position_error_z_m", pa.float64(), "z of the same: along the boresight"),
    )


def _landmark_errors(over: str) -> tuple[Column, ...]:
    what = f"{over} the estimator's landmarks whose tracks are seen in the frame, of |l_est - l_true| in body axes"
    return (
        Column("landmark_rmse_m", pa.float64(), what),
        Column("settled_landmark_rmse_m", pa.float64(), "the same without tracks that the frame is the first of"),
    )


def _image_key() -> tuple[Column, ...]:
    return _key()[:2]


def _ellipse(what: str) -> tuple[Column, ...]:
    return (
        Column("u_px", pa.float64(), f"column of the centre of {what}, continuous pixels"),
        Column("v_px", pa.float64(), "row of the centre"),
        Column("major_px", pa.float64(), "longer semi-axis"),
        Column("minor_px", pa.float64(), "shorter semi-axis"),
        Column("angle_deg", pa.float64(), "from the column axis to the longer one, towards the row axis"),
    )


def _crater_flags(of: str) -> tuple[Column, ...]:
    """Columns of the two flags; a detection of a crater that is not detectable is neither found nor false in rates."""
    return (
        Column("detectable", pa.bool_(), f"{of} 12 px or more, seen, in the frame, lit, and not too worn or cut"),
        Column("clean", pa.bool_(), f"{of} of these, with a rim within 1 % of an ellipse and an axis ratio over 0.5"),
    )


def _inertial(prefix: str, what: str) -> tuple[Column, ...]:
    return tuple(Column(f"{prefix}{axis}_m", pa.float64(), f"{axis} of the {what}") for axis in "xyz")


def _pose(prefix: str, what: str) -> tuple[Column, ...]:
    return (
        *(Column(f"{prefix}q{part}", pa.float64(), f"{part} of the quaternion of {what}") for part in "wxyz"),
        *(
            Column(f"{prefix}t{axis}_m", pa.float64(), f"{axis} of its translation: the body in the camera")
            for axis in "xyz"
        ),
    )


TABLES: dict[str, tuple[Column, ...]] = {
    "rows": (
        *_key(),
        Column(
            "status",
            pa.string(),
            "ok, failed (the estimator says why) or error (it raised, was stopped or returned rubbish)",
        ),
        Column("reason", pa.string(), "why it is not ok; empty when ok"),
        *(Column(f"prior_{c.name}", c.type, f"of the prior: {c.meaning}") for c in _pose_error()),
        *_pose_error(),
        Column("nees", pa.float64(), "error of the pose weighted by the estimator's covariance (6 degrees of freedom)"),
        Column("position_sigma_m", pa.float64(), "RMS position error that the estimator's covariance foretells"),
        Column("attitude_sigma_deg", pa.float64(), "RMS attitude error that the estimator's covariance foretells"),
        Column("position_bound_m", pa.float64(), "RMS position error at the Cramer-Rao bound of its observations"),
        Column("attitude_bound_deg", pa.float64(), "RMS attitude error at that bound"),
        Column("n_landmarks", pa.int64(), "landmarks that the estimate rests on; 0 where it uses none"),
        Column("database", pa.int64(), "number of the data base that it had, from 0; empty where it has none"),
        Column("image", pa.string(), "file name of a real image; empty when rendered"),
        Column("range_m", pa.float64(), "true distance of the camera from the body's origin"),
        Column("phase_deg", pa.float64(), "true phase angle at the body's origin"),
        Column("latitude_deg", pa.float64(), "true latitude of the camera in the body frame, about its z axis"),
        Column("error_after_1_m", pa.float64(), "of a sequence: position error at the frame that ends revolution 1"),
        Column("error_after_2_m", pa.float64(), "the same of revolution 2"),
        *_landmark_errors("root mean square over all frames of a sequence and"),
        Column("final_landmark_rmse_m", pa.float64(), "over landmarks seen twice or more, each when it was seen last"),
        Column("mean_position_nees", pa.float64(), "of a sequence: mean over the frames of nees in epochs"),
        Column("time_s", pa.float64(), "epoch of a single image; 0 when rendered"),
        *_pose("", "the estimated T_cam_body of a single image"),
        *_pose("true_", "the true T_cam_body, of a real image the one that is scored against"),
    ),
    "stages": (*_key(), Column("stage", pa.string(), "prior, or a stage of the estimator"), *_pose_error()),
    "references": (
        *_key(),
        Column("reference", pa.string(), "name of the pose that is scored against"),
        *_pose_error(),
    ),
    "epochs": (
        *_key(),
        Column("frame", pa.int64(), "number of the frame in its sequence, from 0"),
        Column("anomaly_deg", pa.float64(), "anomaly gone through since the first frame"),
        Column("time_s", pa.float64(), "epoch of the frame; the first is at 0"),
        *_inertial("", "estimated camera position in inertial axes (ACRF), by the known rotation of the body"),
        *_inertial("true_", "true camera position in inertial axes about the body's centre of mass (ACRF)"),
        Column("position_error_m", pa.float64(), "length of c_est - c_true right after the frame, body frame"),
        Column("radial_m", pa.float64(), "component of the same away from the body's origin"),
        Column("along_m", pa.float64(), "component along the true motion, at a right angle to the radial one"),
        Column("cross_m", pa.float64(), "component along radial x along: the orbit's normal"),
        Column("nees", pa.float64(), "that error weighted by the estimator's covariance (3 degrees of freedom)"),
        Column("position_sigma_m", pa.float64(), "RMS position error that the covariance foretells"),
        *_landmark_errors("root mean square over"),
        Column("n_tracks", pa.int64(), "tracks that are seen in the frame"),
        Column("n_landmarks", pa.int64(), "landmarks of the estimator among them"),
        Column("n_settled", pa.int64(), "those of them that the frame before saw too"),
    ),
    "vision": (
        *_key(),
        Column("frame", pa.int64(), "number of the frame in its sequence, from 0"),
        Column("n_features", pa.int64(), "features found in its image"),
        Column("repeatability", pa.float64(), "share of the features of the frame before, in sight here, found again"),
        Column("n_matches", pa.int64(), "matches of descriptors with the frame before"),
        Column("n_kept", pa.int64(), "those of them that agree with one motion of the camera"),
        Column("right_share", pa.float64(), "share of the matches that are right: within 3 px of the true place"),
        Column("kept_right_share", pa.float64(), "the same of those that were kept"),
        Column("survival", pa.float64(), "share of the tracks of the frame before that go on"),
        Column("n_tracks", pa.int64(), "tracks seen in the frame"),
        Column("n_wrong", pa.int64(), "tracks more than 3 px from the true place of their landmark"),
        Column("error_px", pa.float64(), "RMS over the others of the error of a coordinate"),
        Column("sigma_px", pa.float64(), "what the vision layer tells estimators of that error"),
    ),
    "crater_matches": (
        *_key(),
        Column("view_deg", pa.float64(), "angle between the directions to the two cameras"),
        Column("sun_deg", pa.float64(), "angle between the two directions of the Sun"),
        Column("n_first", pa.int64(), "detections in the first image"),
        Column("n_second", pa.int64(), "detections in the second image"),
        Column("n_common", pa.int64(), "craters of the truth that are detected in both"),
        Column("n_correct", pa.int64(), "matches that join two detections of one of them"),
        Column("n_wrong", pa.int64(), "the other matches"),
        Column("n_missed", pa.int64(), "craters in both without a correct match"),
        Column("epipolar_offset_px", pa.float64(), "largest distance of one of them from its epipolar line"),
    ),
    "orbits": (
        *_key(),
        Column("epoch_error_m", pa.float64(), "position error at the epoch, inertial axes"),
        Column("epoch_velocity_error_m_s", pa.float64(), "velocity error there"),
        Column("epoch_nees", pa.float64(), "error of the state weighted by its covariance, over 6: 1 is expected"),
        Column("arc_median_m", pa.float64(), "median position error over the arc, every 6 h"),
        Column("arc_rms_m", pa.float64(), "root mean square of the same"),
        Column("arc_p90_m", pa.float64(), "90 % of the same"),
        Column("arc_nees", pa.float64(), "mean over the arc of the position error weighted by its covariance, over 3"),
        Column("predicted_error_m", pa.float64(), "position error at the end of the predicted days"),
        Column("predicted_sigma_m", pa.float64(), "RMS position error that the covariance foretells there"),
        Column("residual_rms_px", pa.float64(), "RMS of a coordinate of the residuals that were not edited"),
        Column("wrong_left_share", pa.float64(), "share of wrong sightings among those that were not edited"),
        Column("right_edited_share", pa.float64(), "share of the right sightings that were edited"),
        Column("gm_error", pa.float64(), "relative error of GM"),
        Column("solar_pressure_error", pa.float64(), "relative error of the size of solar pressure"),
    ),
    "orbit_errors": (
        *_key(),
        Column("time_days", pa.float64(), "time after the epoch"),
        Column("predicted", pa.bool_(), "whether it is later than the last image"),
        Column("position_error_m", pa.float64(), "length of r_est - r_true, inertial axes"),
        Column("radial_m", pa.float64(), "component of the same away from the body"),
        Column("along_m", pa.float64(), "component along the true motion, at a right angle to the radial one"),
        Column("cross_m", pa.float64(), "component along radial x along"),
        Column("position_sigma_m", pa.float64(), "RMS position error that the covariance foretells"),
    ),
    "residuals": (
        *_key(),
        Column("time_days", pa.float64(), "time of the image after the epoch; of the first trial alone"),
        Column("u_px", pa.float64(), "column seen less predicted"),
        Column("v_px", pa.float64(), "row seen less predicted"),
        Column("used", pa.bool_(), "whether the sighting was not edited"),
    ),
    "navigation": (
        *_key(),
        Column("rounds", pa.int64(), "how often matching and orbit determination were done"),
        Column("epochs", pa.int64(), "times at which an image could have been planned"),
        Column("n_images", pa.int64(), "images that were planned and taken"),
        Column("n_blind", pa.int64(), "images in which the detector could see nothing"),
        Column("n_detections", pa.int64(), "craters that were detected in all images"),
        Column("n_false", pa.int64(), "those of them that are no crater in truth"),
        Column("n_pairs", pa.int64(), "pairs of images that were matched in the last round"),
        Column("n_correct", pa.int64(), "matches that join two detections of one crater"),
        Column("n_wrong", pa.int64(), "the other matches"),
        Column("n_common", pa.int64(), "craters detected in both images of a matched pair, over all pairs"),
        Column("n_conflicts", pa.int64(), "matches refused because an image would have had a number twice"),
        Column("n_numbered", pa.int64(), "detections with a number"),
        Column("n_landmarks", pa.int64(), "numbers"),
    ),
    "navigated_images": (
        *_key(),
        Column("image", pa.int64(), "number of the image"),
        Column("time_days", pa.float64(), "time after the epoch"),
        Column("kind", pa.string(), "why it was planned: nadir, limb or terminator"),
        Column("phase_deg", pa.float64(), "true phase angle at the body's origin"),
        Column("n_detections", pa.int64(), "craters that were detected"),
        Column("n_false", pa.int64(), "those of them that are no crater in truth"),
        Column("n_numbered", pa.int64(), "detections with a number"),
        Column("reason", pa.string(), "why nothing could be seen; empty where the image was searched"),
    ),
    "navigated_landmarks": (
        *_key(),
        Column("landmark", pa.int64(), "number in the data base"),
        Column("hits", pa.int64(), "images that show it"),
        Column("crater", pa.int64(), "true crater that most of its sightings are of; -1 for none"),
        Column("n_other", pa.int64(), "sightings of another one"),
        Column("n_used", pa.int64(), "sightings that the orbit rests on; empty without an orbit"),
        Column("first_days", pa.float64(), "time after the epoch of its first image"),
        Column("last_days", pa.float64(), "of its last image"),
    ),
    "surveyed_images": (
        *_key(),
        Column("image", pa.int64(), "number of the image in its plan"),
        Column("time_days", pa.float64(), "time after the epoch"),
        Column("kind", pa.string(), "why it was planned: nadir, limb or terminator"),
        Column("n_detections", pa.int64(), "craters that were detected, false ones included"),
        Column("n_overlapping", pa.int64(), "other images of the same area: a tenth of a lit region is in both"),
        Column("n_similar", pa.int64(), "those of them with the Sun within 10 deg, body axes"),
    ),
    "surveyed_craters": (
        *_key(),
        Column("crater", pa.int64(), "number of the crater"),
        Column("hits", pa.int64(), "images in which it was detected"),
    ),
    "landmarks": (
        *_key(),
        Column("landmark", pa.int64(), "index in the landmark data base"),
        Column("u_px", pa.float64(), "column of the matched corner, continuous pixels"),
        Column("v_px", pa.float64(), "row of the matched corner"),
        Column("error_m", pa.float64(), "distance of the corner's true surface point from the landmark's mean"),
        Column("chi_square", pa.float64(), "the same, weighted by the landmark's covariance (3 degrees of freedom)"),
    ),
    "crater_images": (
        *_image_key(),
        Column("phase_deg", pa.float64(), "true phase angle at the body's origin"),
        Column("lit_share", pa.float64(), "share of the image above a twentieth of its range"),
        Column("n_craters", pa.int64(), "craters with a point of the crest in sight, of those that are listed"),
        Column("n_detectable", pa.int64(), "detectable ones"),
        Column("n_clean", pa.int64(), "clean ones"),
    ),
    "craters": (
        *_image_key(),
        Column("crater", pa.int64(), "number of the crater in its population"),
        *_ellipse("the ellipse through its crest"),
        Column("deviation", pa.float64(), "RMS distance of the crest from the ellipse over the ellipse's radius"),
        Column("diameter_m", pa.float64(), "of the crest"),
        Column("depth_ratio", pa.float64(), "depth from the crest to the floor over the diameter"),
        Column("degradation", pa.float64(), "0 fresh to 1"),
        Column("visible", pa.float64(), "share of the crest that nothing hides from the camera"),
        Column("in_frame", pa.float64(), "share of the crest within the image"),
        Column("lit", pa.float64(), "share of the crest in sunlight"),
        Column("cut", pa.float64(), "share of the crest that younger craters have taken"),
        Column("emission_deg", pa.float64(), "angle of the camera from the normal of the crest's plane"),
        Column("incidence_deg", pa.float64(), "angle of the Sun from it"),
        *_crater_flags("whether it is"),
    ),
    "detections": (
        *_key(),
        Column("rank", pa.int64(), "place by confidence, from 0"),
        Column("confidence", pa.float64(), "as the detector gives it"),
        Column("kept", pa.bool_(), "whether it reaches the detector's threshold"),
        *_ellipse("the detection"),
        Column(
            "crater",
            pa.int64(),
            "number of the listed crater that it is matched with; -1 for a false alarm",
        ),
        Column("duplicate", pa.bool_(), "a false alarm on a crater that a more confident detection is matched with"),
        *_crater_flags("whether that crater is"),
        Column("centre_error_px", pa.float64(), "distance of its centre from that of the true ellipse"),
        Column("centre_error_u_px", pa.float64(), "column of the same"),
        Column("centre_error_v_px", pa.float64(), "row of the same"),
        Column("major_error_px", pa.float64(), "longer semi-axis less the true one"),
        Column("minor_error_px", pa.float64(), "shorter semi-axis less the true one"),
    ),
    "diagnostics": (
        *_key(),
        Column("name", pa.string(), "name of a number that the estimator reports"),
        Column("value", pa.float64(), "its value"),
    ),
    "timings": (
        *_key(),
        Column("stage", pa.string(), "stage of the trial or of the estimator"),
        Column("seconds", pa.float64(), "wall time"),
    ),
    "said": (
        *_key(),
        Column("stream", pa.string(), "stdout, stderr, or warnings of Python"),
        Column("text", pa.string(), "what the method wrote there; only the beginning where much, which it then says"),
    ),
    "tracebacks": (*_key(), Column("traceback", pa.string(), "Python traceback of an estimator that raised")),
}


def schema(table: str) -> pa.Schema:
    """Return the Arrow schema of a table, with the meanings as field metadata."""
    fields = [pa.field(c.name, c.type, metadata={"meaning": c.meaning}) for c in TABLES[table]]
    return pa.schema(fields, metadata={"boresight_table": table, "boresight_format": str(FORMAT_VERSION)})


def layout(table: str) -> Layout:
    """Return what a reader of a table holds it to; columns that an earlier version had may be anything."""
    texts = {c.name: c.type == pa.string() for c in TABLES[table]}
    keys = {c.name for c in _key()} | ({"status"} if table == "rows" else set())
    return Layout(tuple(name for name in texts if name in keys), texts.get)

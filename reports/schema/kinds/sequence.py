"""Columns of sequences: a camera followed along an orbit or a trajectory."""

from __future__ import annotations

from boresight.reports.schema.column import (
    DATABASE,
    KEY,
    POSE_ERROR,
    VIEW,
    Columns,
    KindSchema,
    Measure,
    count,
    measured,
    names,
    number,
    plain,
    share,
)


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

_SCHEMA = KindSchema(
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

SCHEMAS = {"sequence": _SCHEMA}

"""Columns of single images, one pose each; of solvers of poses, and of the building of data bases of landmarks."""

from __future__ import annotations

from boresight.reports.schema.column import (
    DATABASE,
    KEY,
    POSE_ERROR,
    POSE_METRICS,
    PRIOR_ERROR,
    VIEW,
    Columns,
    KindSchema,
    count,
    measured,
    number,
    text,
)


def _pose(prefix: str, what: str) -> Columns:
    return (
        *(number(f"{prefix}q{part}", f"{part} of the quaternion of {what}") for part in "wxyz"),
        *(number(f"{prefix}t{axis}_m", f"{axis} of its translation: the body in the camera") for axis in "xyz"),
    )


_IMAGE = KindSchema(
    row=(
        *PRIOR_ERROR,
        *POSE_ERROR,
        number("nees", "error of the pose weighted by the estimator's covariance (6 degrees of freedom)"),
        number("position_sigma_m", "RMS position error that the estimator's covariance foretells"),
        number("attitude_sigma_deg", "RMS attitude error that the estimator's covariance foretells"),
        number("position_bound_m", "RMS position error at the Cramer-Rao bound of its observations"),
        number("attitude_bound_deg", "RMS attitude error at that bound"),
        *DATABASE,
        text("image", "file name of a real image; empty when rendered"),
        *VIEW,
        number("latitude_deg", "true latitude of the camera in the body frame, about its z axis"),
        number("time_s", "epoch of a single image; 0 when rendered"),
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
    measures=(),
    metrics=POSE_METRICS,
)  # fmt: skip

SCHEMAS = {
    "single-image": _IMAGE,
    "pose-convergence": KindSchema(row=(*PRIOR_ERROR, *POSE_ERROR, *VIEW), metrics=POSE_METRICS),
    "landmark-database": KindSchema(metrics=("landmarks", "facets", "candidates", "kept_clusters")),
}

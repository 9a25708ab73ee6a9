"""What stages and measures are called in print."""

from __future__ import annotations

from reports.schema.records import CONTROL, DERIVED, DIAGNOSTICS, FAILURES_AT_PRIOR, unit_of

_STAGES = {
    CONTROL: "prior",
    "centroid": "after centroiding",
    "alignment": "after alignment",
    "recognition": "after recognition",
    "choice": "after the choice",
    "range": "after the range",
    "final": "final",
    FAILURES_AT_PRIOR: "failures at prior",
    "database": "data base",
    DIAGNOSTICS: "of each trial",
    DERIVED: "of the scenario",
}
_TIMED = {
    "mesh_rendering": "data base image rendering",
    "centroid": "brightness centroid",
    "feature_extraction": "feature extraction",
    "recognition": "recognition and pose estimation",
    "consistency": "consistency of the solution",
    "range": "fusion of the range",
    "image": "image (rendered or read)",
    "stored_image": "image (from the store)",
}
MEASURES = {
    "position_error_m": "position error",
    "position_error_x_m": "position error, x",
    "position_error_y_m": "position error, y",
    "position_error_z_m": "position error, z",
    "attitude_error_deg": "attitude error",
    "success_share": "success",
    "n_landmarks": "landmarks an image",
    "four_landmarks_share": "four landmarks or more",
    "landmark_observations": "landmark observations",
    "landmark_error_m": "landmark error",
    "chi_square": "chi-square of a landmark",
    "error_after_1_m": "position error after 1 revolution",
    "error_after_2_m": "position error after 2 revolutions",
    "error_after_1_ratio": "ratio of the position errors after 1 revolution",
    "error_after_2_ratio": "ratio of the position errors after 2 revolutions",
    "cycle_seconds_ratio": "ratio of the cycle times",
    "landmark_rmse_m": "landmark RMSE",
    "settled_landmark_rmse_m": "landmark RMSE without new ones",
    "final_landmark_rmse_m": "landmark RMSE as seen last",
    "mean_position_nees": "mean NEES of the position (3 expected)",
    "landmarks": "landmarks in the data base",
    "facets": "facets of the data base",
    "centroid_offset_px": "offset of the brightness centroid",
    "centroid_du_px": "offset of the centroid along the columns",
    "extent_px": "extent of the body, longer side",
    "diameter_px": "extent of the body, disc of equal area",
    "pixel_scale_m": "a pixel on the surface",
    "pixel_rotation_deg": "rotation of the body by a pixel",
    "pixel_displacement_m": "displacement of the camera by a pixel",
    "outlier_rounds": "outlier rounds",
    "database_landmarks": "landmarks in the data base",
    "database_facets": "facets of the data base",
    "database_bytes": "size of the data base",
    "images": "images of the arc",
    "detections": "craters detected in all images",
    "detections_an_image": "craters detected in an image",
    "few_craters_share": "images with 7 craters or fewer",
    "similar_image_share": "images with a photometrically similar one",
    "similar_images": "photometrically similar images of an image, median",
    "overlapping_images": "images of the same area, median",
    "craters": "craters detected in any image",
    "hits_a_crater": "images in which a crater is detected",
    "seen_once_share": "craters detected in one image alone",
    "detection_share": "detectable craters found",
    "false_alarm_share": "false alarms among detections of detectable craters and false ones",
    "listed_false_alarm_share": "false alarms among the detections",
    "best_false_alarm_share": "false alarms among the 12 most confident of an image",
    "missed_share": "craters missed",
    "wrong_share": "wrong matches",
    "epipolar_offset_px": "largest distance of a crater from its epipolar line",
    "best_centre_error_px": "centre error of these 12",
    "common_centre_error_px": "centre error of the craters that all methods found",
    "detections_per_image": "detections in an image",
    "epoch_error_m": "position error at the epoch",
    "arc_rms_m": "RMS position error over the arc",
    "arc_median_m": "median position error over the arc",
    "predicted_error_m": "predicted position error",
    "position_reduction_m": "reduction of the position error",
    "attitude_reduction_deg": "reduction of the attitude error",
    "error_after_1_reduction": "position error after 1 revolution",
    "error_after_2_reduction": "position error after 2 revolutions",
    "seconds": "time",
}


def count_of(number: int, noun: str) -> str:
    """Say how many: '1 trial', '5,000 trials'."""
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def stage_label(stage: str, timed: bool = False) -> str:
    """Name a stage in plain words: as a state of the pose, or as a piece of work that takes time."""
    return (_TIMED if timed else _STAGES).get(stage, stage.replace("_", " "))


def as_title(label: str) -> str:
    """Begin a label with a capital and keep all others, as those of NEES and RMS."""
    return label[:1].upper() + label[1:]


def measure_label(name: str) -> str:
    """Name a measure in plain words."""
    return MEASURES.get(name, name.removesuffix(f"_{unit_of(name)}").replace("_", " "))

"""Words for stages and counts in print."""

from __future__ import annotations

from boresight.reports.schema.common import FRESH_IMAGE, STORED_IMAGE
from boresight.reports.schema.records import CONTROL, DERIVED, DIAGNOSTICS, FAILURES_AT_PRIOR

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
    FRESH_IMAGE: "image (rendered or read)",
    STORED_IMAGE: "image (from the store)",
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

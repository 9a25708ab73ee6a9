"""Columns of pose convergence: a solver on exact and wrong correspondences."""

from __future__ import annotations

from boresight.reports.schema.column import KindSchema
from boresight.reports.schema.common import POSE_ERROR, POSE_METRICS, PRIOR_ERROR, VIEW

SCHEMA = KindSchema(row=(*PRIOR_ERROR, *POSE_ERROR, *VIEW), metrics=POSE_METRICS)

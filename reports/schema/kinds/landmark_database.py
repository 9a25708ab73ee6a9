"""Columns of the building of data bases of landmarks."""

from __future__ import annotations

from boresight.reports.schema.column import KindSchema

SCHEMA = KindSchema(metrics=("landmarks", "facets", "candidates", "kept_clusters"))

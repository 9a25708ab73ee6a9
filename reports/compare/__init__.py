"""Estimators, scenarios or whole runs beside each other: one metric, failures counted, differences trial by trial."""

from reports.compare.build import ComparisonFiles, write_comparison
from reports.compare.subjects import compare_runs

__all__ = ["ComparisonFiles", "compare_runs", "write_comparison"]

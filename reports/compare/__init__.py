"""Comparison of estimators, scenarios or runs by one metric, with failures counted and paired differences."""

from boresight.reports.compare.build import ComparisonFiles, write_comparison
from boresight.reports.compare.subjects import compare_runs

__all__ = ["ComparisonFiles", "compare_runs", "write_comparison"]

"""Comparison of estimators, scenarios or runs by one metric, with failures counted and paired differences."""

from boresight.reports.compare.subjects import compare_runs

__all__ = ["compare_runs"]

"""Report of the orbit of an approach: that of orbit determination."""

from boresight.reports.kinds.orbit_determination import REPORT

__all__ = ["REPORT"]

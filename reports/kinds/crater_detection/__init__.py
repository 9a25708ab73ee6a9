"""What a report tells of crater detection."""

from reports.kinds.crater_detection.report import REPORT

__all__ = ["REPORT"]

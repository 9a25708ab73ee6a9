"""What a report tells of sequences."""

from reports.kinds.sequence.report import REPORT

__all__ = ["REPORT"]

"""What a report tells of single images."""

from reports.kinds.single_image.report import REPORT

__all__ = ["REPORT"]

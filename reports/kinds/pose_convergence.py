"""What a report tells of pose solvers: what it does of single images, as far as the trials have it."""

from reports.kinds.single_image.report import REPORT

__all__ = ["REPORT"]

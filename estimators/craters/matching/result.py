"""What matchers say when there is nothing to match."""

from __future__ import annotations

from estimators.craters.contract import CraterImage


def too_few(first: CraterImage, second: CraterImage, needed: int = 1) -> str:
    """Say which image has too few craters for a way of matching; '' where both have enough."""
    for image in (first, second):
        count = len(image.detections.ellipses)
        if count < needed:
            craters = "no crater" if count == 0 else f"{count} crater{'s' if count > 1 else ''}"
            return f"image {image.number} has {craters}" + (f", {needed} needed" if needed > 1 else "")
    return ""

"""Contracts of crater detectors and matchers, and the values that the stages exchange."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Protocol, Self

import numpy as np

from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.geometry import Camera, Ellipses
from boresight.scenarios.observation import Frame


@dataclass(frozen=True, slots=True, eq=False)
class CraterDetections:
    """Crater rims found in an image, the most confident first.

    ``ellipses`` are n rims at their crests; ``confidence`` (n,) descends, on the detector's own scale. ``rejected`` are
    rims below the detector's threshold, if it returns them: they are not used, but complete the curves over the
    threshold.
    """

    ellipses: Ellipses
    confidence: FloatArray
    rejected: CraterDetections | None = None

    @classmethod
    def above(cls, threshold: float, ellipses: Ellipses, confidence: FloatArray) -> CraterDetections:
        """Split rims, sorted by descending confidence, at a threshold."""
        n = int(np.count_nonzero(confidence >= threshold))
        return cls(ellipses[:n], confidence[:n], cls(ellipses[n:], confidence[n:]))

    @classmethod
    def none(cls) -> CraterDetections:
        """Return no crater."""
        return cls(Ellipses.none(), np.zeros(0))


class CraterDetector(Protocol):
    """A method that finds craters in an image.

    ``version`` is part of every result's key: raise it when results change.
    """

    name: ClassVar[str]
    version: ClassVar[int]

    @classmethod
    def from_options(cls, options: Mapping[str, object]) -> Self:
        """Build from a campaign's options; raise BoresightError if one is invalid."""
        ...

    def detect(self, frame: Frame, camera: Camera) -> CraterDetections:
        """Find rims from the image and the Sun direction in camera axes; an image without a crater gives none.

        Raise BoresightError if the image is unusable: black, saturated, not finite.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class CraterImage:
    """An image after detection, of a ``number`` that is unique in its campaign: the input of matching.

    ``common`` (6, s) is the effect on the prior pose of s errors of unit variance that are the same for all images of a
    sequence: the part of its covariance that is correlated with the other images; (6, 0) if there is none.
    """

    number: int
    frame: Frame
    camera: Camera
    detections: CraterDetections
    common: FloatArray = field(default_factory=lambda: np.zeros((6, 0)))


@dataclass(frozen=True, slots=True, eq=False)
class CraterMatches:
    """Pairs of detections in two images that are taken for the same crater.

    ``pairs`` (k, 2) are rows of the first and the second image's detections, no row twice, and ``score`` (k,) is how
    well they agree, on the matcher's own scale. ``reason`` is why the pair of images was rejected; empty if it was not.
    """

    pairs: IndexArray
    score: FloatArray
    reason: str = ""

    @classmethod
    def none(cls, reason: str) -> CraterMatches:
        """Return no match, with the reason."""
        return cls(np.zeros((0, 2), dtype=np.int64), np.zeros(0), reason)


class GroundModel(Protocol):
    """The a priori shape, for the intersection with lines of sight."""

    def intersect(self, origin_body_m: FloatArray, directions_body: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (n, 3) points and (n, 3) outward normals where (n, 3) rays meet the body; NaN where they miss it."""
        ...


class CraterMatcher(Protocol):
    """A method that finds the craters that two images have in common."""

    name: ClassVar[str]
    version: ClassVar[int]

    @classmethod
    def from_options(cls, options: Mapping[str, object]) -> Self:
        """Build from a campaign's options; raise BoresightError if one is invalid."""
        ...

    def match(self, first: CraterImage, second: CraterImage, ground: GroundModel) -> CraterMatches:
        """Match two images by their detections, their pixels and their prior poses."""
        ...


def too_few_craters(first: CraterImage, second: CraterImage, needed: int = 1) -> str:
    """Return which image has too few craters for a method of matching; '' if both have enough."""
    for image in (first, second):
        count = len(image.detections.ellipses)
        if count < needed:
            craters = "no crater" if count == 0 else f"{count} crater{'s' if count > 1 else ''}"
            return f"image {image.number} has {craters}" + (f", {needed} needed" if needed > 1 else "")
    return ""

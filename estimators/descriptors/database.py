"""The data base of descriptors: features of rendered views with their points on the body, and its file format.

Features are OpenCV's SIFT (Lowe 2004) and ORB (Rublee et al. 2011).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Self, cast

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from boresight.estimators.archive import Archive
from boresight.estimators.landmark.signal import extract_signal
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import View, pixel_from_opencv
from boresight.scenarios.reading import LARGEST_NUMBER
from boresight.scenarios.spec.base import SpecModel, optional, rule

Kind = Literal["sift", "orb"]
DESCRIPTOR_BYTES = {"sift": 128, "orb": 32}
_BRIGHT_LEVEL = 200.0  # grey value of the 99th percentile, so that brighter pixels are not clipped

FILE = "descriptors.npz"

_ARCHIVE = Archive(FILE, "descriptors", "boresight-descriptors", version=1)
_UNIT = 1e-6

METHOD_VERSION = 2


class FeatureOptions(SpecModel):
    """Options of feature detection."""

    count: int = Field(400, ge=8, le=100_000, description="At most this many features an image, the strongest first")
    contrast_min: float = Field(0.02, gt=0, le=1, description="SIFT: least contrast of a feature")
    fast_threshold: int = Field(10, ge=1, le=255, description="ORB: least contrast of a corner")


@dataclass(frozen=True, slots=True, eq=False)
class DescribedFeatures:
    """Features of one image: pixels (M, 2), the centre of the first at (0.5, 0.5), and descriptors (M, D) of bytes."""

    uv_px: FloatArray
    descriptors: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.uv_px)


def find_features(image: NDArray[np.float32], kind: Kind, options: FeatureOptions) -> DescribedFeatures:
    """Find and describe features; the image is scaled to a fixed range first, so its unit does not matter."""
    signal = extract_signal(image).image
    grey = np.clip(np.rint(_BRIGHT_LEVEL * signal), 0, 255).astype(np.uint8)
    keypoints, described = _detector(kind, options).detectAndCompute(grey, None)
    if described is None or len(keypoints) == 0:
        return DescribedFeatures(np.empty((0, 2)), np.empty((0, DESCRIPTOR_BYTES[kind]), dtype=np.uint8))
    strongest = np.argsort([-point.response for point in keypoints], kind="stable")[: options.count]
    uv_px = pixel_from_opencv(np.array([point.pt for point in keypoints], dtype=np.float64))
    return DescribedFeatures(uv_px[strongest], np.asarray(described).astype(np.uint8)[strongest])


def _detector(kind: Kind, options: FeatureOptions) -> cv2.Feature2D:
    if kind == "sift":
        # Without the precise upscaling OpenCV's positions are off by a quarter of a pixel.
        return cv2.SIFT.create(contrastThreshold=options.contrast_min, enable_precise_upscale=True)
    return cv2.ORB.create(nfeatures=options.count, fastThreshold=options.fast_threshold)


def match_features(
    observed: NDArray[np.uint8], known: NDArray[np.uint8], kind: Kind, ratio_max: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]:
    """Match descriptors with their nearest known ones, if these pass the ratio test (Lowe 2004).

    Return the matched rows (M,) of both arrays, and the distances (M,) of the matched descriptors.
    """
    nothing = np.empty(0, dtype=np.int64)
    if len(observed) == 0 or len(known) < 2:
        return nothing, nothing, np.empty(0)
    if kind == "sift":
        matcher = cv2.BFMatcher(cv2.NORM_L2)
        pairs = matcher.knnMatch(observed.astype(np.float32), known.astype(np.float32), k=2)
    else:
        pairs = cv2.BFMatcher(cv2.NORM_HAMMING).knnMatch(observed, known, k=2)
    # On a self-similar surface the second nearest is often as near: such matches are ambiguous.
    clear = [first for first, second in pairs if first.distance < ratio_max * second.distance]
    rows = np.array([[match.queryIdx, match.trainIdx] for match in clear], dtype=np.int64).reshape(-1, 2)
    return rows[:, 0], rows[:, 1], np.array([match.distance for match in clear], dtype=np.float64)


class DescriptorViewOptions(SpecModel):
    """Options of the images of a data base of descriptors, and of the features in them."""

    source: Literal["rendered", "survey"] = optional(
        "Images of the data base: rendered, or the real ones of the scenario's images.survey", "rendered"
    )
    points: Literal["shape", "triangulated"] = optional(
        "Where features of a survey are: on the onboard shape, or where the lines of sight of its images meet",
        "shape",
    )
    images: int = Field(200, ge=1, le=100_000, description="Images rendered, at the range and camera of the scenario")
    phase_deg_max: float = Field(60.0, gt=0, le=180, description="Largest phase angle of those images")
    seed: int = Field(0, ge=0, description="Seed of their views")
    features: FeatureOptions = FeatureOptions()

    @rule
    def _a_survey_has_its_views(self) -> None:
        senseless = self.stated("images", "phase_deg_max", "seed")
        if self.source == "survey" and senseless:
            raise ValueError(f"{', '.join(senseless)} has no meaning for images of a survey; leave it out")
        if self.source != "survey" and self.points != "shape":
            raise ValueError("points: triangulated: features of rendered images are on the shape: set source: survey")


class DescriptorOptions(DescriptorViewOptions):
    """Options of a data base of descriptors."""

    kind: Kind = Field(description="Kind of descriptor")


def view_features(
    image: NDArray[np.float32], view: View, deproject: Callable[[FloatArray], FloatArray], options: DescriptorOptions
) -> ViewFeatures:
    """Find the features of one image and project them onto the body.

    ``image`` (H, W) is rendered without noise, or real. ``deproject`` maps pixels (M, 2) to points of the surface
    (M, 3) in the body frame, m; NaN where a pixel is on the sky.
    """
    features = find_features(image, options.kind, options.features)
    return ViewFeatures.where_known(view, deproject(features.uv_px), features.descriptors)


@dataclass(frozen=True, slots=True, eq=False)
class ViewFeatures:
    """Features of one image that lie on the body: points (M, 3), m, and descriptors (M, D), bytes.

    ``camera_dir_body`` and ``sun_dir_body`` (3,) are unit vectors from the body's origin.
    """

    camera_dir_body: FloatArray
    sun_dir_body: FloatArray
    points_m: FloatArray
    descriptors: NDArray[np.uint8]

    @classmethod
    def where_known(cls, view: View, points_m: FloatArray, descriptors: NDArray[np.uint8]) -> Self:
        """Keep the features of a view that have a point, not NaN."""
        points_m = np.asarray(points_m, dtype=np.float64).reshape(-1, 3)
        known = np.isfinite(points_m).all(axis=1)
        position = view.T_cam_body.camera_position_m
        return cls(position / np.linalg.norm(position), view.sun_dir_body, points_m[known], descriptors[known])


@dataclass(frozen=True, eq=False)
class DescriptorDatabase:
    """Views of the body with the features of each image; ``provenance`` has origin and options, as JSON values.

    Raises BoresightError if there is no view or shapes disagree.
    """

    kind: Kind
    views: tuple[ViewFeatures, ...]
    provenance: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.kind not in DESCRIPTOR_BYTES or not self.views:
            raise BoresightError(f"a data base of {self.kind} descriptors with {len(self.views)} views is of no use")
        for view in self.views:
            n = len(view.points_m)
            shapes = (view.points_m.shape, view.descriptors.shape)
            in_reach = bool((np.abs(view.points_m) <= LARGEST_NUMBER).all())
            if shapes != ((n, 3), (n, DESCRIPTOR_BYTES[self.kind])) or not in_reach:
                raise BoresightError(f"a view of {self.kind} features cannot have points and descriptors {shapes}")
            if view.descriptors.dtype != np.uint8:
                raise BoresightError(f"descriptors are bytes, not {view.descriptors.dtype}")
            for direction in (view.camera_dir_body, view.sun_dir_body):
                if direction.shape != (3,) or not (np.abs(direction) <= 1.0 + _UNIT).all():
                    raise BoresightError("the direction of a view is no unit vector")

    @property
    def n_features(self) -> int:
        """Number of features in all views."""
        return sum(len(view.points_m) for view in self.views)

    def nearest(self, camera_dir_body: FloatArray, sun_dir_body: FloatArray, count: int) -> Sequence[ViewFeatures]:
        """Return the ``count`` nearest views, by the root sum of squared angles of camera and Sun directions."""
        cameras = np.stack([view.camera_dir_body for view in self.views])
        suns = np.stack([view.sun_dir_body for view in self.views])
        # Both angles count alike: descriptors suffer from a change of the illumination as from one of the view.
        apart = _angle(cameras, camera_dir_body) ** 2 + _angle(suns, sun_dir_body) ** 2
        return [self.views[index] for index in np.argsort(apart, kind="stable")[:count]]

    def save(self, folder: Path) -> None:
        """Write ``descriptors.npz`` into ``folder``, which is made if absent; points in single precision."""
        arrays: dict[str, NDArray[np.generic]] = {
            "counts": np.array([len(view.points_m) for view in self.views], dtype=np.int32),
            "camera_dirs_body": np.stack([view.camera_dir_body for view in self.views]),
            "sun_dirs_body": np.stack([view.sun_dir_body for view in self.views]),
            "points_m": np.concatenate([view.points_m for view in self.views]).astype(np.float32),
            "descriptors": np.concatenate([view.descriptors for view in self.views]),
        }
        _ARCHIVE.save(folder, {"kind": self.kind, "provenance": dict(self.provenance)}, arrays)

    @classmethod
    def load(cls, folder: Path) -> DescriptorDatabase:
        """Read what ``save`` wrote.

        Raise BoresightError if the file is missing or its content is wrong; the message gives its path.
        """
        return _ARCHIVE.load(folder, cls._made)

    @classmethod
    def _made(cls, head: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> DescriptorDatabase:
        ends = np.cumsum(arrays["counts"])[:-1]
        points, descriptors = (np.split(arrays[name], ends) for name in ("points_m", "descriptors"))
        directions = (arrays["camera_dirs_body"], arrays["sun_dirs_body"])
        columns = zip(*directions, points, descriptors, strict=True)
        views = tuple(ViewFeatures(c, s, p.astype(np.float64), d) for c, s, p, d in columns)
        return cls(cast("Kind", head["kind"]), views, head["provenance"])


def _angle(units: FloatArray, unit: FloatArray) -> FloatArray:
    angle: FloatArray = np.arccos(np.clip(units @ unit, -1.0, 1.0))
    return angle

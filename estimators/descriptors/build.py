"""A data base of descriptors from images whose poses are known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from estimators.descriptors.database import ViewFeatures
from estimators.descriptors.features import FeatureOptions, Kind, find_features
from scenarios.geometry import View
from scenarios.spec.base import SpecModel

FloatArray = NDArray[np.float64]

METHOD_VERSION = 1


class DescriptorViewOptions(SpecModel):
    """Which images a data base of descriptors is made of, and how features are found in them."""

    images: int = Field(200, ge=1, le=100_000, description="Images rendered, at the range and camera of the scenario")
    phase_deg_max: float = Field(60.0, gt=0, le=180, description="Largest phase angle of those images")
    seed: int = Field(0, ge=0, description="Seed of their views")
    features: FeatureOptions = FeatureOptions()


class DescriptorOptions(DescriptorViewOptions):
    """How a data base of descriptors is made."""

    kind: Kind = Field(description="Which descriptors")


def view_features(
    image: NDArray[np.float32], view: View, deproject: Callable[[FloatArray], FloatArray], options: DescriptorOptions
) -> ViewFeatures:
    """Find the features of one image and take them back to the body.

    Parameters
    ----------
    image
        (H, W) noise-free image.
    view
        Where it was taken from, and under which Sun.
    deproject
        Takes pixels (M, 2) to points of the surface (M, 3) in the body frame, m; NaN where a pixel sees the sky.
    options
        Of the data base.
    """
    features = find_features(image, options.kind, options.features)
    points_m = np.asarray(deproject(features.uv_px), dtype=np.float64).reshape(-1, 3)
    on_body = np.isfinite(points_m).all(axis=1)
    position = view.T_cam_body.camera_position_m
    direction = position / np.linalg.norm(position)
    return ViewFeatures(direction, view.sun_dir_body, points_m[on_body], features.descriptors[on_body])

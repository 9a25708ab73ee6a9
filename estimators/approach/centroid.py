"""The estimator ``centroid``: the line of sight by the centre of brightness of the body."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import Field

from boresight.estimators.approach.body import Patch
from boresight.estimators.approach.sight import SightEstimator, Sighting, SightOptions, centroid_px
from boresight.estimators.contract import Assets
from boresight.estimators.landmark.recognizer import ShapeOptions, rendered_mesh
from boresight.estimators.options import parse_options
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.spec.base import SpecModel


class CentroidOptions(ShapeOptions, SightOptions):
    """Options of ``centroid``."""

    reflectance: Literal["fitted", "onboard"] = Field(
        "fitted",
        description="Share the light between the onboard law and another one as in the image, or take the onboard law",
    )


class CentroidEstimator(SightEstimator):
    """Shifts the prior until the brightness centroids of a rendering of the shape and of the image coincide.

    The position across the line of sight is measured and fused with the prior; the attitude stays that of the prior.
    The rendering corrects the centroid for phase, shape and reflectance. Its law is fitted to the image: the light is
    shared between the onboard law and one that darkens the limb differently. The covariance holds the noise of the
    image, the difference of image and rendering, and what the errors of the prior's attitude and range do to the
    centroid.

    Use it when
    -----------
    The whole body is in the image, from three pixels on, and the position across the line of sight is enough; or to
    measure the first stage of ``landmark-harris`` by itself, with ``shape: landmark-mesh, reflectance: onboard``.

    It fails when
    -------------
    The image shows no body, the frame cuts it, or the rendering is out of view or in the dark. The centroid is biased
    where the albedo or the direction to the Sun is wrong, where much of the body is dark, by a star within
    half a diameter of its middle, and by a second body that touches it in the image.

    Cost
    ----
    0.24 s an image of ``quickstart`` with the onboard law, a third more with the fitted one.

    Source
    ------
    Rowell et al. (2015), section 3.2, equations (11) to (13); the fitted law and the covariance are ours.
    """

    name: ClassVar[str] = "centroid"
    version: ClassVar[int] = 12
    fuses_prior: ClassVar[bool] = True
    options_model: ClassVar[type[SpecModel]] = CentroidOptions

    @classmethod
    def from_options(cls, options: Mapping[str, object], assets: Assets) -> Self:
        """Build from a campaign's options and the onboard shape or the landmark data base."""
        parsed = parse_options(CentroidOptions, options, cls.name)
        mesh = rendered_mesh(parsed, assets, cls.name)
        other = assets.mesh_renderer(mesh, other_law=True) if parsed.reflectance == "fitted" else None
        return cls(assets.mesh_renderer(mesh), mesh, mesh.radius_m, parsed, CENTROID, other)


def centroid_shift(observed: Patch, rendered: Patch) -> FloatArray:
    """Difference (2,) of the brightness centroids, px."""
    return centroid_px(observed) - centroid_px(rendered)


def centroid_weights(observed: FloatArray, rendered: FloatArray) -> FloatArray:
    """Return the derivatives (2, h, w) of the centroid by the observed pixels: (x - c) / total on the body, or 0."""
    rows, columns = np.mgrid[: observed.shape[0], : observed.shape[1]]
    place, total = np.stack([columns, rows]), observed.sum()
    centre = (place * observed).sum(axis=(1, 2)) / total
    used = (observed != 0.0) | (rendered > 0.0)
    return np.asarray((place - centre[:, None, None]) * used / total)


CENTROID = Sighting("centroid", centroid_shift, centroid_weights)

"""The estimators ``silhouette`` and ``centroid-phase``: the line of sight by correlation with a rendering."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Self

import numpy as np

from boresight.estimators.approach.body import BodyView
from boresight.estimators.approach.correlation import correlation_shift, correlation_weights
from boresight.estimators.approach.ellipsoid import Ellipsoid
from boresight.estimators.approach.sight import Sighting, SightOptions, estimate_sight
from boresight.estimators.contract import Assets, Estimate, ImageRenderer
from boresight.estimators.options import parse_options
from boresight.scenarios.geometry import TriangleMesh
from boresight.scenarios.observation import Observation
from boresight.scenarios.spec.base import SpecModel


class SilhouetteEstimator:
    """Shifts the prior to the greatest correlation of a rendering of the onboard shape with the image.

    The position across the line of sight is measured by the peak of the normalised cross-correlation and fused with the
    prior; the attitude stays that of the prior. The covariance is that of the peak, from its curvature and from the
    difference of image and rendering, and holds what the errors of the prior's attitude and range do to the peak.

    Use it when
    -----------
    The whole body is in the image, the onboard shape is known, and the position across the line of sight is enough.

    It fails when
    -------------
    The image shows no body, the frame cuts it, or the rendering is out of view or in the dark.

    Cost
    ----
    0.40 s an image of ``quickstart``.

    Source
    ------
    The cross-correlation of NASA's GIANT, `giant.relative_opnav`; the fraction of a pixel and the covariance are ours.
    """

    name: ClassVar[str] = "silhouette"
    version: ClassVar[int] = 8
    fuses_prior: ClassVar[bool] = True
    options_model: ClassVar[type[SpecModel]] = SightOptions

    def __init__(
        self, renderer: ImageRenderer, mesh: TriangleMesh, radius_m: float, options: SightOptions, misfit_m: float = 0.0
    ) -> None:
        self._body, self._options = (renderer, radius_m, mesh.area_vectors_m2), options
        self._sighting = Sighting("alignment", correlation_shift, correlation_weights, misfit_m)

    @classmethod
    def from_options(cls, options: Mapping[str, object], assets: Assets) -> Self:
        """Build from a campaign's options and the onboard shape."""
        parsed, mesh = parse_options(SightOptions, options, cls.name), assets.shape()
        return cls(assets.mesh_renderer(mesh), mesh, mesh.radius_m, parsed)

    def estimate(self, observation: Observation, *, rng: np.random.Generator) -> Estimate:
        """Estimate the pose by shifting the prior; ``rng`` is not used.

        Diagnostics are those of ``centroid``, those of the shift with the name ``alignment``.
        """
        del rng
        options, frame = self._options, observation.frame
        view = BodyView(*self._body, observation.camera, frame.sun_dir_cam, options.blur_px)
        return estimate_sight(observation, view, self._sighting, options.alignment_loop)


class LambertCorrelation(SilhouetteEstimator):
    """Shifts the prior to the greatest correlation of a Lambertian ellipsoid with the image.

    The ellipsoid has the axes of the onboard shape and the attitude of the prior, and no reflectance or relief is
    needed. The position across the line of sight is measured and fused with the prior, as by ``silhouette``. The
    covariance holds the distance of the shape from the ellipsoid.

    Use it when
    -----------
    Only the axes of the shape are known, or its rendering takes too long on board. The whole body is in the image.

    It fails when
    -------------
    The image shows no body, the frame cuts it, or the ellipsoid is out of view or in the dark. An irregular body pulls
    the ellipsoid towards its lit part: two bodies of 300 px by 6 px (median) at phase angles below 30 deg, and by 12
    px from 110 to 140 deg (40 images each). There the covariance is too small: mean NEES/6 1.6.

    Cost
    ----
    0.24 s an image of ``quickstart``.

    Source
    ------
    The correlation with a Lambertian sphere of the navigation of Hera: Gil-Fernandez and Ortega-Hernando (2018), CEAS
    Space Journal 10; the ellipsoid and the covariance are ours.
    """

    name: ClassVar[str] = "centroid-phase"

    @classmethod
    def from_options(cls, options: Mapping[str, object], assets: Assets) -> Self:
        """Build from a campaign's options and the axes of the onboard shape."""
        parsed, mesh = parse_options(SightOptions, options, cls.name), assets.shape()
        ellipsoid = Ellipsoid.of(mesh)
        return cls(ellipsoid, mesh, ellipsoid.radius_m, parsed, ellipsoid.misfit_m(mesh))

"""The estimators ``silhouette`` and ``centroid-phase``: the line of sight by correlation with a rendering."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar, Self

from boresight.estimators.approach.correlation import correlation_shift, correlation_weights
from boresight.estimators.approach.ellipsoid import ellipsoid_of
from boresight.estimators.approach.sight import SightEstimator, Sighting, SightOptions
from boresight.estimators.contract import Assets
from boresight.estimators.options import parse_options
from boresight.scenarios.spec.base import SpecModel

ALIGNMENT = Sighting("alignment", correlation_shift, correlation_weights, any_direction=True)


class SilhouetteEstimator(SightEstimator):
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
    version: ClassVar[int] = 10
    fuses_prior: ClassVar[bool] = True
    options_model: ClassVar[type[SpecModel]] = SightOptions

    @classmethod
    def from_options(cls, options: Mapping[str, object], assets: Assets) -> Self:
        """Build from a campaign's options and the onboard shape."""
        parsed, mesh = parse_options(SightOptions, options, cls.name), assets.shape()
        return cls(assets.mesh_renderer(mesh), mesh, mesh.radius_m, parsed, ALIGNMENT)


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
    version: ClassVar[int] = 9

    @classmethod
    def from_options(cls, options: Mapping[str, object], assets: Assets) -> Self:
        """Build from a campaign's options and the axes of the onboard shape."""
        parsed, mesh = parse_options(SightOptions, options, cls.name), assets.shape()
        ellipsoid = ellipsoid_of(mesh)
        how = replace(ALIGNMENT, misfit_m=ellipsoid.misfit_m(mesh), any_direction=False)
        return cls(ellipsoid, mesh, ellipsoid.radius_m, parsed, how)

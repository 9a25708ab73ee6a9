"""Errors of centres that the craters of one image share, measured by the sightings of a database at known poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boresight.estimators.craters.database.files import CraterDatabase
from boresight.estimators.craters.matching.association import CentreErrors, CraterAssociationOptions, centre_noise
from boresight.scenarios.arrays import FloatArray

_MIN_IMAGES = 3  # of a landmark: of two, the triangulation takes most of the residuals
_MIN_SHARE = 0.3  # of its variance that a residual keeps
_MIN_SIGHTINGS = 300
_CORRELATIONS = np.linspace(0.0, 0.6, 31)
_LENGTHS = 2.0 ** np.arange(-7, 1)  # in median distances between the craters of an image


@dataclass(frozen=True, slots=True, eq=False)
class _Residuals:
    """Residuals (k, 2) of the sightings of a picture in their deviations, and distances (k, k) of the landmarks, m."""

    standard: FloatArray
    apart_m: FloatArray


def measure_centre_errors(database: CraterDatabase, options: CraterAssociationOptions) -> CentreErrors:
    """Return the law of the errors of centres by maximum likelihood of the residuals of a database's sightings.

    The poses of its images must be known far better than a pixel: residuals that the craters of a picture have in
    common are taken for errors of the detector, and so would be those of a pose. ``options`` state the deviation of a
    sighting and the largest that is taken for a right one.
    Correlation and length are those of a grid. The freedom of the images' variances follows from their spread, by
    moments: the variance of a scaled inverse chi-square of v degrees is 2 / (v - 4) of its squared mean.
    Errors are independent, and as large as stated, if the database has too few sightings to tell.
    """
    pictures = _residuals(database, options)
    count = sum(len(one.standard) for one in pictures)
    if count < _MIN_SIGHTINGS:
        return CentreErrors()
    middle = np.median(np.concatenate([one.apart_m[np.triu_indices(len(one.apart_m), 1)] for one in pictures]))
    best, least, chosen = CentreErrors(), np.inf, []
    for length in _LENGTHS * middle:
        parts = [np.linalg.eigh(1.0 / (1.0 + one.apart_m / length)) for one in pictures]
        values = np.concatenate([values for values, _ in parts])
        squares = [((axes.T @ one.standard) ** 2).sum(axis=1) for (_, axes), one in zip(parts, pictures, strict=True)]
        for share in _CORRELATIONS:
            scale = share * values + 1.0 - share
            weighted = np.concatenate(squares) / scale
            variance = weighted.sum() / (2.0 * count)
            # Twice the negative logarithm of the likelihood, without constants, at the best variance.
            cost = 2.0 * count * np.log(variance) + 2.0 * np.log(scale).sum()
            if cost < least:
                least, best = cost, CentreErrors(float(variance), float(share), float(length))
                chosen = np.split(weighted, np.cumsum([len(one) for one in squares])[:-1])
    freedoms = np.array([2.0 * len(one) for one in chosen])
    ratios = np.array([one.sum() for one in chosen]) / freedoms / best.variance
    # A chi-square over its degrees of freedom v scatters by 2 / v of its squared scale: e + (1 + e) 2 / v in all.
    excess = float(np.mean(((ratios - 1.0) ** 2 - 2.0 / freedoms) / (1.0 + 2.0 / freedoms)))
    freedom = 4.0 + 2.0 / excess if excess > 0.0 else np.inf
    return CentreErrors(best.variance, best.correlation, best.length_m, freedom)


def _residuals(database: CraterDatabase, options: CraterAssociationOptions) -> list[_Residuals]:
    """Return the residuals of pictures with at least two sightings of well-seen landmarks."""
    landmarks, found = database.landmarks, []
    for picture in database.pictures:
        # Landmark numbers ascend, and every picture's numbers are among them.
        rows = np.searchsorted(landmarks.number, picture.landmark)
        often = np.flatnonzero(landmarks.images[rows] >= _MIN_IMAGES)
        rows, rims, pose, camera = rows[often], picture.ellipses[often], picture.T_cam_body, picture.camera
        points = landmarks.position_body_m[rows]
        cam = pose.transform(points)
        across = camera.jacobian(cam) @ pose.rotation
        noise = centre_noise(rims, options)
        # The landmark follows its sightings: the covariance of a residual of least squares is R - H P H^T.
        left = noise - across @ landmarks.covariance_m2[rows] @ np.swapaxes(across, 1, 2)
        free = np.linalg.eigvalsh(left)[:, 0] > _MIN_SHARE * noise[:, 0, 0]
        offsets = (rims.centre_px - camera.project(cam))[free]
        standard = np.linalg.solve(np.linalg.cholesky(left[free]), offsets[..., None])[..., 0]
        right = np.linalg.norm(standard, axis=1) < options.gate_sigma
        points = points[free][right]
        if len(points) > 1:
            found.append(_Residuals(standard[right], np.linalg.norm(points[:, None] - points, axis=2)))
    return found

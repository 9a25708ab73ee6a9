"""The estimator of single images that finds the attitude from stars."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Self

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from boresight.estimators.contract import Assets, Estimate, Stage, Stopwatch
from boresight.estimators.options import parse_options
from boresight.estimators.prior import floor_variances
from boresight.estimators.stars.detection import Detections, detect_stars
from boresight.estimators.stars.identification import Identified, Sky, identify
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import Camera, Pose, cross_matrix
from boresight.scenarios.observation import CameraSigma, Observation
from boresight.scenarios.spec.base import SpecModel
from boresight.scenarios.stars import StarCatalog

_BLACK_DN = 1e-6
"""Noise of a sky of one value."""


class StarOptions(SpecModel):
    """Options of ``stars``."""

    threshold: float = Field(6.0, ge=3, le=100, description="Least height of a star over the noise of the smoothed sky")
    most_stars: int = Field(60, ge=4, le=500, description="Stars that are used, the brightest")
    psf_sigma_px: float | None = Field(
        None,
        gt=0.1,
        le=10,
        description="Calibrated width of the blur; left out: measured from the stars in each image, up to 1.5 px",
    )
    gain_e_per_dn: float = Field(
        25.0, gt=0, description="Calibrated electrons for one digital number: sizes shot noise"
    )
    position_sigma_px: float = Field(
        0.02, gt=0, le=10, description="Standard deviation of what catalogue and lens add to the error of a position"
    )
    false_alarm: float = Field(
        1e-6,
        gt=0,
        le=0.1,
        description="Largest probability that point sources at random places are identified as stars",
    )


def rotation_update(
    prior: tuple[Pose, FloatArray], R_cam_body: FloatArray, covariance: FloatArray
) -> tuple[Pose, FloatArray]:
    """Update a pose and its covariance (6, 6) with a measured rotation (3, 3) and the covariance (3, 3) of its error.

    The errors of prior and measurement must be independent. The position moves as far as its error is correlated with
    that of the attitude.
    """
    pose, before = prior[0], floor_variances(prior[1])
    innovation = Rotation.from_matrix(R_cam_body @ pose.rotation.T).as_rotvec()
    gain = np.linalg.solve(before[:3, :3] + covariance, before[:3]).T
    step = gain @ innovation
    # Joseph's form, which stays positive however much smaller the one covariance is.
    left = np.eye(6)
    left[:, :3] -= gain
    after = left @ before @ left.T + gain @ covariance @ gain.T
    return pose.perturbed(step[:3], step[3:]), 0.5 * (after + after.T)


class StarNavigator:
    """Attitude from the stars behind the body; the position is that of the prior.

    Point sources on dark sky are detected and identified, near the attitude of a star tracker where the scenario has
    one (``stars.tracker_sigma_deg``), else lost in space. The attitude of the camera among the stars solves Wahba's
    problem. With the body's attitude by the onboard model of its rotation it is that of the camera over the body, and
    updates the prior's. The star tracker's attitude only narrows the search.

    Use it when
    -----------
    Exposures are long enough for stars, as in the approach phase, and the scenario has ``stars``. It calibrates the
    pointing of the camera against its own stars, so that a misalignment of a star tracker has no part.

    It fails when
    -------------
    Less than four stars are seen, or two with a star tracker, or too few to exclude a chance. The errors of the onboard
    rotation of the body (``onboard.pole_error_deg``, ``onboard.rotation_error_deg``) remain in the pose and are not in
    the covariance. So do those of the camera that are not declared (``onboard.camera_sigma``): the diagnostic
    ``stars_chi2_per_degree`` is then far above 1. Aberration of light is not in the images, and not corrected.

    Cost
    ----
    0.02 s an image of 1024 x 1024.

    Source
    ------
    Wahba's problem: Markley (1988), covariance: Shuster and Oh (1981). Lost in space: after Mortari et al. (2004).
    """

    name: ClassVar[str] = "stars"
    version: ClassVar[int] = 1
    options_model: ClassVar[type[SpecModel]] = StarOptions

    def __init__(self, camera: Camera, catalog: StarCatalog, options: StarOptions) -> None:
        self._sky, self._options = Sky.of(camera, catalog), options

    @classmethod
    def from_options(cls, options: Mapping[str, object], assets: Assets) -> Self:
        """Build from a campaign's options and the catalogue of the scenario."""
        parsed = parse_options(StarOptions, options, cls.name)
        return cls(assets.camera, assets.stars(), parsed)

    def estimate(self, observation: Observation, *, rng: np.random.Generator) -> Estimate:
        """Detect and identify stars, solve for the attitude, and update the prior with it."""
        del rng
        clock, frame, options = Stopwatch(), observation.frame, self._options
        if frame.sky is None:
            return Estimate("failed", "the image has no stars")
        with clock("detection"):
            found = detect_stars(
                frame.image, options.gain_e_per_dn, options.psf_sigma_px, options.threshold, options.most_stars
            )
            if not len(found) and found.noise_dn <= _BLACK_DN:
                return Estimate("failed", "the image is black: nothing above its background")
            declared, middle = observation.camera_sigma, [observation.camera.cx_px, observation.camera.cy_px]
            by_focal_px = declared.focal * np.linalg.norm(found.uv_px - middle, axis=1)
            sigma_px = np.sqrt(found.sigma_px**2 + options.position_sigma_px**2 + by_focal_px**2)
            seen = Detections(found.uv_px, found.flux_dn, sigma_px, found.psf_sigma_px, found.noise_dn)
        diagnostics: dict[str, float | int | str] = {"point_sources": len(seen)}
        with clock("identification"):
            tracked, sigma_rad = frame.sky.R_cam_inertial, frame.sky.sigma_rad
            prior = None if tracked is None or sigma_rad is None else (tracked, sigma_rad)
            result = identify(self._sky, seen, prior, options.false_alarm)
        if isinstance(result, str):
            return Estimate("failed", result, diagnostics=diagnostics, timings_s=clock.seconds)
        attitude = result.attitude
        pose, covariance = rotation_update(
            (frame.prior_T_cam_body, frame.prior_covariance),
            attitude.R_cam_inertial @ frame.sky.R_body_inertial.T,
            self._covariance(result, seen, found.sigma_px, declared),
        )
        degrees = 2 * len(result.stars) - 3
        diagnostics |= {
            "stars_identified": len(result.stars),
            "false_alarm": result.false_alarm,
            "stars_chi2_per_degree": attitude.chi2 / degrees,
            "psf_sigma_px": seen.psf_sigma_px,
        }
        uv, directions = seen.uv_px[result.detections], self._sky.catalog.directions[result.stars]
        predicted = self._sky.camera.project(directions @ attitude.R_cam_inertial.T)
        x, y, z = directions.T
        columns = {
            "ra_deg": np.degrees(np.arctan2(y, x)) % 360.0,
            "dec_deg": np.degrees(np.arctan2(z, np.hypot(x, y))),
            "u_px": uv[:, 0],
            "v_px": uv[:, 1],
            "residual_u_px": uv[:, 0] - predicted[:, 0],
            "residual_v_px": uv[:, 1] - predicted[:, 1],
            "sigma_px": seen.sigma_px[result.detections],
            "noise_px": found.sigma_px[result.detections],
            "magnitude": self._sky.catalog.magnitudes[result.stars],
        }
        return Estimate(
            "ok",
            pose=pose,
            covariance=covariance,
            stages=(Stage("stars", pose),),
            details={"stars": columns},
            diagnostics=diagnostics,
            timings_s=clock.seconds,
        )

    def _covariance(
        self, result: Identified, seen: Detections, noise_px: FloatArray, declared: CameraSigma
    ) -> FloatArray:
        """Covariance (3, 3), rad^2, of the attitude from stars that were weighted by ``seen.sigma_px``.

        The weights hold the declared error of the focal length as if each star had its own. It is one for all: it turns
        the attitude where the stars are on one side of the image. An error of the principal point always does.
        """
        camera, used = self._sky.camera, result.detections
        towards = self._sky.catalog.directions[result.stars] @ result.attitude.R_cam_inertial.T
        # A turn w moves a direction d by w x d = -[d]x w.
        by_turn = -np.einsum("nij,njk->nik", camera.jacobian(towards), cross_matrix(towards))
        weighted = np.swapaxes(by_turn, 1, 2) / seen.sigma_px[used, None, None] ** 2
        # Turns (3, n, 2) by the pixels' errors: (sum H^T W H)^-1 H^T W.
        influence = np.einsum("kl,nli->kni", np.linalg.inv(np.einsum("nki,nil->kl", weighted, by_turn)), weighted)
        own_px = np.hypot(noise_px[used], self._options.position_sigma_px)
        by_focal = np.einsum("kni,ni->k", influence, seen.uv_px[used] - [camera.cx_px, camera.cy_px])
        by_middle = influence.sum(axis=1)
        return np.asarray(
            np.einsum("kni,n,lni->kl", influence, own_px**2, influence)
            + declared.focal**2 * np.outer(by_focal, by_focal)
            + declared.principal_point_px**2 * by_middle @ by_middle.T
        )

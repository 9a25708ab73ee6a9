"""The pose of one image by craters alone: detection, association with the database, update of the prior."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from boresight.estimators.contract import Assets, Estimate, Stage, Stopwatch, typed_product
from boresight.estimators.craters.contract import CraterDetector, GroundModel
from boresight.estimators.craters.database.centre_errors import measure_centre_errors
from boresight.estimators.craters.database.files import CraterDatabase
from boresight.estimators.craters.database.landmarks import Landmarks
from boresight.estimators.craters.matching.association import (
    Association,
    CraterAssociationOptions,
    ExpectedCraters,
    adjust_robustly,
    associate,
    centre_noise,
)
from boresight.estimators.craters.matching.transfer import by_small_motion, occluded
from boresight.estimators.options import parse_options
from boresight.estimators.prior import calibration_in_posterior, floor_variances
from boresight.estimators.registry import crater_detector_class
from boresight.scenarios.arrays import IndexArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Ellipses, Pose, TriangleMesh, View, project_circles
from boresight.scenarios.observation import Frame, Observation
from boresight.scenarios.sequences.ground import MeshGround
from boresight.scenarios.spec.base import SpecModel, length

_PASSES = 4  # linearisations
_CONVERGED_M = 0.1

PRODUCT = "crater-database"


class CraterDatabaseOptions(SpecModel):
    """The number of images that a database is made from, and the detector."""

    images: int = Field(150, ge=2, description="Rendered images of the on-board model of the body")
    seed: int = Field(0, ge=0, description="Seed of their views")
    phase_deg: tuple[float, float] = Field((20.0, 80.0), description="Range of their phase angles")
    detector: str = Field("crater-classic", description="Name of the detector of craters")
    most_detections: int = Field(20, ge=1, description="Most detections of an image")
    association: CraterAssociationOptions = Field(
        CraterAssociationOptions(), description="Uncertainty of its detections: for matches and lines of sight"
    )
    height_sigma_m: float = length(
        30.0, "Standard deviation of the a priori shape's height under a crater", body=0.0009, gt=0
    )


class CraterPoseOptions(SpecModel):
    """Options of the pose by craters."""

    database: CraterDatabaseOptions = CraterDatabaseOptions()
    association: CraterAssociationOptions = CraterAssociationOptions(redetected=0.3)
    most_detections: int = Field(60, ge=1, description="Most detections of the image")
    emission_deg: float = Field(65.0, gt=0.0, lt=90.0, description="Largest emission angle of the landmarks sought")
    incidence_deg: float = Field(80.0, gt=0.0, lt=90.0, description="Largest incidence angle of the landmarks sought")
    least: int = Field(4, ge=1, description="Landmarks that a pose needs: fewer hardly contradict each other")


class CraterPose:
    """Updates the prior pose by the centres of the craters that it recognises in the image.

    Craters are detected and associated with those of a data base. The errors of the prior move all craters together:
    the association estimates them, is linearised again about the estimate, and gives the pose and its covariance by
    Huber's loss of the craters, with the prior. The craters of one image err together, as they have the same light: how
    much is measured in the sightings of the data base, whose poses are known. The residuals of the image tell whether
    it is noisier than those.

    Use it when
    -----------
    The surface has craters of more than about ten pixels, the image shows a part of the body, and the prior's attitude
    is known from stars.

    It fails when
    -------------
    No crater is detected, or fewer than ``least`` are recognised. In 100 images of ``trade-craters`` it failed in 5
    with ``crater-learned`` and in 18 with ``crater-classic``. If the data base has fewer than 300 sightings of craters
    that three images or more show, the craters of one image count as independent, and the covariance is too small.

    Cost
    ----
    That of its detector, and less for the association with the data base.

    Source
    ------
    Ours; detection and the data base after Cheng et al. (2003).
    """

    name: ClassVar[str] = "crater-pose"
    version: ClassVar[int] = 6
    options_model: ClassVar[type[SpecModel]] = CraterPoseOptions

    def __init__(
        self, database: CraterDatabase, shape: TriangleMesh, detector: CraterDetector, options: CraterPoseOptions
    ) -> None:
        self.landmarks = database.landmarks
        self._ground = MeshGround(shape)
        self._detector = detector
        self._options = options
        self._errors = measure_centre_errors(database, options.database.association)

    @classmethod
    def from_options(cls, options: Mapping[str, object], assets: Assets) -> Self:
        """Build from a campaign's options and its database."""
        parsed = parse_options(CraterPoseOptions, options, cls.name)
        database = typed_product(assets, PRODUCT, parsed.database, CraterDatabase, cls.name)
        detector = crater_detector_class(parsed.database.detector).from_options({})
        return cls(database, assets.shape(), detector, parsed)

    def estimate(self, observation: Observation, *, rng: np.random.Generator) -> Estimate:
        """Estimate the pose; ``rng`` is not used."""
        del rng
        frame, camera, clock = observation.frame, observation.camera, Stopwatch()
        with clock("detection"):
            rims = self._detect(frame, camera)
        if isinstance(rims, str):
            return Estimate("failed", rims, timings_s=clock.seconds)
        with clock("recognition"):
            pose, found = self.recognise(frame, camera, rims)
        if found.reason or len(found.pairs) < self._options.least:
            needed = f"{len(found.pairs)} craters recognised, {self._options.least} needed"
            return Estimate("failed", found.reason or needed, timings_s=clock.seconds)
        return Estimate(
            "ok",
            pose=pose,
            covariance=found.covariance + calibration_in_posterior(observation, pose, found.covariance),
            stages=(Stage("recognition", pose),),
            diagnostics={"n_landmarks": len(found.pairs)},
            timings_s=clock.seconds,
        )

    def recognise(self, frame: Frame, camera: Camera, rims: Ellipses) -> tuple[Pose, Association]:
        """Associate rims with the database and update the prior, linearised again until it converges."""
        prior, error = frame.prior_T_cam_body, np.zeros(6)
        area_px2 = float(camera.width_px * camera.height_px)
        for _ in range(_PASSES):
            pose = prior.perturbed(error[:3], error[3:])
            rows, expected = expected_craters(self.landmarks, self._ground, frame, camera, pose, self._options)
            # The rims are predicted with the corrected pose, from which the prior is -error away: new points of
            # linearisation do not count the prior twice.
            field = replace(expected, mean=-error)
            found = associate(field, rims, area_px2, self._options.association)
            if found.reason:
                break
            found = adjust_robustly(field, rims, found, self.landmarks.position_body_m[rows], self._errors)
            before, error = error, error + found.error
            if np.linalg.norm(error[3:] - before[3:]) < _CONVERGED_M:
                break
        return prior.perturbed(error[:3], error[3:]), found

    def _detect(self, frame: Frame, camera: Camera) -> Ellipses | str:
        """Return the rims of an image, or why there are none."""
        try:
            rims = self._detector.detect(frame, camera).ellipses
        except BoresightError as error:
            return str(error)
        return rims[: self._options.most_detections] if len(rims) else "no crater was detected in the image"


def expected_craters(
    landmarks: Landmarks, ground: GroundModel, frame: Frame, camera: Camera, pose: Pose, options: CraterPoseOptions
) -> tuple[IndexArray, ExpectedCraters]:
    """Predict the rims of the landmarks that should be visible: their rows, and the expected craters.

    The common error is that of the frame's prior pose, [rotation_rad, translation_m], linearised about ``pose``. Its
    mean is set to zero; the caller replaces it.
    """
    rows = np.flatnonzero(_possibly_visible(landmarks, frame, camera, pose, options))
    position = pose.camera_position_m
    rows = rows[~occluded(landmarks.position_body_m[rows], position, ground, 2.0 * landmarks.radius_m[rows])]
    points, normals = landmarks.position_body_m[rows], landmarks.normal_body[rows]
    view = View(camera, pose, pose.rotation.T @ frame.sun_dir_cam)
    ellipses = project_circles(view, points, normals, landmarks.radius_m[rows])
    turned = points @ pose.rotation.T
    by_point = camera.jacobian(turned + pose.translation_m)
    # The uncertainty of the landmarks is independent between craters, unlike that of the pose: derivative of the pixel
    # by the landmark in body axes.
    across = by_point @ pose.rotation
    noise = centre_noise(ellipses, options.association)
    noise = noise + across @ landmarks.covariance_m2[rows] @ np.swapaxes(across, 1, 2)
    return rows, ExpectedCraters(
        ellipses, by_point @ by_small_motion(turned), floor_variances(frame.prior_covariance), noise, np.zeros(6)
    )


def _possibly_visible(
    landmarks: Landmarks, frame: Frame, camera: Camera, pose: Pose, options: CraterPoseOptions
) -> NDArray[np.bool_]:
    """Return (n,) landmarks that face the camera and the Sun and may be in the frame given the prior's uncertainty."""
    towards = pose.camera_position_m - landmarks.position_body_m
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    sun_dir_body = pose.rotation.T @ frame.sun_dir_cam
    facing = np.einsum("ni,ni->n", towards, landmarks.normal_body) > np.cos(np.radians(options.emission_deg))
    lit = landmarks.normal_body @ sun_dir_body > np.cos(np.radians(options.incidence_deg))
    cam = pose.transform(landmarks.position_body_m)
    # Three sigma of the position in pixels: a landmark just outside the predicted frame may still be seen.
    spread_m = 3.0 * np.sqrt(np.trace(frame.prior_covariance[3:, 3:]))
    spread_px = spread_m / np.linalg.norm(pose.translation_m) / camera.pixel_angle_rad
    return np.asarray(facing & lit & (cam[:, 2] > 0.0) & camera.contains(camera.project(cam), -spread_px))

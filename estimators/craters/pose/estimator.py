"""The pose of one image by craters alone: detection, association with the data base, update of the prior."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from estimators.contract import Assets, Estimate, Stage, Stopwatch
from estimators.craters.contract import CraterDetector
from estimators.craters.database.files import CraterDatabase
from estimators.craters.matching.association import Association, associate
from estimators.craters.pose.expected import adjusted, expected_craters
from estimators.craters.pose.options import PRODUCT, CraterPoseOptions
from estimators.craters.registry import crater_detector_class
from estimators.options import parse_options
from scenarios.errors import BoresightError
from scenarios.geometry import Camera, Ellipses, Pose, TriangleMesh
from scenarios.observation import Frame, Observation
from scenarios.sequences.ground import MeshGround

FloatArray = NDArray[np.float64]

_PASSES = 4
_STILL_M = 0.1


class CraterPose:
    """Updates the prior by the centres of the craters that it recognises.

    The errors of the prior move all craters together: the association finds them (see `association`), is linearised
    anew about what it found, and gives the pose by Huber's loss of the craters, with the prior, and its covariance.
    """

    name: ClassVar[str] = "crater-pose"
    version: ClassVar[int] = 3

    def __init__(
        self, database: CraterDatabase, shape: TriangleMesh, detector: CraterDetector, options: CraterPoseOptions
    ) -> None:
        self.landmarks = database.landmarks
        self._ground = MeshGround(shape)
        self._detector = detector
        self._options = options

    @classmethod
    def from_options(cls, options: Mapping[str, object], assets: Assets) -> Self:
        """Build from a campaign's options and its data base."""
        parsed = parse_options(CraterPoseOptions, options, cls.name)
        database = assets.product(PRODUCT, parsed.database.model_dump(mode="json"))
        if not isinstance(database, CraterDatabase):
            raise BoresightError(f"{cls.name}: the product {PRODUCT!r} is a {type(database).__name__}")
        detector = crater_detector_class(parsed.database.detector).from_options({})
        return cls(database, assets.shape(), detector, parsed)

    def estimate(self, observation: Observation, *, rng: np.random.Generator) -> Estimate:
        """Estimate the pose; nothing is drawn at random."""
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
            covariance=found.covariance,
            stages=(Stage("recognition", pose),),
            diagnostics={"n_landmarks": len(found.pairs)},
            timings_s=clock.seconds,
        )

    def recognise(self, frame: Frame, camera: Camera, rims: Ellipses) -> tuple[Pose, Association]:
        """Associate rims with the data base and update the prior, linearised anew until it stands still."""
        prior, error = frame.prior_T_cam_body, np.zeros(6)
        area_px2 = float(camera.width_px * camera.height_px)
        for _ in range(_PASSES):
            pose = prior.perturbed(error[:3], error[3:])
            _, expected = expected_craters(self.landmarks, self._ground, frame, camera, pose, self._options)
            field = replace(expected, mean=-error)
            found = associate(field, rims, area_px2, self._options.association)
            if found.reason:
                break
            found = adjusted(field, rims, found)
            before, error = error, error + found.error
            if np.linalg.norm(error[3:] - before[3:]) < _STILL_M:
                break
        return prior.perturbed(error[:3], error[3:]), found

    def _detect(self, frame: Frame, camera: Camera) -> Ellipses | str:
        """Find the rims of an image, or say why there are none."""
        try:
            rims = self._detector.detect(frame, camera).ellipses
        except BoresightError as error:
            return str(error)
        return rims[: self._options.most_detections] if len(rims) else "no crater was detected in the image"

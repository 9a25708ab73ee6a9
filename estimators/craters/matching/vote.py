"""Matching with the a priori shape: an association of predicted craters that estimates the errors of both poses."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np

from boresight.estimators.craters.contract import CraterImage, CraterMatches, GroundModel, too_few_craters
from boresight.estimators.craters.matching.association import (
    Association,
    CraterAssociationOptions,
    ExpectedCraters,
    associate,
    centre_noise,
)
from boresight.estimators.craters.matching.transfer import joint_covariance, locate_craters, transfer_craters
from boresight.estimators.options import Configured
from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.spec.base import SpecModel, length

_PASSES = 3  # linearisations
_MIN_PAIRS_TO_CORRECT = 3  # fewer pairs do not determine the errors of the poses


class VoteOptions(SpecModel):
    """Options of the vote."""

    association: CraterAssociationOptions = CraterAssociationOptions()
    height_sigma_m: float = length(
        30.0, "Uncertainty of the a priori shape's height under a crater", body=0.0009, ge=0.0
    )


class VoteMatcher(Configured[VoteOptions]):
    """Predicts the craters of one image in the other by the shape, and estimates the poses' errors with the matches.

    No pixels are compared, so that the directions of the Sun may differ by any angle, and the craters need not lie in a
    plane.

    Use it when
    -----------
    An a priori shape and prior poses with covariances are known: the usual choice.

    It fails when
    -------------
    No crater is expected in the second image, none is detected, or no match is sure.

    Cost
    ----
    0.035 s a pair of ``eros-crater-pairs``, about 20 detections an image.

    Source
    ------
    Ours.
    """

    name: ClassVar[str] = "vote"
    version: ClassVar[int] = 1
    options_model = VoteOptions

    def match(self, first: CraterImage, second: CraterImage, ground: GroundModel) -> CraterMatches:
        """Match by place, size and shape."""
        if reason := too_few_craters(first, second):
            return CraterMatches.none(reason)
        # The errors of both poses, [rotation_rad, translation_m] each; the shape and its projection are not linear in
        # them.
        error = np.zeros(12)
        for _ in range(_PASSES):
            rows, found = self._associated(first, second, ground, error)
            if found.reason or len(found.pairs) < _MIN_PAIRS_TO_CORRECT:
                break
            error = found.error
        if found.reason:
            return CraterMatches.none(found.reason)
        return CraterMatches(np.column_stack([rows[found.pairs[:, 0]], found.pairs[:, 1]]), found.probability)

    def _associated(
        self, first: CraterImage, second: CraterImage, ground: GroundModel, error: FloatArray
    ) -> tuple[IndexArray, Association]:
        """Predict with poses corrected by an estimate of their errors, and associate; also return the predicted rows.

        The estimate only changes the point of linearisation: the prior of the errors stays the same.
        """
        options, covariance = self.options, joint_covariance(first, second)
        one, other = with_pose_error(first, error[:6]), with_pose_error(second, error[6:])
        expected = transfer_craters(one, other, locate_craters(one, ground), ground)
        noise = centre_noise(expected.ellipses, options.association)
        # Heights under different craters are taken as independent; the errors of the poses are common to all.
        noise += options.height_sigma_m**2 * np.einsum("ni,nj->nij", expected.by_height, expected.by_height)
        # The prior is -error away from the corrected poses, so that each pass uses it once.
        field = ExpectedCraters(expected.ellipses, expected.by_error, covariance, noise, -error)
        area_px2 = float(second.camera.width_px * second.camera.height_px)
        found = associate(field, second.detections.ellipses, area_px2, options.association)
        return expected.rows, replace(found, error=error + found.error)


def with_pose_error(image: CraterImage, error: FloatArray) -> CraterImage:
    """Return an image whose prior pose is corrected by its error, (6,) [rotation_rad, translation_m]."""
    pose = image.frame.prior_T_cam_body.perturbed(error[:3], error[3:])
    return replace(image, frame=replace(image.frame, prior_T_cam_body=pose))

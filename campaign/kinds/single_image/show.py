"""What trials of single images show of themselves."""

from __future__ import annotations

import numpy as np

from campaign.inspection.case import Case
from campaign.inspection.posed import PosedFrame, PosedFrames
from campaign.inspection.show import Kept, Show, listed, plain, plain_pose
from campaign.kinds.single_image.draw import draw_single
from campaign.kinds.single_image.examples import fit_figures
from campaign.kinds.single_image.look import look_at_images
from campaign.kinds.single_image.trial import EstimatedImage
from estimators.contract import Estimate


def kept(shown: object) -> Kept:
    """Return the image that an estimator saw, and its estimate; none of one that raised."""
    if not isinstance(shown, EstimatedImage):
        return Kept()
    image = {"image": shown.observation.frame.image}
    return Kept(image, None if shown.estimate is None else _estimate(shown.estimate))


def _estimate(estimate: Estimate) -> dict[str, object]:
    return {
        "status": estimate.status,
        "reason": estimate.reason,
        "pose": None if estimate.pose is None else plain_pose(estimate.pose),
        "covariance": listed(estimate.covariance),
        "stages": {stage.name: plain_pose(stage.T_cam_body) for stage in estimate.stages},
        "diagnostics": {name: plain(value) for name, value in estimate.diagnostics.items()},
        "details": {
            name: {column: np.asarray(values).tolist() for column, values in table.items()}
            for name, table in estimate.details.items()
        },
    }


def posed(shown: object, case: Case) -> PosedFrames | None:
    """Return an estimated image as a frame; no frame where there is no estimate."""
    if not isinstance(shown, EstimatedImage):
        return None
    camera, estimate = shown.observation.camera, shown.estimate
    if estimate is None or estimate.status != "ok" or estimate.pose is None:
        return PosedFrames(camera, [], {})
    frame, table = shown.observation.frame, estimate.details.get("landmarks")
    numbers, uv, places = np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros((0, 3))
    if table is not None and len(table["landmark"]):
        numbers = np.asarray(table["landmark"], dtype=np.int64)
        uv, places = (
            np.column_stack([np.asarray(table[name], dtype=np.float64) for name in names])
            for names in (("u_px", "v_px"), ("x_m", "y_m", "z_m"))
        )
    one = PosedFrame(
        shown.sight.image_name or f"{case.trial:07d}.tiff",
        frame.time_s if shown.sight.image_name else float(case.trial),
        shown.sight.view.T_cam_body,
        estimate.pose,
        numbers,
        uv,
    )
    return PosedFrames(camera, [one], dict(zip(numbers.tolist(), places, strict=True)))


SHOW = Show(draw=draw_single, kept=kept, look=look_at_images, examples=fit_figures, posed=posed, pooled=True)

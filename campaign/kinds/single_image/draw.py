"""What is drawn of a single image: its body at prior, estimate and truth, and what was recognised in it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from campaign.inspection.recompute import Recomputed
from campaign.inspection.show import Drawn
from campaign.kinds.single_image.examples import SecondLook, alignment_of, fit_of, recognised_again
from campaign.kinds.single_image.trial import EstimatedImage, SingleImage
from campaign.trial.in_turn import part_of
from campaign.trial.kind import Record
from estimators.contract import Estimate
from estimators.landmark.recognizer import LandmarkRecognizer
from renderers.mitsuba3 import BodyRenderer
from reports.figures.fit import draw_alignment_panels, draw_fit_panels
from reports.figures.posed import PosedLook, draw_posed
from reports.figures.recognised import Recognised, draw_recognised
from reports.schema.named_figure import NamedFigure
from scenarios.errors import BoresightError
from scenarios.geometry import Camera, Pose, View

FloatArray = NDArray[np.float64]


def draw_single(again: Recomputed) -> Drawn | None:
    """Draw the stages of one image, as far as they came."""
    shown, what = again.shown, str(again.case)
    experiment = part_of(again.trials, SingleImage, again.case.trial)
    if not isinstance(shown, EstimatedImage) or experiment is None:
        return None
    credit = experiment.world.scenario.spec.images
    lines = [credit.credit] if credit is not None and credit.credit else []
    figures = [_posed(experiment, shown, what, lines)]
    figures += list(_recognition(experiment, shown, what, lines))
    found = _recognised(shown, again.records.get("landmarks", []))
    if found is not None:
        figures.append(_matches(shown, found, what, lines))
    return Drawn(figures, lines)


def _posed(experiment: SingleImage, shown: EstimatedImage, what: str, lines: list[str]) -> NamedFigure:
    """Draw the body at the prior, at the estimate and at the truth."""
    frame, camera = shown.observation.frame, shown.observation.camera
    image = frame.image.astype(np.float64)
    truth = shown.sight.view.T_cam_body
    poses = {"prior": ("prior", frame.prior_T_cam_body)}
    reached = _reached(shown.estimate)
    if reached is not None:
        poses["estimate"] = reached
    poses["truth"] = ("truth", truth)
    looks, none = [], "" if reached is not None else " There is no estimate, and no stage had a pose."
    for name, pose in poses.items():
        try:
            looks.append(_look(experiment.world.renderer, camera, frame.sun_dir_cam, image, (name, *pose)))
        except BoresightError as error:  # an estimate may stand within the body
            none += f" Nothing can be rendered at the {pose[0]}: {error}."
    return NamedFigure(
        "poses",
        draw_posed(image, looks, what, lines),
        f"{what}. Above, the outline of the true body at the prior, at the estimate and at the truth. Below, the image"
        f" less a rendering of it there, scaled to the image; at the truth only noise and the lens are left.{none}",
        "The image with the outline of the body at each pose, and below it what a rendering leaves of the image.",
    )


def _reached(estimate: Estimate | None) -> tuple[str, Pose] | None:
    """Return the estimate, or the last pose on the way to none, with its heading."""
    if estimate is None:
        return None
    if estimate.status == "ok" and estimate.pose is not None:
        return "estimate", estimate.pose
    if estimate.stages:
        last = estimate.stages[-1]
        return f"no estimate: after {last.name}", last.T_cam_body
    return None


def _look(
    renderer: BodyRenderer, camera: Camera, sun_dir_cam: FloatArray, image: FloatArray, posed: tuple[str, str, Pose]
) -> PosedLook:
    """Render the true body at a pose; the Sun stands still in the camera, as it is known to."""
    name, heading, T_cam_body = posed
    view = View(camera, T_cam_body, sun_dir_cam @ T_cam_body.rotation)
    rows, columns = np.mgrid[: camera.height_px, : camera.width_px] + 0.5
    body = renderer.surface(view, np.column_stack([columns.ravel(), rows.ravel()])).hit.reshape(image.shape)
    rendered = renderer.render(view).astype(np.float64)
    design = np.column_stack([rendered.ravel(), np.ones(rendered.size)])
    scale, offset = np.linalg.lstsq(design, image.ravel())[0]
    return PosedLook(name, heading, body, image - scale * rendered - offset)


def _recognition(experiment: SingleImage, shown: EstimatedImage, what: str, lines: list[str]) -> Iterator[NamedFigure]:
    """Draw the paper's figure 8 of a landmark recogniser, or its figure 3 where it failed after the alignment."""
    (estimator,) = experiment.estimators.values()
    if not isinstance(estimator, LandmarkRecognizer) or shown.estimate is None:
        return
    look: SecondLook = recognised_again(estimator, shown.observation, shown.sight.image_name)
    fit, aligned = fit_of(look), alignment_of(look)
    alt = "Three images of the body: with the mesh misplaced, the rendered mesh, and with the mesh in place."
    before = (
        "Left, the prior: mesh of the data base, 6-sigma search ellipses and both brightness centroids."
        " Middle, the mesh rendered for the first iteration."
    )
    if fit is not None:
        yield NamedFigure(
            "fit", draw_fit_panels(fit, what, lines), f"{what}. {before} Right, the last fit with the corners.", alt
        )
    elif aligned is not None:
        ended = f" Recognition ended there: {look.found.failure}." if look.found.failure else ""
        caption = f"{what}. {before} Right, after the alignment.{ended}"
        yield NamedFigure("alignment", draw_alignment_panels(aligned, what, lines), caption, alt)


def _recognised(shown: EstimatedImage, scored: list[Record]) -> Recognised | None:
    """Collect recognised landmarks before the camera with their true errors; None where there are none."""
    estimate = shown.estimate
    table = None if estimate is None else estimate.details.get("landmarks")
    if estimate is None or table is None or estimate.pose is None or len(table["landmark"]) == 0:
        return None
    places = np.column_stack([np.asarray(table[name], dtype=np.float64) for name in ("x_m", "y_m", "z_m")])
    seen = np.column_stack([np.asarray(table[name], dtype=np.float64) for name in ("u_px", "v_px")])
    predicted = shown.observation.camera.project(estimate.pose.transform(places))
    errors = np.array([np.nan if record["error_m"] is None else float(str(record["error_m"])) for record in scored])
    ahead = np.isfinite(predicted).all(axis=1)
    return Recognised(seen[ahead], predicted[ahead], errors[ahead]) if ahead.any() else None


def _matches(shown: EstimatedImage, found: Recognised, what: str, lines: list[str]) -> NamedFigure:
    return NamedFigure(
        "matches",
        draw_recognised(shown.observation.frame.image, found, what, lines),
        f"{what}. Left, recognised landmarks where the estimate projects them, with magnified residuals. Middle, the"
        " residuals. Right, each residual over the true distance between the landmark and the surface point that was"
        " taken for it: far to the right and low is a wrong match that the fit has swallowed.",
        "Arrows over the image, a scatter of residuals, and residuals over true errors.",
    )

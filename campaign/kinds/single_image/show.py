"""The displays of single images."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from boresight.campaign.imaging.credits import credit_lines
from boresight.campaign.imaging.observe import observe
from boresight.campaign.inspection.recompute import Case, Recomputed
from boresight.campaign.inspection.show import (
    CaseFigures,
    CaseFiles,
    EstimatorRun,
    PosedFrame,
    PosedFrames,
    Show,
    camera_scale,
    camera_sets,
    coarsened,
    finite_or_dash,
)
from boresight.campaign.kinds.single_image import EstimatedImage, SingleImage
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.runs.execute import opened
from boresight.campaign.store import RunFolder
from boresight.campaign.trial.kind import Record
from boresight.estimators.contract import Estimate
from boresight.estimators.craters.database.landmarks import Landmarks
from boresight.estimators.craters.pose import CraterPose
from boresight.estimators.landmark.database import LandmarkDatabase
from boresight.estimators.landmark.projection import project_landmarks, visible_landmarks
from boresight.estimators.landmark.recognizer import LandmarkRecognizer, Recognition
from boresight.renderers.mitsuba3 import BodyRenderer, outlines_m
from boresight.renderers.mitsuba3.rays import body_window
from boresight.reports.figures.named import NamedFigure, file_stem
from boresight.reports.figures.recognition import (
    FitPanels,
    MatchedLandmarks,
    Overlay,
    PoseRendering,
    draw_fit_panels,
    draw_matched_landmarks,
    draw_pose_renderings,
)
from boresight.reports.pages.view3d import PointSet, View3D
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Pose, TriangleMesh, View
from boresight.scenarios.observation import Observation


@dataclass(frozen=True, slots=True, eq=False)
class SecondLook:
    """A trial of a landmark recogniser, worked out again from its seed, with the intermediate results.

    ``image_name`` is the file name of a real image, or ''.
    """

    observation: Observation
    image_name: str
    database: LandmarkDatabase
    found: Recognition


def second_look(campaign: ResolvedCampaign, folder: RunFolder, case: Case) -> SecondLook | None:
    """Recognise the landmarks of a case again; None where the estimator is no landmark recogniser."""
    trials: SingleImage = opened(campaign, case.scenario, folder.path, case.trial)
    estimator = trials.methods[case.estimator]
    if not isinstance(estimator, LandmarkRecognizer):
        return None
    trial_image = trials.world.source.trial_image(trials.seed, case.trial)
    observation = observe(trials.world, trial_image, trials.seed, case.trial)
    found = estimator.recognise(observation.frame, observation.camera)
    return SecondLook(observation, trial_image.image_name, estimator.database, found)


def fit_figures(campaign: ResolvedCampaign, folder: RunFolder) -> Iterator[NamedFigure]:
    """Draw a typical trial of every scenario and landmark recogniser: the one of median position error.

    The scenarios of a grid are many and look alike: the first stands for them.
    """
    rows = folder.table("rows")
    for scenario in campaign.scenarios[: None if campaign.spec.grid is None else 1]:
        for label in campaign.labels:
            mine = rows[(rows["scenario"] == scenario.spec.name) & (rows["estimator"] == label)]
            trial = median_trial(mine)
            look = None if trial is None else second_look(campaign, folder, Case(scenario.spec.name, label, trial))
            fit = fit_of(look) if look else None
            if look is None or fit is None or trial is None:
                continue
            what = f"{scenario.spec.name}, {label}, trial {trial} {look.image_name}".strip()
            stem = file_stem("fit", scenario.spec.name, label, str(trial))
            yield NamedFigure(
                stem,
                draw_fit_panels(fit, what, credit_lines(scenario.spec)),
                f"{what}: the trial of median position error. Left, the prior pose: mesh of the data base, 6-sigma"
                " search ellipses and both brightness centroids. Middle, the mesh rendered for the first iteration."
                " Right, the converged fit with the corners of the image.",
                "Three images of the body: with the mesh misplaced, the rendered mesh, and with the mesh in place.",
            )


def median_trial(rows: pd.DataFrame) -> int | None:
    """Return the solved trial whose position error is the median (the lower one of two); None without any."""
    solved = rows[rows["status"] == "ok"].sort_values(["position_error_m", "trial"])
    return None if solved.empty else int(solved.iloc[(len(solved) - 1) // 2]["trial"])


def fit_of(look: SecondLook) -> FitPanels | None:
    """Collect what the figure of a fit shows; None where the recognition failed before its end."""
    found = look.found
    if not found.alignment.steps or found.corners is None or found.solution is None or found.solution.fit is None:
        return None
    matched = np.zeros(len(found.corners), dtype=np.bool_)
    matched[found.solution.rounds[-1].matches.corner] = True
    return _fit(look, found.solution.fit.T_cam_body, found.corners.uv_px, matched)


def alignment_of(look: SecondLook) -> FitPanels | None:
    """Collect what the figure of an alignment shows; None where there was none."""
    if not look.found.alignment.steps:
        return None
    return _fit(look, look.found.alignment.T_cam_body, np.empty((0, 2)), np.empty(0, dtype=np.bool_))


def _fit(look: SecondLook, after: Pose, corners_px: NDArray[np.float64], matched: NDArray[np.bool_]) -> FitPanels:
    first, camera = look.found.alignment.steps[0], look.observation.camera
    return FitPanels(
        image=look.observation.frame.image,
        mesh_image=first.rendered,
        before=overlay(look.database, camera, look.found.prior),
        after=overlay(look.database, camera, after),
        observed_centroid_px=first.observed_px,
        rendered_centroid_px=first.rendered_px,
        corners_px=corners_px,
        matched=matched,
    )


def overlay(database: LandmarkDatabase, camera: Camera, T_cam_body: Pose) -> Overlay:
    """Project a data base as it is drawn: visible landmarks with covariances, and the edges that face the camera."""
    mesh = database.mesh()
    projection = project_landmarks(database, camera, T_cam_body)
    visible = visible_landmarks(mesh, camera, T_cam_body)
    return Overlay(
        projection.uv_px[visible], projection.covariances_px2[visible], _facing_edges(mesh, camera, T_cam_body)
    )


def _facing_edges(mesh: TriangleMesh, camera: Camera, T_cam_body: Pose) -> NDArray[np.float64]:
    """Return the ends (m, 2, 2) of the edges of facets that face the camera."""
    to_camera = T_cam_body.camera_position_m - mesh.vertices_m[mesh.faces[:, 0]]
    facing = mesh.faces[np.einsum("fi,fi->f", mesh.normals, to_camera) > 0.0]
    edges = np.unique(np.sort(facing[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    ends: NDArray[np.float64] = camera.project(T_cam_body.transform(mesh.vertices_m))[edges]
    return ends


def draw_single(again: Recomputed) -> CaseFigures:
    """Draw the stages of one image, as far as they came."""
    shown, experiment, what = again.shown, again.trials, str(again.case)
    lines = credit_lines(experiment.world.scenario.spec)

    def figures() -> Iterator[NamedFigure]:
        yield _posed(experiment, shown, what, lines)
        yield from _recognition(experiment, shown, what, lines)
        found = _recognised(shown, again.records.get("landmarks", []))
        if found is not None:
            yield NamedFigure(
                "matches",
                draw_matched_landmarks(shown.observation.frame.image, found, what, lines),
                f"{what}. Left, recognised landmarks where the estimate projects them, with magnified residuals."
                " Middle, the residuals. Right, each residual over the true distance between the landmark and the"
                " surface point that was taken for it: far to the right and low is a wrong match that the fit has"
                " swallowed.",
                "Arrows over the image, a scatter of residuals, and residuals over true errors.",
            )

    return CaseFigures(figures(), lines)


def _posed(experiment: SingleImage, shown: EstimatedImage, what: str, lines: list[str]) -> NamedFigure:
    """Draw the body at the prior, at the estimate and at the truth."""
    frame, camera = shown.observation.frame, shown.observation.camera
    image = frame.image.astype(np.float64)
    truth, true_view = shown.truth.T_cam_body, replace(shown.truth, camera=camera)
    poses = {"prior": ("prior", frame.prior_T_cam_body)}
    reached = _reached(shown.estimate)
    if reached is not None:
        poses["estimate"] = reached
    poses["truth"] = ("truth", truth)
    looks, none = [], "" if reached is not None else " There is no estimate, and no stage had a pose."
    for name, pose in poses.items():
        try:
            looks.append(_look(experiment.world.renderer, true_view, frame.sun_dir_cam, image, (name, *pose)))
        except BoresightError as error:  # an estimate may stand within the body
            none += f" Nothing can be rendered at the {pose[0]}: {error}."
    return NamedFigure(
        "poses",
        draw_pose_renderings(image, looks, what, lines),
        f"{what}. Above, the outline of the true body at the prior, at the estimate and at the truth. Below, the image"
        " less a rendering of it there, scaled to the image; at the truth only noise, blur and the lens are left."
        f"{none}",
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
    renderer: BodyRenderer, truth: View, sun_dir_cam: FloatArray, image: FloatArray, posed: tuple[str, str, Pose]
) -> PoseRendering:
    """Render the true bodies at a pose, with the known direction of the Sun in the camera."""
    name, heading, T_cam_body = posed
    view = replace(truth, T_cam_body=T_cam_body, sun_dir_body=sun_dir_cam @ T_cam_body.rotation)
    body, windows = np.zeros(image.shape, dtype=np.bool_), [body_window(view, o) for o in outlines_m(renderer, view)]
    for window in filter(None, windows):
        rows, columns = np.mgrid[window.slices] + 0.5
        hit = renderer.surface(view, np.column_stack([columns.ravel(), rows.ravel()])).hit
        body[window.slices] = hit.reshape(rows.shape)
    rendered = renderer.render(view).astype(np.float64)
    design = np.column_stack([rendered.ravel(), np.ones(rendered.size)])
    scale, offset = np.linalg.lstsq(design, image.ravel())[0]
    return PoseRendering(name, heading, body, image - scale * rendered - offset)


def _recognition(experiment: SingleImage, shown: EstimatedImage, what: str, lines: list[str]) -> Iterator[NamedFigure]:
    """Draw the paper's figure 8 of a landmark recogniser, or its figure 3 where it failed after the alignment."""
    (estimator,) = experiment.methods.values()
    if not isinstance(estimator, LandmarkRecognizer) or shown.estimate is None:
        return
    recognised = estimator.recognise(shown.observation.frame, shown.observation.camera)
    look = SecondLook(shown.observation, shown.image_name, estimator.database, recognised)
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
        yield NamedFigure("alignment", draw_fit_panels(aligned, what, lines, aligned=True), caption, alt)


def _recognised(shown: EstimatedImage, scored: list[Record]) -> MatchedLandmarks | None:
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
    return MatchedLandmarks(seen[ahead], predicted[ahead], errors[ahead]) if ahead.any() else None


def look_at_images(scene: EstimatorRun) -> View3D:
    """Show the landmarks of the first data base and the cameras of all its trials."""
    run, experiment = scene.run, cast("SingleImage", scene.opened())
    tables = (run.of(scene.scenario, scene.label, name) for name in ("rows", "landmarks"))
    rows, recognised = (table[table["trial"] % scene.campaign.spec.databases == 0] for table in tables)
    views = {int(t): experiment.world.source.view(experiment.seed, int(t)) for t in rows["trial"]}
    body = coarsened(experiment.world.body.mesh)
    places = {trial: view.T_cam_body.camera_position_m for trial, view in views.items()}
    factor, told = camera_scale(np.array(list(places.values())), body.radius_m)
    marks = _marks(experiment.methods[scene.label], list(views.values()), recognised)
    errors = rows["position_error_m"].to_numpy(dtype=np.float64)
    middle = rows["position_error_m"].median()
    note = f"{len(rows)} trials. Good and bad: below and above the median error of {middle:.3g} m.{told}"
    cameras = camera_sets(rows, errors, "error {:.3g} m".format, lambda trial: places[trial] / factor)
    return View3D(scene.title, note, body.vertices_m, body.faces, marks, cameras)


def _marks(estimator: object, views: Sequence[View], recognised: pd.DataFrame) -> list[PointSet]:
    """Colour the landmarks that an estimator has, or the craters of its data base; others have places of neither."""
    if isinstance(estimator, CraterPose):
        return [crater_marks(estimator.landmarks)]
    database = getattr(estimator, "database", None)
    if not isinstance(database, LandmarkDatabase):
        return []
    mesh, seen = database.mesh(), np.zeros(len(database))
    for view in views:
        seen += visible_landmarks(mesh, view.camera, view.T_cam_body)
    return landmark_marks(database.means_m, seen, recognised)


def crater_marks(craters: Landmarks) -> PointSet:
    """Colour the craters of a data base by the images that they were found in, of which it was made."""
    sigma_m = np.sqrt(np.trace(craters.covariance_m2, axis1=1, axis2=2))
    texts = [
        f"crater {number}<br>{2.0 * radius:.3g} m across<br>in {images} images of the data base<br>sigma {sigma:.3g} m"
        for number, radius, images, sigma in zip(craters.number, craters.radius_m, craters.images, sigma_m, strict=True)
    ]
    return PointSet("images of the data base", craters.position_body_m, craters.images.astype(float), texts, "")


def landmark_marks(places_m: FloatArray, in_view: FloatArray, recognised: pd.DataFrame) -> list[PointSet]:
    """Colour landmarks (N, 3) by how often they are recognised and by how far they then are from what is seen.

    ``in_view`` (N,) counts the trials in which each is in view; ``recognised`` are rows of the stored table
    ``landmarks``.
    """
    numbers = np.arange(len(places_m))
    times = recognised.groupby("landmark").size().reindex(numbers).fillna(0).to_numpy(dtype=np.float64)
    error = recognised.groupby("landmark")["error_m"].median().reindex(numbers).to_numpy(dtype=np.float64)
    # Recognised where the mesh says that it is hidden: the mesh is coarse, and so is the share.
    share = np.where(in_view > 0, 100.0 * np.minimum(times / np.maximum(in_view, 1.0), 1.0), np.nan)
    texts = [
        f"landmark {i}<br>in view in {in_view[i]:.0f} trials, recognised in {times[i]:.0f}"
        f"<br>median error {finite_or_dash(error[i], 'm')}"
        for i in numbers
    ]
    return [
        PointSet("recognised when in view", places_m, share, texts, "%"),
        PointSet("median landmark error", places_m, error, texts, "m"),
    ]


def kept(shown: EstimatedImage) -> CaseFiles:
    """Return the image that an estimator saw, and its estimate; none of one that raised."""
    image = {"image": shown.observation.frame.image}
    return CaseFiles(image, None if shown.estimate is None else _estimate(shown.estimate))


def _estimate(estimate: Estimate) -> dict[str, object]:
    return {
        "status": estimate.status,
        "reason": estimate.reason,
        "pose": None if estimate.pose is None else _plain(estimate.pose),
        "covariance": None if estimate.covariance is None else estimate.covariance.tolist(),
        "stages": {stage.name: _plain(stage.T_cam_body) for stage in estimate.stages},
        "diagnostics": {
            name: value if isinstance(value, str) else float(value) for name, value in estimate.diagnostics.items()
        },
        "details": {
            name: {column: np.asarray(values).tolist() for column, values in table.items()}
            for name, table in estimate.details.items()
        },
    }


def _plain(pose: Pose) -> dict[str, object]:
    """Return a pose in plain values."""
    return {"T_cam_body_quat_wxyz": pose.quat_wxyz.tolist(), "T_cam_body_translation_m": pose.translation_m.tolist()}


def posed(shown: EstimatedImage, case: Case) -> PosedFrames:
    """Return an estimated image as a frame; no frame where there is no estimate."""
    del case
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
        shown.image_name,
        frame.time_s,
        shown.truth.T_cam_body,
        estimate.pose,
        numbers,
        uv,
        frame.sun_dir_cam,
        estimate.covariance,
    )
    return PosedFrames(camera, [one], dict(zip(numbers.tolist(), places, strict=True)))


SHOW = Show(draw=draw_single, kept=kept, look=look_at_images, examples=fit_figures, posed=posed, pooled=True)

"""The ten figures of Rowell et al. (2015), from the newest finished runs of its campaigns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from boresight.campaign.imaging.credits import credit_lines
from boresight.campaign.imaging.ranges import typical_range_m
from boresight.campaign.imaging.world import World, open_world
from boresight.campaign.inspection.recompute import Case
from boresight.campaign.kinds.landmark_database import DatabaseTrials
from boresight.campaign.kinds.single_image.show import (
    SecondLook,
    alignment_of,
    fit_of,
    median_trial,
    second_look,
)
from boresight.campaign.papers.page import FinishedRun, Paper, PaperFigure
from boresight.campaign.products.landmark_database import KIND as DATABASE
from boresight.campaign.products.landmark_database import landmark_candidates
from boresight.campaign.threads import workers
from boresight.estimators.landmark.clustering import PointCluster
from boresight.estimators.landmark.database import (
    DatabaseOptions,
    LandmarkDatabase,
    LandmarkDatabaseBuild,
    build_database,
)
from boresight.reports.figures.named import NamedFigure
from boresight.reports.figures.pose import (
    ClusterView,
    SurfaceView,
    draw_centroid_offsets,
    draw_clusters,
    draw_count_comparison,
    draw_method_errors,
    draw_triangulation,
)
from boresight.reports.figures.recognition import draw_fit_panels
from boresight.reports.kinds.designs import design_grids
from boresight.reports.kinds.single_image import (
    centroid_offsets,
    landmark_figures,
    mesh_variants,
    pose_figure,
    sensitivity_grid,
)
from boresight.reports.published import load_published
from boresight.reports.schema.grid import Grid
from boresight.reports.schema.records import count_of
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import View, look_at

RECOGNISER = "landmark-harris"
_SENSITIVITY = ("rowell2015-sensitivity", "rowell2015-sensitivity-sun")

_SIGNIFICANT_PHASE_DEG = 40.0
_PHASE_DEG = 35.0
# A candidate is on the near side if the visible surface at its pixel is within this distance.
_NEAR_M = 3.0
_NORMAL_SHARE = 0.06
_FIGURE_5 = {
    "damping factor fixed at 1, 20 iterations": {
        "non-linear-fixed": "non-linear only",
        "closed-form": "closed form only",
        "both-fixed": "both",
    },
    "adaptive damping, to convergence": {
        "non-linear-quaternion": "non-linear only",
        "closed-form": "closed form only",
        "both-quaternion": "both",
        "non-linear-minimal": "non-linear only, minimal",
    },
}


@lru_cache(maxsize=1)
def _rebuilt(run: FinishedRun, jobs: int | None) -> tuple[World, LandmarkDatabaseBuild, View, str]:
    """Rebuild the data base of a run's first trial, which figures 1 and 2 share, for a view of the body."""
    campaign = run.campaign()
    scenario = campaign.scenarios[0]
    entry = DatabaseTrials.entries(campaign, scenario)[0]
    options = DatabaseOptions.model_validate(dict(entry.options))
    options = options.model_copy(update={"seed": options.seed + campaign.seed})
    world = open_world(scenario, campaign.variant)
    built = built_again(world, options, workers(jobs, campaign.variant), campaign.variant)
    return world, built, broadside_view(world, typical_range_m(scenario)), scenario.spec.name


def _figure_1(run: FinishedRun, jobs: int | None) -> Iterator[NamedFigure]:
    world, built, view, name = _rebuilt(run, jobs)
    title = f"Landmarks out of a cloud of {len(built.points_m)} candidates, {name}"
    yield NamedFigure(
        "",
        draw_clusters(cluster_view(world, built, view), title),
        f"Extracting landmarks from the initial cloud of points, {name}: (a) points of seed clusters, a colour for"
        " each cluster; (b) points of merged clusters, which are the landmarks; (c) the body. All as seen along its"
        " shortest axis, points on the near side only.",
        "Coloured points of seed clusters, those of merged clusters, and an image of the body.",
    )


def _figure_2(run: FinishedRun, jobs: int | None) -> Iterator[NamedFigure]:
    _, built, view, name = _rebuilt(run, jobs)
    title = f"Surface through {len(built.database)} landmarks, {name}"
    yield NamedFigure(
        "",
        draw_triangulation(surface_view(built.database, view), title),
        f"Extracting a surface mesh, {name}: (a) all edges of the Delaunay triangulation of the landmarks, which"
        " fill their convex hull; (b) the concave hull; (c) its outward normals, each from the centre of its facet.",
        "A triangulation of points, the shaded surface mesh, and the mesh with its normals.",
    )


def _figure_3(run: FinishedRun) -> Iterator[NamedFigure]:
    label = run.labels(RECOGNISER)[0]
    rows = run.content.run.rows
    shaded = rows[(rows["phase_deg"] >= _SIGNIFICANT_PHASE_DEG) & (rows["estimator"] == label)]
    prior = shaded.assign(position_error_m=shaded["prior_position_error_m"])
    look, what, credits_ = _look(run, label, prior)
    fit = alignment_of(look)
    if fit is None:
        raise BoresightError(f"{run.folder.path}: the trial of figure 3 has no alignment")
    yield NamedFigure(
        "",
        draw_fit_panels(fit, what, credits_, aligned=True),
        f"Data base and body fitted by the brightness centroid, {what}: (a) the prior pose, with the 6-sigma search"
        " ellipses and both centroids; (b) the mesh rendered for the first iteration; (c) after the alignment. The"
        f" trial of median prior error among those of a phase angle above {_SIGNIFICANT_PHASE_DEG:g} deg.",
        "The body with the mesh misplaced, the rendered mesh, and the body with the mesh shifted into place.",
    )


def _figure_4(run: FinishedRun) -> Iterator[NamedFigure]:
    found = centroid_offsets(run.content.run, run.labels("centroid")[0])
    order = [scenario["name"] for scenario in run.manifest["identity"]["scenarios"]]
    offsets = {name.removeprefix("itokawa-2km-"): found[name] for name in order if name in found}
    yield NamedFigure(
        "",
        draw_centroid_offsets(offsets, "Offset of the brightness centroid: full model minus landmark mesh in Lambert"),
        "Deviation of the brightness centroid between an image of the full model, in the reflectance function above"
        " each panel, and one of the mesh in Lambert's, from the same viewpoint; ellipses: one standard deviation"
        " of the sample.",
        "Scatter of centroid offsets in panels of equal axes, one for each reflectance function.",
    )


def _figure_5(run: FinishedRun) -> Iterator[NamedFigure]:
    data = run.content.run
    scenario, have = data.pairs()[0][0], {label for _, label in data.pairs()}
    groups = {
        title: {name: data.of(scenario, label) for label, name in labels.items() if label in have}
        for title, labels in _FIGURE_5.items()
    }
    n = len(data.rows[["scenario", "trial"]].drop_duplicates())
    yield NamedFigure(
        "",
        draw_method_errors(
            {title: methods for title, methods in groups.items() if methods},
            f"Pose solvers on ten landmarks drawn from their covariances, {count_of(n, 'trial')}",
        ),
        "Comparison of pose estimation methods on drawn landmarks, normalised to frequency per degree and per metre."
        " Above, the damping factor of equation (24) is held at 1 for 20 iterations; below, it adapts and the iteration"
        " runs to its end. The paper does not say which it used. Minimal: six parameters in place of the seven with a"
        " quaternion.",
        "Histograms of attitude and position error of the pose solvers, in two rows.",
    )


def _figure_7(run: FinishedRun) -> Iterator[NamedFigure]:
    label = run.labels(RECOGNISER)[0]
    figures = landmark_figures(run.content, _scenario(run, label), label)
    yield from (figure for figure in figures if figure.stem.startswith("landmark_errors"))


def _figure_8(run: FinishedRun) -> Iterator[NamedFigure]:
    look, what, credits_ = _look(run, run.labels(RECOGNISER)[0], run.content.run.rows)
    fit = fit_of(look)
    if fit is None:
        raise BoresightError(f"{run.folder.path}: the trial of figure 8 has no fit")
    yield NamedFigure(
        "",
        draw_fit_panels(fit, what, credits_),
        f"One test of {run.manifest['name']}, {what}, the trial of median position error: (a) the prior pose, with"
        " the 6-sigma search ellipses and both brightness centroids; (b) the mesh rendered for the first iteration;"
        " (c) the converged fit with the corners of the image.",
        "The image with the mesh misplaced, the rendered mesh, and the image with the mesh in place.",
    )


def _figure_10(runs: Mapping[str, FinishedRun]) -> Iterator[NamedFigure]:
    counts, published, credits_ = dict[str, NDArray[np.float64]](), dict[str, float](), list[str]()
    for name, run in runs.items():
        label = run.labels(RECOGNISER)[0]
        rows = run.content.run.rows
        solved = rows[(rows["estimator"] == label) & (rows["status"] == "ok")]
        counts[name] = solved["n_landmarks"].to_numpy(dtype=np.float64)
        credits_ += run.manifest["credits"]
        comparison = load_published(run.manifest["report"]) if run.manifest["report"] else None
        printed = comparison.find("n_landmarks", "recognition", "median") if comparison else None
        if comparison is not None and comparison.verdicts and printed is not None:
            published[name] = printed.value
    yield NamedFigure(
        "",
        draw_count_comparison(counts, published, "Recognised landmarks an image", credits_),
        "Number of landmarks recognised in each image; dotted lines: medians; open triangles on the axis: medians of"
        " the paper.",
        "Histograms of the number of recognised landmarks in each image.",
    )


def _pose(run: FinishedRun) -> Iterator[NamedFigure]:
    """Draw the errors of the recogniser after each stage, for figures 6 and 9."""
    label = run.labels(RECOGNISER)[0]
    yield pose_figure(run.content, _scenario(run, label), label)


def _scenario(run: FinishedRun, label: str) -> str:
    """Return the first scenario in which an estimator ran."""
    return next(scenario for scenario, name in run.content.run.pairs() if name == label)


def _look(run: FinishedRun, label: str, rows: pd.DataFrame) -> tuple[SecondLook, str, Sequence[str]]:
    """Recompute the median trial of some rows; also return its description and the image credits."""
    campaign, name = run.campaign(), _scenario(run, label)
    trial = median_trial(rows[(rows["scenario"] == name) & (rows["estimator"] == label)])
    look = None if trial is None else second_look(campaign, run.folder, Case(name, label, trial))
    if look is None:
        raise BoresightError(f"{run.folder.path}: no trial of {label} has an estimate to draw")
    what = f"{name}, trial {trial} {look.image_name}".strip()
    return look, what, credit_lines(campaign.scenario(name).spec)


def _grids(run: FinishedRun) -> list[Grid]:
    """Return the tables of a run that varies what the paper does not specify."""
    if run.manifest["name"] not in _SENSITIVITY:
        return []
    content, paper = run.content, load_published("rowell2015-simulated")
    grids = [*design_grids(content.run), sensitivity_grid(content.records, mesh_variants(content.run), paper)]
    return [replace(grid, title=f"{run.manifest['name']}: {grid.title}") for grid in grids if grid]


def built_again(world: World, options: DatabaseOptions, jobs: int, variant: str) -> LandmarkDatabaseBuild:
    """Rebuild a data base with its intermediate results; its candidates come from the cache if they are there."""
    candidates = landmark_candidates(world.scenario, options, jobs, variant)
    return build_database(candidates.by_image, candidates.cameras_m, options)


def broadside_view(world: World, range_m: float) -> View:
    """View of the body along its shortest principal axis, the longest one horizontal, the Sun from the upper left."""
    centred = world.body.mesh.vertices_m - world.body.mesh.vertices_m.mean(axis=0)
    axes = np.linalg.eigh(centred.T @ centred)[1].T
    shortest, longest = axes[0], axes[2]
    pose = look_at(range_m * shortest * np.sign(shortest[np.argmax(np.abs(shortest))]))
    across = pose.rotate(longest)
    turned = look_at(pose.camera_position_m, float(np.arctan2(across[1], across[0])))
    phase = np.radians(_PHASE_DEG)
    sun_dir_cam = np.array([-np.sin(phase) * np.sqrt(0.5), -np.sin(phase) * np.sqrt(0.5), -np.cos(phase)])
    return View(world.camera.pinhole, turned, turned.inverse().rotate(sun_dir_cam))


def cluster_view(world: World, built: LandmarkDatabaseBuild, view: View) -> ClusterView:
    """Project the visible points of seed and merged clusters, and render the body."""
    uv_px = view.camera.project(view.T_cam_body.transform(built.points_m))
    seen_m = world.renderer.surface(view, uv_px).points_body_m
    near = np.linalg.norm(seen_m - built.points_m, axis=1) < _NEAR_M  # NaN, off the body, is not
    seed_of, merged_of = (_cluster_of(len(uv_px), found) for found in (built.clusters.grown, built.clusters.refined))
    seeds, merged = near & (seed_of >= 0), near & (merged_of >= 0)
    return ClusterView(uv_px[seeds], seed_of[seeds], uv_px[merged], merged_of[merged], world.renderer.render(view))


def _cluster_of(points: int, clusters: list[PointCluster]) -> NDArray[np.intp]:
    """Return the index of each point's cluster; -1 for none."""
    cluster_of = np.full(points, -1, dtype=np.intp)
    for number, cluster in enumerate(clusters):
        cluster_of[cluster.members] = number
    return cluster_of


def surface_view(database: LandmarkDatabase, view: View) -> SurfaceView:
    """Project the Delaunay tetrahedra of the landmarks, and the facets of their surface that face the camera."""
    mesh = database.mesh()
    tetrahedra = Delaunay(database.means_m).simplices
    pairs = np.array([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)])
    edges = np.unique(np.sort(tetrahedra[:, pairs].reshape(-1, 2), axis=1), axis=0)
    uv_px = _pixels(view, database.means_m)
    centres = mesh.corners_m.mean(axis=1)
    to_camera = view.T_cam_body.camera_position_m - centres
    facing = np.flatnonzero(np.einsum("fi,fi->f", to_camera, mesh.normals) > 0.0)
    facing = facing[np.argsort(-np.linalg.norm(to_camera[facing], axis=1), kind="stable")]  # from far to near
    tips = centres + _NORMAL_SHARE * mesh.radius_m * mesh.normals
    return SurfaceView(
        landmarks_px=uv_px,
        edges_px=uv_px[edges],
        facets_px=uv_px[mesh.faces[facing]],
        shades=np.clip(mesh.normals[facing] @ view.sun_dir_body, 0.0, 1.0),
        normals_px=np.stack([_pixels(view, centres[facing]), _pixels(view, tips[facing])], axis=1),
        n_tetrahedra=len(tetrahedra),
        n_facets=len(mesh.faces),
    )


def _pixels(view: View, points_body_m: FloatArray) -> FloatArray:
    return view.camera.project(view.T_cam_body.transform(points_body_m))


_REAL = ("rowell2015-real", "rowell2015-real-like", "navcam67p-real")
_FIGURES = (
    PaperFigure("1", ("rowell2015-database",), _figure_1, rebuilds=True),
    PaperFigure("2", ("rowell2015-database",), _figure_2, rebuilds=True),
    PaperFigure("3", ("rowell2015-simulated",), _figure_3),
    PaperFigure("4", ("rowell2015-centroid",), _figure_4),
    PaperFigure("5", ("rowell2015-convergence",), _figure_5),
    PaperFigure("6", ("rowell2015-simulated",), _pose),
    PaperFigure("7", ("rowell2015-simulated",), _figure_7),
    PaperFigure("8", _REAL, _figure_8),
    PaperFigure("9", _REAL, _pose),
    PaperFigure("10", ("rowell2015-simulated", *_REAL), _figure_10, together=True),
)
_ORDER = ("database", "centroid", "convergence", "simulated", "real", "real-like")
PAPER = Paper(
    title="Rowell et al. (2015): every figure and every number",
    campaigns=(*(f"rowell2015-{name}" for name in _ORDER), "navcam67p-real", *_SENSITIVITY),
    methods=(RECOGNISER, "centroid", DATABASE),
    figures=_FIGURES,
    grids=_grids,
)

"""Projections of a landmark data base for figures 1 and 2 of Rowell et al. (2015)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from boresight.campaign.imaging.world import World
from boresight.campaign.products.landmark_database import landmark_candidates
from boresight.estimators.landmark.build import DatabaseOptions, LandmarkDatabaseBuild, build_database
from boresight.estimators.landmark.clustering import PointCluster
from boresight.estimators.landmark.database import LandmarkDatabase
from boresight.reports.figures import ClusterView, SurfaceView
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import TriangleMesh, View, look_at

_PHASE_DEG = 35.0
# A candidate is on the near side if the visible surface at its pixel is within this distance.
_NEAR_M = 3.0
_NORMAL_SHARE = 0.06


def built_again(world: World, options: DatabaseOptions, jobs: int, variant: str) -> LandmarkDatabaseBuild:
    """Rebuild a data base with its intermediate results; its candidates come from the cache if they are there."""
    return build_database(landmark_candidates(world.scenario, options, jobs, variant).by_image, options)


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
    centres, facing = mesh.corners_m.mean(axis=1), _far_to_near(mesh, view)
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


def _far_to_near(mesh: TriangleMesh, view: View) -> NDArray[np.intp]:
    """Return the facets that face the camera, ordered from far to near, for drawing."""
    to_camera = view.T_cam_body.camera_position_m - mesh.corners_m.mean(axis=1)
    facing = np.flatnonzero(np.einsum("fi,fi->f", to_camera, mesh.normals) > 0.0)
    return facing[np.argsort(-np.linalg.norm(to_camera[facing], axis=1), kind="stable")]

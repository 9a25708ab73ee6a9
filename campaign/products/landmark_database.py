"""Data bases of landmarks of a scenario: triangulated corners of rendered images, descriptors of features, maplets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from boresight.campaign.products.databases import (
    ProductKind,
    content_key,
    database_images,
    map_images,
    survey_images,
)
from boresight.estimators.descriptors.database import METHOD_VERSION as DESCRIPTORS_VERSION
from boresight.estimators.descriptors.database import (
    DescriptorDatabase,
    DescriptorOptions,
    ViewFeatures,
    view_features,
)
from boresight.estimators.descriptors.triangulation import triangulated_views
from boresight.estimators.landmark.database import (
    METHOD_VERSION,
    CandidateOptions,
    DatabaseOptions,
    LandmarkDatabase,
    database_from_candidates,
    extract_candidates,
)
from boresight.estimators.maplets.build import METHOD_VERSION as MAPLETS_VERSION
from boresight.estimators.maplets.build import MapletOptions, Surface, build_maplets
from boresight.estimators.maplets.database import MapletDatabase
from boresight.estimators.maplets.paint import paint, seen
from boresight.renderers.mitsuba3 import MitsubaRenderer, choose_variant
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.bodies import load_body
from boresight.scenarios.cache import default_cache
from boresight.scenarios.load import LoadedScenario

KIND = "landmark-database"
VERSION = 1

CANDIDATES_KIND = "landmark-candidates"
CANDIDATES_VERSION = 2


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkCandidates:
    """Candidate landmarks: de-projected corners of rendered images, (C, 3) for each image, body frame, m.

    ``cameras_m`` (I, 3) are the places of the camera, body frame. ``images_from_store`` is the number of images from
    the store; None if the candidates came from the cache.
    """

    by_image: tuple[FloatArray, ...]
    cameras_m: FloatArray
    images_from_store: int | None


def landmark_candidates(
    scenario: LoadedScenario, options: CandidateOptions, jobs: int | None, variant: str
) -> LandmarkCandidates:
    """Return the candidates of ``scenario``, as the spacecraft believes it to be, from the cache if they are there.

    The images (`database_images`) are stored as well, so that other corner options render nothing again. Further fields
    of a derived model of options are ignored. For ``jobs`` see `map_images`.
    """
    options = CandidateOptions.model_validate({name: getattr(options, name) for name in CandidateOptions.model_fields})
    stored: list[int] = []

    def build(folder: Path) -> None:
        found = map_images(jobs, options.images, _candidates_of_images, scenario, options, variant)
        stored.append(sum(from_store for *_, from_store in found))
        np.save(folder / "points_m.npy", np.concatenate([np.empty((0, 3)), *(points for points, *_ in found)]))
        np.save(folder / "counts.npy", np.array([len(points) for points, *_ in found], dtype=np.int64))
        np.save(folder / "cameras_m.npy", np.array([camera_m for _, camera_m, _ in found]).reshape(-1, 3))

    key = content_key(scenario, CANDIDATES_KIND, options, [CANDIDATES_VERSION, METHOD_VERSION], variant)
    folder = default_cache().folder(CANDIDATES_KIND, key, build)
    points_m, counts, cameras_m = (
        np.load(folder / f"{name}.npy", allow_pickle=False) for name in ("points_m", "counts", "cameras_m")
    )
    by_image = tuple(np.split(points_m, np.cumsum(counts)[:-1]))
    return LandmarkCandidates(by_image, cameras_m, stored[0] if stored else None)


def _candidates_of_images(
    scenario: LoadedScenario, options: CandidateOptions, variant: str, images: Sequence[int]
) -> list[tuple[FloatArray, FloatArray, bool]]:
    """Find the candidates of some images, the place of the camera, and whether each image came from the store."""
    pictured = database_images(
        scenario, images, (0.0, options.phase_deg_max), options.seed, variant, options.range_m, options.camera
    )
    return [
        (
            extract_candidates(image.pixels, image.deproject, options),
            image.view.T_cam_body.camera_position_m,
            image.from_store,
        )
        for image in pictured
    ]


def build(
    scenario: LoadedScenario, options: DatabaseOptions, folder: Path, jobs: int, variant: str
) -> Mapping[str, object]:
    """Build the data base of ``scenario`` from its candidates and store it in ``folder``."""
    candidates = landmark_candidates(scenario, options, jobs, variant)
    database = database_from_candidates(candidates.by_image, candidates.cameras_m, options)
    database.save(folder)
    if candidates.images_from_store is None:
        source = {"candidates_from_cache": sum(map(len, candidates.by_image))}
    else:
        source = {"images_from_store": candidates.images_from_store}
    return {"images": len(candidates.by_image), **source, "landmarks": len(database.means_m)}


def build_descriptors(
    scenario: LoadedScenario, options: DescriptorOptions, folder: Path, jobs: int, variant: str
) -> Mapping[str, object]:
    """Build the data base of features of images, de-projected onto the believed body, and store it in ``folder``."""
    kept = 0
    if options.points == "triangulated":
        seen_at = [(one.pixels, one.view) for one in survey_images(scenario, variant)]
        views = triangulated_views(seen_at, options)
    elif options.source == "survey":
        images = survey_images(scenario, variant)
        views = tuple(view_features(one.pixels, one.view, one.deproject, options) for one in images)
    else:
        found = map_images(jobs, options.images, _features_of_images, scenario, options, variant)
        views, kept = tuple(features for features, _ in found), sum(stored for _, stored in found)
    provenance = {"options": options.model_dump(mode="json"), "method_version": DESCRIPTORS_VERSION}
    DescriptorDatabase(options.kind, views, provenance).save(folder)
    return {"images": len(views), "images_from_store": kept}


def _features_of_images(
    scenario: LoadedScenario, options: DescriptorOptions, variant: str, images: Sequence[int]
) -> list[tuple[ViewFeatures, bool]]:
    return [
        (view_features(image.pixels, image.view, image.deproject, options), image.from_store)
        for image in database_images(scenario, images, (0.0, options.phase_deg_max), options.seed, variant)
    ]


def build_maplet_database(
    scenario: LoadedScenario, options: MapletOptions, folder: Path, jobs: int, variant: str
) -> None:
    """Cut maplets out of the believed shape, painted with the images of a survey if asked, and store them."""
    del jobs
    mesh = load_body(scenario.spec.body, scenario.search_dirs).mesh
    if options.source == "shape":
        build_maplets(mesh, options).save(folder)
        return
    images = list(survey_images(scenario, variant))
    middles_m = Surface(mesh).centroids_m
    wanted = np.any([seen(middles_m, mesh.normals, image, options.spacing_m) for image in images], axis=0)
    maplets = build_maplets(replace(mesh, albedo=None), options, wanted)
    renderer = MitsubaRenderer(maplets.mesh(), scenario.spec.brdf, 4, "flat", choose_variant(variant))
    paint(maplets, renderer, images).save(folder)


PRODUCTS = {
    KIND: ProductKind(
        options=DatabaseOptions,
        versions=lambda: [VERSION, METHOD_VERSION],
        announce=lambda options: f"{options.images} images",
        build=build,
        load=LandmarkDatabase.load,
        about=lambda database: {"n_landmarks": len(database.means_m), "n_facets": len(database.facets)},
    ),
    "descriptors": ProductKind(
        options=DescriptorOptions,
        versions=lambda: [DESCRIPTORS_VERSION],
        announce=lambda options: f"{options.kind}, {'survey' if options.source == 'survey' else options.images} images",
        build=build_descriptors,
        load=DescriptorDatabase.load,
        about=lambda database: {"descriptors": database.kind, "n_landmarks": database.n_features},
    ),
    "maplets": ProductKind(
        options=MapletOptions,
        versions=lambda: [MAPLETS_VERSION],
        announce=lambda options: f"{options.side} x {options.side} heights each, albedo of the {options.source}",
        build=build_maplet_database,
        load=MapletDatabase.load,
        about=lambda database: {
            "n_landmarks": len(database),
            "nodes": database.side**2,
            "spacing_m": database.spacing_m,
        },
    ),
}

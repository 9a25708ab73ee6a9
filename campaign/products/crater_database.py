"""Crater data base of a scenario: image rendering, crater detection, matching, numbering, triangulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from boresight.campaign.imaging.world import open_world
from boresight.campaign.products.databases import DatabaseImage, ProductKind, database_images, map_images
from boresight.estimators.contract import NoProductError
from boresight.estimators.craters.contract import CraterDetections, CraterDetector, CraterImage
from boresight.estimators.craters.database.build import build_database, triangulate_landmarks
from boresight.estimators.craters.database.files import CraterDatabase
from boresight.estimators.craters.matching.preliminary import PreliminaryOptions
from boresight.estimators.craters.pose import CraterDatabaseOptions
from boresight.estimators.registry import crater_detector_class, crater_matcher_class, named_detector_versions
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.observation import Frame
from boresight.scenarios.sequences.ground import MeshGround

VERSION = 2

_MATCHER = "vote"
# Poses of the images are assumed to come from orbit determination over all of them: rad and m, far below a pixel.
_POSE_SIGMAS = np.array([1e-7, 1e-7, 1e-7, 1.0, 1.0, 1.0])


def build(
    scenario: LoadedScenario, options: CraterDatabaseOptions, folder: Path, jobs: int, variant: str
) -> Mapping[str, object]:
    """Build the data base of ``scenario`` as the spacecraft knows it, and store it in ``folder``.

    The images show the body's true craters, which are not part of the believed shape; their poses are known exactly.
    """
    world = open_world(scenario, variant)
    if world.ground is None:
        raise NoProductError("it is made of the section craters, which is missing: add it, or leave the estimator out")
    found = map_images(jobs, options.images, _of_images, scenario, options, variant)
    images = [image for image, _ in found]
    matcher = crater_matcher_class(_MATCHER).from_options(
        {"height_sigma_m": options.height_sigma_m, "association": options.association.model_dump()}
    )
    preliminary = PreliminaryOptions(height_sigma_m=options.height_sigma_m)
    built = build_database(images, matcher, MeshGround(world.body.mesh), preliminary)
    triangulate_landmarks(built.database, options.height_sigma_m, options.association).save(folder)
    return {
        "images": options.images,
        "images_from_store": sum(stored for _, stored in found),
        "image_pairs": len(built.found),
        "conflicts": built.numbering.conflicts,
    }


def _of_images(
    scenario: LoadedScenario, wanted: CraterDatabaseOptions, variant: str, images: Sequence[int]
) -> list[tuple[CraterImage, bool]]:
    """Detect craters in some images; also return whether each image came from the store."""
    finder = crater_detector_class(wanted.detector).from_options({})
    pictured = database_images(scenario, images, wanted.phase_deg, wanted.seed, variant)
    return [
        (_searched(number, image, finder, wanted.most_detections), image.from_store)
        for number, image in zip(images, pictured, strict=True)
    ]


def _searched(number: int, pictured: DatabaseImage, finder: CraterDetector, most_detections: int) -> CraterImage:
    """Detect craters in an image of the data base."""
    view, camera = pictured.view, pictured.view.camera
    pose = view.T_cam_body
    frame = Frame(pictured.pixels, pose.rotate(view.sun_dir_body), pose, np.diag(_POSE_SIGMAS**2), float(number))
    try:
        found = finder.detect(frame, camera)
    except BoresightError:  # a black image has no craters
        return CraterImage(number, frame, camera, CraterDetections.none())
    kept = slice(0, most_detections)
    return CraterImage(number, frame, camera, CraterDetections(found.ellipses[kept], found.confidence[kept]))


PRODUCTS = {
    "crater-database": ProductKind(
        options=CraterDatabaseOptions,
        versions=lambda: [VERSION, crater_matcher_class(_MATCHER).version, *named_detector_versions()],
        announce=lambda options: f"{options.images} images",
        build=build,
        load=CraterDatabase.load,
        about=lambda database: {"n_landmarks": len(database.landmarks), "pictures": len(database.pictures)},
    )
}

"""Features of a survey with the points where their lines of sight meet, whatever the onboard shape is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from boresight.estimators.contract import NoProductError
from boresight.estimators.descriptors.database import DescriptorOptions, ViewFeatures, find_features
from boresight.estimators.slam.vision.image_tracks import TrackingOptions, track_features
from boresight.estimators.slam.vision.matching import ImageFeatures
from boresight.scenarios.geometry import View
from boresight.scenarios.geometry.camera import LinesOfSight, triangulation_equations

_LEAST_PARALLAX_DEG = 2.0  # a third of a pixel in two images moves a point by 13 pixels of the ground along the sight


def triangulated_views(
    images: Sequence[tuple[NDArray[np.float32], View]], options: DescriptorOptions
) -> tuple[ViewFeatures, ...]:
    """Find the features that two images or more show, with their points on the body.

    Matches of pairs of images are joined to tracks, see `track_features`. The point of a track is the nearest to its
    lines of sight, and is kept where every image of the track shows it within ``epipolar_max_px``, from directions that
    are 2 deg or more apart. A feature of one image alone is left out.

    Parameters
    ----------
    images
        Images (H, W) with their views. The camera of all is the same, a pinhole.
    options
        Kind and number of the features.

    Raises
    ------
    NoProductError
        If there is one image alone, or no such feature.
    """
    if len(images) < 2:
        raise NoProductError(f"points: triangulated needs two images of the survey, here is {len(images)}: name more")
    views, tracking = [view for _, view in images], TrackingOptions()
    camera, poses = views[0].camera, [view.T_cam_body for view in views]
    found = [find_features(image, options.kind, options.features) for image, _ in images]
    # Bytes would be compared by Hamming distance, as those of ORB are.
    described = [one.descriptors.astype(np.float32) if options.kind == "sift" else one.descriptors for one in found]
    features = [ImageFeatures(one.uv_px, own, np.zeros(len(one))) for one, own in zip(found, described, strict=True)]
    turns = np.array([pose.rotation for pose in poses])
    tracks = track_features(features, turns, camera, tracking, np.random.default_rng(0))
    frame, track = tracks.frames, tracks.tracks
    # A line of sight alone, or parallel ones, would not determine a point: all tracks have two, and a parallax.
    nothing = np.zeros((track.max(initial=-1) + 1, 3))
    directions = np.einsum("sji,sj->si", turns[frame], camera.unproject(tracks.uv_px))
    lines = LinesOfSight(np.array([pose.camera_position_m for pose in poses])[frame], directions)
    matrix, right = triangulation_equations(lines, track, (nothing[:, None] * np.eye(3), nothing))
    points_m = np.linalg.solve(matrix, right[..., None])[..., 0]
    # Of two lines that are an angle apart, the least eigenvalue is 1 - its cosine.
    points_m[np.linalg.eigvalsh(matrix)[:, 0] < 1.0 - np.cos(np.radians(_LEAST_PARALLAX_DEG))] = np.nan
    for image, pose in enumerate(poses):
        own = frame == image
        apart_px = np.linalg.norm(camera.project(pose.transform(points_m[track[own]])) - tracks.uv_px[own], axis=1)
        points_m[track[own][~(apart_px <= tracking.epipolar_max_px)]] = np.nan  # also behind the camera
    if not np.isfinite(points_m).any():
        raise NoProductError("no feature is in two images of the survey: name others, or set points: shape")
    made = []
    for image, (one, view) in enumerate(zip(found, views, strict=True)):
        own = frame == image
        # Several features may be at one place, with other orientations.
        track_at = dict(zip(map(tuple, tracks.uv_px[own].tolist()), track[own].tolist(), strict=True))
        rows = [track_at.get(tuple(place), len(points_m)) for place in one.uv_px.tolist()]
        made.append(ViewFeatures.where_known(view, np.vstack([points_m, np.full(3, np.nan)])[rows], one.descriptors))
    return tuple(made)

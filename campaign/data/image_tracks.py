"""Tracks of features through the images of a scenario, as tables that ``sequence.tracks`` reads."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from boresight.campaign.imaging.real_images import open_images
from boresight.campaign.imaging.world import TrialImage, open_world
from boresight.estimators.slam.vision.image_tracks import ImageTracks, TrackingOptions, track_features
from boresight.estimators.slam.vision.matching import find_features
from boresight.renderers.mitsuba3 import choose_variant
from boresight.renderers.rectify import rectify
from boresight.scenarios.arrays import MAD_TO_SIGMA
from boresight.scenarios.atomic import write_text
from boresight.scenarios.data import data_folder
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Pose
from boresight.scenarios.load import LoadedScenario

_HEADER = "time_s,x_m,y_m,z_m,qw,qx,qy,qz"


@dataclass(frozen=True, slots=True, eq=False)
class TrackedImages:
    """Tracks through the F images of a scenario in the order of time; pixels are of its pinhole camera.

    ``names`` and ``times_s`` are those of the images, ``features`` (F,) counts, and ``poses`` F reference poses
    (T_cam_body) by name. ``attitudes`` names those whose attitudes the matching used; it used no position.
    """

    scenario: str
    names: tuple[str, ...]
    times_s: tuple[float, ...]
    features: tuple[int, ...]
    poses: Mapping[str, tuple[Pose, ...]]
    attitudes: str
    tracks: ImageTracks

    def summary(self) -> Iterator[str]:
        """Describe the tracks, line by line."""
        found, steps = self.tracks, self.tracks.going_on(len(self.names))
        yield (
            f"{self.scenario}: {len(self.names)} images, {min(self.features)} to {max(self.features)} features in each;"
            f" {found.agreeing} of {found.pairs} pairs of images match, by the attitudes {self.attitudes}"
        )
        counts = np.bincount(found.sightings)
        shares = ", ".join(f"{count} of {k}" for k, count in enumerate(counts.tolist()) if count)
        yield f"{len(found.sightings)} tracks with {len(found.tracks)} sightings; tracks by their sightings: {shares}"
        yield f"tracks that go on to the next image: {steps.min()} to {steps.max()}, median {np.median(steps):g}"
        for k in np.flatnonzero(steps == 0).tolist():
            hours = (self.times_s[k + 1] - self.times_s[k]) / 3600.0
            yield f"none goes on from {self.names[k]} to {self.names[k + 1]}, {hours:.3g} h later"
        sigma_px = MAD_TO_SIGMA * float(np.median(np.abs(found.off_line_px))) / np.sqrt(2.0)
        yield (
            f"noise of a coordinate across the epipolar lines: {sigma_px:.2f} px; sigma_px should be larger by what"
            " features move with the light"
        )

    def write(self, folder: Path) -> list[Path]:
        """Write the table of tracks, and one of poses for each name; return the files. Raise OSError."""
        found = self.tracks
        rows = zip(found.tracks.tolist(), found.frames.tolist(), *found.uv_px.T.tolist(), strict=True)
        about = f"# boresight tracks {self.scenario}, attitudes {self.attitudes}"
        lines = [about, "track,frame,u_px,v_px", *(f"{t},{k},{u:.3f},{v:.3f}" for t, k, u, v in rows)]
        folder.mkdir(parents=True, exist_ok=True)
        files = {folder / "tracks.csv": lines}
        for name, poses in self.poses.items():
            lines = [f"# boresight tracks {self.scenario}, poses {name}", _HEADER]
            for image, time_s, pose in zip(self.names, self.times_s, poses, strict=True):
                numbers = (time_s, *pose.camera_position_m, *pose.quat_wxyz)
                lines.append(f"{','.join(f'{number:.12g}' for number in numbers)}  # {image}")
            files[folder / f"poses-{name}.csv"] = lines
        for path, lines in files.items():
            write_text(path, "\n".join([*lines, ""]))
        return list(files)


def tracks_folder(scenario: str) -> Path:
    """Return the folder below the data folder where campaigns look for the tracks of a scenario."""
    return data_folder() / "sequences" / scenario


def track_images(scenario: LoadedScenario, attitudes: str | None, options: TrackingOptions) -> TrackedImages:
    """Find features in the images of a scenario, real or rendered ones, and track them.

    ``attitudes`` names poses of the images, by default ``images.truth``: how the camera is turned in body axes is taken
    from these, nothing else. Raise `BoresightError` if the scenario has no images or only one, two have the same epoch,
    a file is wrong, or nothing is tracked.
    """
    shots, truth = _shots(scenario)
    poses = {truth: tuple(one.view.T_cam_body for one in shots)}
    poses |= {name: tuple(one.further[name].T_cam_body for one in shots) for name in shots[0].further}
    chosen = truth if attitudes is None else attitudes
    if chosen not in poses:
        raise BoresightError(f"--attitudes {chosen}: is none of the poses of the images: {', '.join(poses)}")
    camera = shots[0].view.camera
    found = [find_features(rectify(one.image, camera), options.detector, options.features) for one in shots]
    turns = np.array([pose.rotation for pose in poses[chosen]])
    tracks = track_features(found, turns, camera.pinhole, options, np.random.default_rng(0))
    counts = tuple(len(one) for one in found)
    if not len(tracks.tracks):
        raise BoresightError(
            f"{scenario.path}: images: nothing is tracked: {min(counts)} to {max(counts)} features in an image;"
            f" {tracks.agreeing} of {tracks.pairs} pairs of images match"
            f"{', but no track has a parallax' if tracks.agreeing else ''}"
        )
    names, times = tuple(one.image_name for one in shots), tuple(one.time_s for one in shots)
    return TrackedImages(scenario.spec.name, names, times, counts, poses, chosen, tracks)


def _shots(scenario: LoadedScenario) -> tuple[list[TrialImage], str]:
    """Return the images of a scenario in the order of time, and the name of the poses of their views."""
    spec = scenario.spec.images
    if spec is None:
        raise BoresightError(f"{scenario.path}: images: missing, so there is nothing to track")
    source = open_world(scenario, choose_variant(None).name).source
    shots = sorted((source.trial_image(0, k) for k in range(len(open_images(scenario)))), key=lambda one: one.time_s)
    source.flush()
    if len(shots) < 2:
        raise BoresightError(
            f"{scenario.path}: images: a track needs two images, but {shots[0].image_name} is the only one"
        )
    for one, other in itertools.pairwise(shots):
        if one.time_s == other.time_s:
            raise BoresightError(
                f"{scenario.path}: images: {one.image_name} and {other.image_name} have the same time,"
                f" {one.time_s:.12g} s: frames need an order"
            )
    return shots, spec.truth

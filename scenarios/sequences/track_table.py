"""Real tracks: their files, landmarks triangulated with the reference poses, and what a trial draws of them."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.data import find_data_file, find_data_folder
from boresight.scenarios.draw import Stream, generator
from boresight.scenarios.errors import BoresightError, one_line
from boresight.scenarios.geometry import Camera
from boresight.scenarios.geometry.camera import LinesOfSight, triangulation_equations
from boresight.scenarios.observation import TrackSequence
from boresight.scenarios.sequences.draw import SequenceTruth
from boresight.scenarios.sequences.ground import MeshGround
from boresight.scenarios.sequences.onboard import FrameTracks, onboard_sequence
from boresight.scenarios.sequences.trajectory import nominal_trajectory
from boresight.scenarios.spc import read_spc, spc_files
from boresight.scenarios.spec.sequence import SequenceSpec, TrackTableSpec
from boresight.scenarios.spec.tables import Table, columns_of, read_table
from boresight.scenarios.spec.trajectory import SequenceTrajectorySpec, StatesSpec, states_of

WRONG_PX = 3.0
"""A sighting farther than this from its landmark's true place counts as a wrong association."""

_LEAST_PARALLAX = 1e-9  # of the normal matrix of a landmark of unit weight: about 9 arcsec between two sightings


@dataclass(frozen=True, slots=True, eq=False)
class TrackTable:
    """S sightings of a file, in the order of tracks and of frames, and the reference states of the frames' cameras.

    ``tracks`` (S,) are numbers from 0 without gaps, ``rays`` (S, 2) coordinates x / z and y / z, camera axes.
    ``points_m`` (T, 3) are the landmarks of the tracks, body frame: those of LMK files, and of others the points
    nearest to all their lines of sight in the least-squares sense, with the reference poses.
    """

    states: StatesSpec
    tracks: IndexArray
    frames: IndexArray
    rays: FloatArray
    points_m: FloatArray

    @classmethod
    def open(cls, spec: TrackTableSpec, camera: Camera, folders: Sequence[Path]) -> TrackTable:
        """Read the files of a scenario, once as long as they do not change.

        Raise BoresightError if one is missing or wrong.
        """
        content = track_files_digest(spec, folders)
        if spec.table is not None and spec.poses is not None:
            found = _opened(spec.table, spec.poses, camera, tuple(folders), content)
        else:
            found = _opened_spc(_spc_folder(spec, folders), camera, content)
        first, frames, there = spec.first_frame or 0, spec.frames or 2, len(found.states)
        if first + frames > there:
            raise BoresightError(
                f"sequence.tracks: {frames} frames from frame {first} on are more than the {there} of"
                f" {spec.poses or spec.spc}: lower frames or first_frame"
            )
        return found


def track_files(spec: TrackTableSpec, folders: Sequence[Path]) -> Iterator[tuple[str, Path]]:
    """Yield the files of real tracks: name in the scenario, and path."""
    if spec.spc is not None:
        folder = _spc_folder(spec, folders)
        yield from ((f"{spec.spc}/{path.relative_to(folder).as_posix()}", path) for path in spc_files(folder))
    for key, name in (("table", spec.table), ("poses", spec.poses)):
        if name is not None:
            yield name, find_data_file(name, folders, "tables", f"sequence.tracks.{key}")


def _spc_folder(spec: TrackTableSpec, folders: Sequence[Path]) -> Path:
    return find_data_folder(spec.spc or "", folders, "tables", "sequence.tracks.spc")


def track_files_digest(spec: TrackTableSpec, folders: Sequence[Path]) -> str:
    """SHA-256 over the content of the files of real tracks."""
    try:
        digests = [hashlib.sha256(path.read_bytes()).digest() for _, path in track_files(spec, folders)]
    except OSError as error:
        raise BoresightError(f"sequence.tracks: {error}") from error
    return hashlib.sha256(b"".join(digests)).hexdigest()


@lru_cache(maxsize=2)
def _opened(table: str, poses: str, camera: Camera, folders: tuple[Path, ...], _content: str) -> TrackTable:
    try:
        states = _with_attitudes(states_of(read_table(poses, folders)))
    except (OSError, ValueError, TypeError) as error:
        raise BoresightError(f"sequence.tracks.poses: {poses} cannot be used: {one_line(error)}") from None
    try:
        tracks, frames, rays = _sightings(read_table(table, folders), camera, len(states))
        points = _triangulated(tracks, frames, rays, states)
    except (OSError, ValueError, TypeError) as error:
        raise BoresightError(f"sequence.tracks.table: {table} cannot be used: {one_line(error)}") from None
    return TrackTable(states, tracks, frames, rays, points)


@lru_cache(maxsize=2)
def _opened_spc(folder: Path, camera: Camera, _content: str) -> TrackTable:
    poses, sightings, points = read_spc(folder)
    try:
        states = _with_attitudes(states_of(poses))
        tracks, frames, rays = _sightings(sightings, camera, len(states))
        bare = np.isnan(points[:, 0])
        if bare.any():
            rows = bare[tracks]
            points[bare] = _triangulated(np.cumsum(bare)[tracks[rows]] - 1, frames[rows], rays[rows], states)
    except (ValueError, TypeError) as error:
        raise BoresightError(f"sequence.tracks.spc: {folder} cannot be used: {one_line(error)}") from None
    return TrackTable(states, tracks, frames, rays, points)


def _with_attitudes(states: StatesSpec) -> StatesSpec:
    """Return states; refuse those that are no reference of tracks."""
    if states.attitude is None:
        raise ValueError("no columns qw, qx, qy, qz: tracks need the attitude of each frame")
    if len(states) < 2:
        raise ValueError("a sequence needs two poses at least")
    return states


def _sightings(table: Table, camera: Camera, n_frames: int) -> tuple[IndexArray, IndexArray, FloatArray]:
    """Check the columns of a table: (S,) tracks from 0, (S,) frames and (S, 2) normalised coordinates."""
    if "x_normalised" in table and "u_px" in table:
        raise ValueError("sightings are given in pixels and normalised: leave u_px and v_px, or the others, out")
    given = columns_of(table, ("track", "frame"))
    if "x_normalised" in table:
        rays = columns_of(table, ("x_normalised", "y_normalised"))
    else:
        uv = columns_of(table, ("u_px", "v_px"))
        rays = (uv - [camera.cx_px, camera.cy_px]) / [camera.fx_px, camera.fy_px]
    if not len(given):
        raise ValueError("it has no sightings")
    if (wrong := ((given != np.floor(given)) | (np.abs(given) > 2**53)).any(axis=1)).any():
        raise ValueError(f"row {int(wrong.argmax())} (from 0): track and frame must be whole numbers")
    numbers, frames = given.astype(np.int64).T
    if (wrong := (frames < 0) | (frames >= n_frames)).any():
        row = int(wrong.argmax())
        raise ValueError(f"row {row} (from 0): frame {frames[row]} is none of the {n_frames} poses, from 0")
    order = np.argsort(numbers, kind="stable")
    same = np.diff(numbers[order]) == 0
    if (wrong := same & (np.diff(frames[order]) <= 0)).any():
        before, row = order[int(wrong.argmax()) :][:2]
        raise ValueError(
            f"row {row} (from 0): track {numbers[row]} is in frame {frames[row]} after frame {frames[before]}: sort the"
            " table by frame, one row for each sighting"
        )
    distinct, tracks, times = np.unique(numbers[order], return_inverse=True, return_counts=True)
    if (times < 2).any():
        raise ValueError(f"track {distinct[times.argmin()]} has one sighting: leave such tracks out")
    return tracks, frames[order], rays[order]


def _triangulated(tracks: IndexArray, frames: IndexArray, rays: FloatArray, states: StatesSpec) -> FloatArray:
    """(T, 3) points nearest to the lines of sight of each track, see `triangulation_equations`."""
    from scipy.spatial.transform import Rotation

    to_cam = Rotation.from_quat(np.array(states.attitude), scalar_first=True).as_matrix()
    sight = np.concatenate([rays, np.ones((len(rays), 1))], axis=1)
    sight = np.einsum("sji,sj->si", to_cam[frames], sight / np.linalg.norm(sight, axis=1, keepdims=True))
    lines = LinesOfSight(np.array(states.position_m)[frames], sight)
    nothing = np.zeros((tracks[-1] + 1, 3, 3)), np.zeros((tracks[-1] + 1, 3))
    normal, right = triangulation_equations(lines, tracks, nothing)
    flat = np.linalg.eigvalsh(normal)[:, 0] < _LEAST_PARALLAX
    if flat.any():
        raise ValueError(
            f"{flat.sum()} tracks have no parallax, the first in frame {frames[tracks == flat.argmax()][0]}"
        )
    return np.asarray(np.linalg.solve(normal, right[:, :, None])[:, :, 0])


def draw_real_sequence(
    spec: SequenceSpec, table: TrackTable, camera: Camera, ground: MeshGround, address: tuple[int, int]
) -> tuple[SequenceTruth, TrackSequence]:
    """Draw frames and tracks of a trial, and what is told beside them; ``address`` is (seed, trial).

    The truth is the reference: poses of the file, and landmarks triangulated with them from all their sightings.
    Pixels are those of the file, without added noise. Errors of what is told beside them are drawn about the reference.
    """
    if spec.tracks is None:
        raise BoresightError("sequence.tracks: missing, so there are no tracks to draw from")
    (seed, trial), chosen = address, spec.tracks
    rng = generator(seed, Stream.TRACK_FIELD, trial)
    first, last = _window(chosen, len(table.states), rng)
    # The reference states of these frames are the trajectory.
    columns = {key: value[first:last] for key, value in table.states if value is not None}
    flown = SequenceTrajectorySpec(table="poses", read_states=table.states.model_copy(update=columns))
    here = spec.model_copy(update={"trajectory": flown})
    path = nominal_trajectory(here, ground)
    rank = rng.permutation(len(table.points_m))
    sightings, wrong, points = [], [], list[FloatArray]()
    numbers: dict[int, int] = {}  # of a track of the file to its number in the trial
    before: set[int] = set()
    # Whether the track of a sighting is seen in the next frame too.
    lasts = np.append((np.diff(table.tracks) == 0) & (np.diff(table.frames) == 1), False)
    order = np.argsort(table.frames, kind="stable")
    ends = np.searchsorted(table.frames[order], np.arange(first, last + 1))
    for pose, (begin, end) in zip(path.poses, itertools.pairwise(ends), strict=True):
        rows = order[begin:end]
        tracks = table.tracks[rows].tolist()
        going_on = {track for track in tracks if track in before}
        new = sorted(set(table.tracks[rows[lasts[rows]]].tolist()) - before, key=rank.__getitem__)
        new = new[: max(chosen.per_frame - len(going_on), 0)]
        again = [(len(points) + k, numbers[track]) for k, track in enumerate(new) if track in numbers]
        numbers |= {track: len(points) + k for k, track in enumerate(new)}
        points += [table.points_m[track] for track in new]
        before = going_on | set(new)
        # In the order of their numbers, as a vision layer has them.
        seen = sorted(
            (numbers[track], row) for track, row in zip(tracks, rows.tolist(), strict=True) if track in before
        )
        own, at = np.array(seen, dtype=np.int64).reshape(-1, 2).T
        uv = table.rays[at] * [camera.fx_px, camera.fy_px] + [camera.cx_px, camera.cy_px]
        there = np.array([points[number] for number in own]).reshape(-1, 3)
        wrong.append(~(np.linalg.norm(camera.project(pose.transform(there)) - uv, axis=1) <= WRONG_PX))
        # A range is measured to the shape: to the landmark, it would have the errors of the same pixels.
        origins = np.tile(pose.camera_position_m, (len(own), 1))
        met, _ = ground.intersect(origins, camera.unproject(uv) @ pose.rotation)
        pairs = np.array(again if chosen.loops else [], dtype=np.int64).reshape(-1, 2)
        sightings.append(FrameTracks(own, uv, met, pairs))
    truth = SequenceTruth(path.poses, np.array(points).reshape(-1, 3), tuple(wrong), path, spec.gm_m3_s2)
    return truth, onboard_sequence(here, camera, path, sightings, address)


def _window(spec: TrackTableSpec, there: int, rng: np.random.Generator) -> tuple[int, int]:
    """Return first frame and end of a trial."""
    # Drawn in any case, so that the tracks do not depend on it.
    luck = float(rng.uniform())
    if spec.frames is None:
        return spec.first_frame or 0, there
    first = int(luck * (there - spec.frames + 1)) if spec.first_frame is None else spec.first_frame
    return first, first + spec.frames

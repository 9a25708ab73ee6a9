"""Export of stored runs: poses as COLMAP text models, TUM trajectories, SPICE kernels and SUM files; tables.

COLMAP (``cameras.txt``, ``images.txt``, ``points3D.txt``) has the conventions used here: x right, y down, z forward,
the centre of the first pixel at (0.5, 0.5), and the rotation from world to camera with the scalar first. Identifiers
begin at 1. A line of a TUM file, which evo reads, is ``timestamp tx ty tz qx qy qz qw``: seconds, camera position in
the world, m, and the rotation from camera to world axes with the scalar last. Numbers have 17 digits, which preserves
every bit.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import astuple, replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from boresight.campaign.export.epochs import Scale, converted_s, scale_of
from boresight.campaign.export.kernels import BODY_AXES, Origin, flights_of, write_definitions, write_kernels
from boresight.campaign.export.sumfiles import write_sumfiles
from boresight.campaign.inspection.recompute import (
    Case,
    Choice,
    cases_of,
    checked_trials,
    chosen_rows,
    recompute,
    reopened,
)
from boresight.campaign.inspection.show import Flight, PosedFrame, PosedFrames, Show, show_of
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.store import RunFolder
from boresight.campaign.trial.kind import InspectedTrial
from boresight.campaign.trial.score import pose_of
from boresight.reports.figures.named import file_stem
from boresight.reports.kinds import report_grids
from boresight.reports.pages.content import read_content
from boresight.reports.run.data import read_run
from boresight.reports.schema.datapackage import exported_fields, write_data_package
from boresight.reports.schema.tables import TABLES
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.atomic import write_atomically, write_text
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import OpenCVDistortion, RadialDistortion
from boresight.scenarios.onboard import onboard_camera

_CAMERA = 1
_NO_POINT = -1
_GREY = "160 160 160"
_BROWN = 4  # coefficients of OpenCV without the rational model
_LENSES = {0: "PINHOLE", _BROWN: "OPENCV", 8: "FULL_OPENCV"}
_TABLES = ("csv", "parquet")
_Track = list[tuple[int, int, float]]
_Labels = Mapping[tuple[str, int], tuple[str, float]]


def export(
    folder: RunFolder,
    to: str,
    choice: Choice,
    trials: Sequence[int] | None,
    out: Path,
    shown: Callable[[Sequence[Case]], Iterable[Case]],
    origin: Origin | None = None,
) -> list[Path]:
    """Write poses (``tum``, ``colmap``, ``spice``, ``sum``) or tables (``csv``, ``parquet``, ``latex``); return files.

    ``trials`` are those to export, None for all. ``shown`` gets the cases that must be run again, and passes them on.
    ``origin`` is for ``spice`` alone. Raise BoresightError if the run has no such scenario, estimator or trial, or its
    trials have no camera poses of this kind.
    """
    if origin is not None and to != "spice":
        raise BoresightError("--body-id, --start-et: of SPICE kernels alone: leave them out, or choose --to spice")
    if to == "latex":
        return _latex(folder, choice, trials, out)
    run = str(folder.path)
    every = chosen_rows(read_run(folder.path).rows, choice, run)
    rows = every[every["trial"].isin(checked_trials(every, trials, run))]
    if to in _TABLES:
        return _tables(folder, to, choice, trials, out)
    # An epoch of 0 is one where other trials have others.
    timed = set(every.loc[every["image"].ne("") | every["time_s"].ne(0.0), "scenario"])
    if to == "spice":
        return _kernels(folder, rows, timed, out, shown, origin or Origin())
    return _poses(folder, rows, timed, to, out, shown)


def _latex(folder: RunFolder, choice: Choice, trials: Sequence[int] | None, out: Path) -> list[Path]:
    """Write every table of the report as a LaTeX table in the style of booktabs."""
    for name, chosen in (("trial", trials), ("scenario", choice.scenario), ("estimator", choice.estimator)):
        if chosen is not None:
            raise BoresightError(f"--{name}: the tables of a report are of the whole run: leave it out")
    written = []
    for grid in report_grids(read_content(folder.path)):
        written.append(out / f"{file_stem(grid.title.lower().replace(' ', '-'))}.tex")
        write_text(written[-1], grid.latex())
    return written


def _tables(folder: RunFolder, kind: str, choice: Choice, trials: Sequence[int] | None, out: Path) -> list[Path]:
    """Write every table that is not empty to a file, and two files with the meaning of the columns.

    CSV and Parquet preserve every bit of the numbers. Tables without a column for the scenario or the estimator are not
    restricted to the chosen one.
    """
    exported, meanings = dict[str, pd.DataFrame](), []
    for name in TABLES:
        table = folder.table(name)
        for column, value in (("scenario", choice.scenario), ("estimator", choice.estimator)):
            table = table[table[column] == value] if value and column in table else table
        table = table if trials is None else table[table["trial"].isin(trials)]
        if table.empty:
            continue
        exported[name] = table
        _write(table, out / f"{name}.{kind}", kind)
        meanings += [(name, column.name, column.meaning) for column in TABLES[name] if column.name in table]
    columns = out / "columns.csv"
    _write(pd.DataFrame(meanings, columns=["table", "column", "meaning"]), columns, "csv")
    described = {name: (f"{name}.{kind}", exported_fields(name, table)) for name, table in exported.items()}
    package = write_data_package(described, kind, folder.read_manifest() or {}, out)
    return [*(out / f"{name}.{kind}" for name in exported), columns, package]


def _write(table: pd.DataFrame, path: Path, kind: str) -> None:
    if kind == "csv":
        write_text(path, table.to_csv(index=False, lineterminator="\n"))
    else:
        write_atomically(path, lambda temporary: table.to_parquet(temporary, index=False))


def _poses(
    folder: RunFolder,
    rows: pd.DataFrame,
    timed: Collection[str],
    to: str,
    out: Path,
    shown: Callable[[Sequence[Case]], Iterable[Case]],
) -> list[Path]:
    """Write trajectories, models or SUM files; trials are only run again for what is not stored of them."""
    labels = _labels(rows, timed, distinct=to == "tum")
    stored = _stored_images(rows, labels) if to == "tum" else None
    if stored is not None:
        return [path for name, frames in stored for path in write_trajectory(name, frames, out)]
    campaign, written = reopened(folder), list[Path]()
    kind = campaign.spec.experiment
    show = show_of(kind)
    if show is None or show.posed is None:
        others = "spice, csv" if show is not None and show.flights is not None else "csv"
        raise BoresightError(
            f"trials of {kind} have no poses of images: export them with --to {others}, parquet or latex"
        )
    if to == "sum" and not show.pooled:
        raise BoresightError(f"trials of {kind} have no SUM files: export them with --to tum, colmap or spice")
    for name in rows["scenario"].unique() if to == "sum" else ():
        if campaign.scenario(name).spec.camera.distortion is not None:
            raise BoresightError(
                f"{name}: camera.distortion: SUM files have a lens for the camera of NEAR alone, and without it their"
                " pixels are not those of the images: export with --to colmap or tum"
            )
    if to == "sum":
        labels = _in_scale("utc", labels, timed, campaign)
    cases, trajectory = shown(cases_of(rows)), show.trajectory
    if to in _MODELS:
        for name, model in _posed(campaign, folder, show, cases, labels):
            written += _MODELS[to](model, out / name) if model.frames else []
        return written
    paths: Iterable[tuple[str, Sequence[PosedFrame]]]
    if trajectory is None:
        paths = ((name, found.frames) for name, found in _posed(campaign, folder, show, cases, labels))
    else:  # those of sequences are inertial, and no estimator is run again for them
        paths = ((case.stem, trajectory(campaign, folder, case)) for case in cases)
    for name, frames in paths:
        written += write_trajectory(name, frames, out) if frames else []
    return written


def _kernels(
    folder: RunFolder,
    rows: pd.DataFrame,
    timed: Collection[str],
    out: Path,
    shown: Callable[[Sequence[Case]], Iterable[Case]],
    origin: Origin,
) -> list[Path]:
    """Write kernels of sequences and single images, as they are stored, or of orbits, which are determined again."""
    campaign = reopened(folder)
    kind = campaign.spec.experiment
    show, cases = show_of(kind), cases_of(rows)
    every: Iterable[tuple[str, Mapping[str, Flight]]]
    if show is not None and show.pooled:
        every = list(_flights_of_images(rows, timed, campaign))
        origin = replace(origin, axes=BODY_AXES).before(flights for _, flights in every)
    elif show is not None and show.trajectory is not None:
        trajectory = show.trajectory
        every = [(case.stem, flights_of(trajectory(campaign, folder, case))) for case in shown(cases)]
        origin = origin.before(flights for _, flights in every)
    elif show is not None and show.flights is not None:  # written as soon as it is there; times begin at 0
        every = ((case.stem, _flights(campaign, folder, show, case)) for case in shown(cases))
    else:
        raise BoresightError(f"trials of {kind} have no trajectory: export them in another format")
    written = list[Path]()
    for name, flights in every:
        written += write_kernels(name, flights, origin, out)
    return [*written, write_definitions(origin, out)] if written else []


def _flights_of_images(
    rows: pd.DataFrame, timed: Collection[str], campaign: ResolvedCampaign
) -> Iterator[tuple[str, Mapping[str, Flight]]]:
    """Yield the flights that solved single images sample, by scenario and estimator, in body axes.

    Raise BoresightError if images have no epochs or poses, or two of a flight have one epoch.
    """
    for name in rows["scenario"].unique():
        if name not in timed:
            raise BoresightError(
                f"{name}: images have no epochs, or one, and make no trajectory: export them with --to tum"
            )
    labels = _in_scale("tdb", _labels(rows, timed, distinct=False), timed, campaign)
    for name, frames in _stored_images(rows, labels) or ():
        frames.sort(key=lambda frame: frame.time_s)
        if len({frame.time_s for frame in frames}) < len(frames):
            raise BoresightError(f"{name}: trials have one epoch: name one of each epoch by --trial, or use --to tum")
        yield name, flights_of(frames)


def _flights(campaign: ResolvedCampaign, folder: RunFolder, show: Show, case: Case) -> Mapping[str, Flight]:
    """Determine an orbit again; none if there is no solution."""
    again = _recomputed(campaign, folder, case)
    return {} if show.flights is None or again is None else show.flights(again)


def _labels(rows: pd.DataFrame, timed: Collection[str], distinct: bool) -> _Labels:
    """Return name and time, s, of the image of each trial, by scenario and trial.

    If several trials have one image, its name ends in the trial, as ``a-t0003.png``. The time is the epoch in the
    scenarios ``timed``, else the number of the trial. With ``distinct`` it is that number too in scenarios in which two
    trials have the same epoch.
    """
    found: dict[tuple[str, int], tuple[str, float]] = {}
    for scenario, own in rows.drop_duplicates(["scenario", "trial"]).groupby("scenario", sort=False):
        several = own["image"].duplicated(keep=False)
        has_times = scenario in timed and not (distinct and own["time_s"].duplicated().any())
        for row, repeated in zip(own.to_dict("records"), several, strict=True):
            trial = int(row["trial"])
            name = PurePosixPath(row["image"] or f"{trial:07d}.tiff")
            name = name.with_stem(f"{name.stem}-t{trial:04d}") if row["image"] and repeated else name
            found[str(scenario), trial] = str(name), float(row["time_s"] if has_times else trial)
    return found


def _in_scale(scale: Scale, labels: _Labels, timed: Collection[str], campaign: ResolvedCampaign) -> _Labels:
    """Return labels with the epochs of the scenarios ``timed`` in a scale, where they are in another one."""
    scales = {name: scale_of(campaign.scenario(name).spec) for name in timed}
    found = dict(labels)
    for (scenario, trial), (name, time_s) in labels.items():
        own = scales.get(scenario)
        if own not in (None, scale):
            found[scenario, trial] = name, converted_s(time_s, own, scale)
    return found


def _stored_images(rows: pd.DataFrame, labels: _Labels) -> Iterator[tuple[str, list[PosedFrame]]] | None:
    """Yield the trajectories of single images from their stored rows; None if the rows have no poses."""
    solved = rows[rows["status"] == "ok"]
    if rows["true_qw"].isna().any() or solved["qw"].isna().any():
        return None
    nothing = np.zeros(0, dtype=np.int64), np.zeros((0, 2))
    return (
        (
            f"{scenario}_{estimator}",
            [
                PosedFrame(*labels[row["scenario"], row["trial"]], pose_of(row, "true_"), pose_of(row), *nothing)
                for row in own.to_dict("records")
            ],
        )
        for (scenario, estimator), own in solved.groupby(["scenario", "estimator"], sort=False)
    )


def _posed(
    campaign: ResolvedCampaign, folder: RunFolder, show: Show, cases: Iterable[Case], labels: _Labels
) -> Iterator[tuple[str, PosedFrames]]:
    """Recompute cases; yield name and poses in body axes of a model for each sequence, or of one for all single images.

    Names are made of scenario and estimator, and of the trial of a sequence. Raise BoresightError if recomputed and
    stored rows differ.
    """
    together: dict[tuple[str, str], list[PosedFrames]] = {}
    for case in cases:
        again = _recomputed(campaign, folder, case)
        if show.posed is None or again is None:
            continue
        spec = campaign.scenario(case.scenario).spec
        lens = (onboard_camera(spec) if show.pooled else spec.camera.camera()).distortion
        found = show.posed(again, case)
        found = replace(found, camera=replace(found.camera, distortion=lens))
        if show.pooled:
            name, time_s = labels[case.scenario, case.trial]
            frames = [replace(frame, name=name, time_s=time_s) for frame in found.frames]
            together.setdefault((case.scenario, case.estimator), []).append(replace(found, frames=frames))
        else:
            yield case.stem, found
    for (scenario, estimator), parts in together.items():
        frames = [frame for part in parts for frame in part.frames]
        places = {number: place for part in parts for number, place in part.places_m.items()}
        yield f"{scenario}_{estimator}", PosedFrames(parts[0].camera, frames, places)


def _recomputed(campaign: ResolvedCampaign, folder: RunFolder, case: Case) -> InspectedTrial[Any, Any, Any] | None:
    """Run a case again; raise BoresightError if its rows differ from the stored ones."""
    again = recompute(campaign, folder, case)
    if again.comparison.differences:
        raise BoresightError(f"{again.case}: {again.comparison}: the run cannot be exported so")
    shown: InspectedTrial[Any, Any, Any] | None = again.shown
    return shown


def write_model(posed: PosedFrames, folder: Path) -> list[Path]:
    """Write a COLMAP model of the estimated poses, and of the landmarks observed in images with a pose.

    The lens is written if COLMAP has it, and pixels are then those of the images as they were exposed. Otherwise they
    are those of images that are resampled to the pinhole.
    """
    camera, remarks = posed.camera, list[str]()
    if isinstance(camera.distortion, RadialDistortion):
        camera, remarks = camera.pinhole, ["# COLMAP does not have this lens: images are resampled to the pinhole."]
    posed = replace(posed, camera=camera)
    tracks: dict[int, _Track] = {}
    lines = ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME", "# POINTS2D[] as (X, Y, POINT3D_ID)"]
    for image, frame in enumerate(posed.frames, start=1):
        lines += _image(image, frame, posed, tracks)
    lens = camera.distortion
    coefficients = astuple(lens) if isinstance(lens, OpenCVDistortion) else ()
    # Those of OpenCV, in its order; k3 to k6 are left out if they are 0.
    coefficients = coefficients if any(coefficients[_BROWN:]) else coefficients[:_BROWN]
    numbers = (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *coefficients)
    texts = {
        "cameras.txt": [
            "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]",
            *remarks,
            f"{_CAMERA} {_LENSES[len(coefficients)]} {camera.width_px} {camera.height_px} {_numbers(*numbers)}",
        ],
        "images.txt": lines,
        "points3D.txt": [
            "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)",
            *(_point(number, posed.places_m[number], track) for number, track in sorted(tracks.items())),
        ],
    }
    for name, text in texts.items():
        write_text(folder / name, "\n".join(text) + "\n")
    return [folder / name for name in texts]


def _image(image: int, frame: PosedFrame, posed: PosedFrames, tracks: dict[int, _Track]) -> list[str]:
    """Return the two lines of an image, and add its observations and reprojection errors to ``tracks``."""
    pose, points = frame.estimated, []
    seen_px = posed.camera.distorted(frame.uv_px)
    for row, (number, uv_px) in enumerate(zip(frame.landmarks.tolist(), seen_px, strict=True)):
        place = posed.places_m.get(number)
        if place is not None:
            error_px = float(np.linalg.norm(posed.camera.project(pose.transform(place)) - uv_px))
            tracks.setdefault(number, []).append((image, row, error_px))
        points.append(f"{_numbers(*uv_px)} {_NO_POINT if place is None else number + 1}")
    head = f"{image} {_numbers(*pose.quat_wxyz, *pose.translation_m)} {_CAMERA} {frame.name}"
    return [head, " ".join(points)]


def _point(number: int, place_m: FloatArray, track: _Track) -> str:
    """Return the line of a landmark with its mean reprojection error; 0 if it is behind every camera."""
    errors = [error for _, _, error in track if np.isfinite(error)]
    error = float(np.mean(errors)) if errors else 0.0
    seen = " ".join(f"{image} {row}" for image, row, _ in track)
    return f"{number + 1} {_numbers(*place_m)} {_GREY} {_numbers(error)} {seen}"


def _numbers(*values: float) -> str:
    return " ".join(f"{value:.17g}" for value in values)


def write_trajectory(name: str, frames: Sequence[PosedFrame], out: Path) -> list[Path]:
    """Write ``NAME.truth.tum`` and ``NAME.estimate.tum``, with the same timestamps."""
    ordered = sorted(frames, key=lambda frame: frame.time_s)
    paths = [out / f"{name}.{what}.tum" for what in ("truth", "estimate")]
    for path, poses in zip(paths, zip(*[(f.true, f.estimated) for f in ordered], strict=True), strict=True):
        lines = ["# timestamp tx ty tz qx qy qz qw"]
        for frame, T_cam_world in zip(ordered, poses, strict=True):
            quat_xyzw = Rotation.from_matrix(T_cam_world.rotation.T).as_quat(canonical=True)
            lines.append(_numbers(frame.time_s, *T_cam_world.camera_position_m, *quat_xyzw))
        write_text(path, "\n".join(lines) + "\n")
    return paths


_MODELS = {"colmap": write_model, "sum": write_sumfiles}

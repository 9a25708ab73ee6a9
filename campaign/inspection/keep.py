"""Everything that came about in a case, written beside its page: tables, images, estimate."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from campaign.experiments.crater_detection import DetectedImage
from campaign.experiments.crater_matching import MatchedPair
from campaign.experiments.kept_images import write_image
from campaign.experiments.orbit_determination import DeterminedOrbit
from campaign.experiments.registry import Record
from campaign.experiments.sequence import FollowedSequence
from campaign.experiments.single_image import EstimatedImage
from campaign.inspection.recompute import Recomputed
from campaign.store.columns import schema
from estimators.contract import Estimate
from scenarios.atomic import write_atomically, write_text
from scenarios.geometry import Pose

FloatArray = NDArray[np.float64]


def keep(again: Recomputed, folder: Path) -> list[Path]:
    """Write the tables of a case as Parquet, what its estimator saw as TIFF, and what it returned as JSON."""
    kept = [_table(name, records, folder) for name, records in again.records.items() if records]
    for name, image in _images(again.shown).items():
        kept.append(folder / f"{name}.tiff")
        write_image(kept[-1], image)
    estimate = _estimate(again.shown)
    if estimate is not None:
        kept.append(folder / "estimate.json")
        write_text(kept[-1], json.dumps(estimate, indent=1) + "\n")
    return kept


def _table(name: str, records: Sequence[Record], folder: Path) -> Path:
    path = folder / "tables" / f"{name}.parquet"
    table = pa.Table.from_pylist([dict(record) for record in records], schema=schema(name))
    write_atomically(path, lambda temporary: pq.write_table(table, temporary))
    return path


def _images(shown: object) -> dict[str, NDArray[np.float32]]:
    """Return the images that a method saw, in digital numbers or whatever the scenario's detector gives."""
    if isinstance(shown, EstimatedImage):
        return {"image": shown.observation.frames[0].image}
    if isinstance(shown, DetectedImage):
        return {"image": shown.frame.image}
    if isinstance(shown, MatchedPair):
        looks = {"first": shown.pair.first.frame.image, "second": shown.pair.second.frame.image}
        return {name: image for name, image in looks.items() if image.size}
    return {}


def _estimate(shown: object) -> dict[str, object] | None:
    """Return what a method returned, in plain values; None of one that raised."""
    if isinstance(shown, EstimatedImage) and shown.estimate is not None:
        return _pose_estimate(shown.estimate)
    if isinstance(shown, FollowedSequence) and shown.estimate is not None:
        estimate = shown.estimate
        frames = [
            {
                "position_body_m": frame.position_m.tolist(),
                "covariance_m2": _listed(frame.covariance_m2),
                "tracks": frame.tracks.tolist(),
                "points_body_m": frame.points_m.tolist(),
            }
            for frame in estimate.frames
        ]
        return {"status": estimate.status, "reason": estimate.reason, "frames": frames}
    if isinstance(shown, MatchedPair) and shown.matches is not None:
        matches = shown.matches
        return {"reason": matches.reason, "pairs": matches.pairs.tolist(), "score": matches.score.tolist()}
    if isinstance(shown, DeterminedOrbit) and shown.estimate is not None and shown.estimate.orbit is not None:
        orbit = shown.estimate.orbit
        return {
            "status": shown.estimate.status,
            "reason": shown.estimate.reason,
            "state_inertial": orbit.state.tolist(),
            "covariance": orbit.covariance.tolist(),
            "times_s": shown.data.wanted_s.tolist(),
            "positions_inertial_m": orbit.positions_m.tolist(),
        }
    return None


def _pose_estimate(estimate: Estimate) -> dict[str, object]:
    return {
        "status": estimate.status,
        "reason": estimate.reason,
        "poses": [_pose(pose) for pose in estimate.poses],
        "covariances": [_listed(covariance) for covariance in estimate.covariances],
        "stages": {stage.name: _pose(stage.T_cam_body) for stage in estimate.stages},
        "diagnostics": {name: _plain(value) for name, value in estimate.diagnostics.items()},
        "details": {
            name: {column: np.asarray(values).tolist() for column, values in table.items()}
            for name, table in estimate.details.items()
        },
    }


def _pose(pose: Pose) -> Mapping[str, object]:
    return {"T_cam_body_quat_wxyz": pose.quat_wxyz.tolist(), "T_cam_body_translation_m": pose.translation_m.tolist()}


def _listed(matrix: FloatArray | None) -> object:
    return None if matrix is None else np.asarray(matrix).tolist()


def _plain(value: float | str) -> object:
    return value if isinstance(value, str) else float(value)

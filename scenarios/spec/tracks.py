"""Tracks of a file, with reference poses, in place of a simulated vision layer."""

from __future__ import annotations

from pydantic import Field

from boresight.scenarios.spec.base import SpecModel


class TrackTableSpec(SpecModel):
    """Real tracks instead of simulated ones: a table of sightings, and one of reference poses.

    ``table`` has a row for each sighting: ``track``, a number; ``frame``, the row of ``poses`` from 0; and ``u_px``,
    ``v_px``, or ``x_normalised``, ``y_normalised``: x / z and y / z in camera axes. Lens distortion is corrected. The
    sightings of a track are in the order of its frames. ``poses`` has the columns of ``viewpoint.trajectory.table``
    in body axes, attitudes among them. Both are CSV, Parquet, or MATLAB files of the toolbox SONIC.

    Trials differ by the tracks that are drawn. Each frame is filled up with tracks that are seen in the next frame
    too, as a matcher knows a track from its second sighting on. They are followed to the last frame before a gap;
    after it, it is another track.
    """

    table: str = Field(min_length=1, description="Table of sightings (beside the scenario, or under BORESIGHT_DATA)")
    poses: str = Field(
        min_length=1, description="Table of reference poses: scores, and the errors of all that is told beside tracks"
    )
    per_frame: int = Field(20, ge=3, le=100_000, description="Tracks of each frame that are drawn for a trial, if seen")
    frames: int | None = Field(
        None, ge=2, le=20_000, description="Consecutive frames of a trial; left out: all from the first one"
    )
    first_frame: int | None = Field(
        None, ge=0, le=20_000, description="First frame of a trial; left out: drawn where frames leave a choice, else 0"
    )
    sigma_px: float = Field(0.5, gt=0, description="Standard deviation of a coordinate that estimators are told")
    loops: bool = Field(
        False, description="Whether a track that comes back after a gap is recognised, as an additional loop closure"
    )

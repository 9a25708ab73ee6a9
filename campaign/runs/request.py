"""Settings of a run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

RUNS = Path("runs")
"""Folder of the run folders, unless another is given."""


@dataclass(frozen=True, slots=True)
class Cluster:
    """A Dask cluster: the address of a scheduler, or a number of worker processes on this machine."""

    scheduler: str = ""
    local: int = 0


@dataclass(frozen=True, slots=True)
class RunRequest:
    """Settings of a run. Of them only ``trials``, and ``limit_s`` if a method exceeds it, change the stored rows.

    Parameters
    ----------
    out
        The run folder; kept as an absolute path, because a method may change the working directory.
    trials
        Trials of each scenario.
    jobs
        Worker processes.
    keep_images
        Whether every image is kept.
    command
        The command line, for the manifest.
    cluster
        The Dask cluster whose workers run the trials; None for processes of this machine.
    limit_s
        How long an estimator may work at a trial before it is stopped, which is an error; None for as long as it likes.
    """

    out: Path
    trials: int
    jobs: int
    keep_images: bool = False
    command: str = ""
    cluster: Cluster | None = None
    limit_s: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "out", self.out.absolute())

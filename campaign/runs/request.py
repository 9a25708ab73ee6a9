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

    ``out`` is kept as an absolute path, because a method may change the working directory. ``trials`` are those of each
    scenario, ``jobs`` worker processes. ``command`` is the command line, for the manifest. Without a ``cluster``,
    processes of this machine run the trials. An estimator that works at a trial for ``limit_s`` is stopped, which is an
    error; None: no limit.
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

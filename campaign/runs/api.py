"""Campaigns from Python: `campaign.run` does what ``boresight run`` does and returns the rows."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from os import PathLike
from pathlib import Path

import pandas as pd

from campaign.runs.runner import Listener
from campaign.runs.start import start
from campaign.trial.kind import Records

_log = logging.getLogger("campaign")


class _Logged:
    """Tells the steps of a run to the log."""

    def message(self, text: str) -> None:
        _log.info("%s", text)

    def started(self, done: int, total: int) -> None:
        _log.info("%d of %d trials are stored already", done, total)

    def block(self, records: Records, trials: int) -> None:
        del records
        _log.debug("%d trials stored", trials)


def run(
    name: str | PathLike[str],
    *,
    trials: int | None = None,
    overrides: Sequence[str] = (),
    seed: int | None = None,
    until: str | None = None,
    jobs: int | None = None,
    out: str | PathLike[str] | None = None,
    variant: str | None = None,
    keep_images: bool = False,
    trial_limit_s: float | None = None,
    listener: Listener | None = None,
) -> pd.DataFrame:
    """Run a campaign, or continue it where it stopped, and return its rows.

    Parameters
    ----------
    name
        A campaign from ``boresight list``, or a YAML file.
    trials, seed
        Trials of each scenario, and the seed; what the campaign says if left out.
    overrides
        Keys of every scenario to change, such as ``["camera.fov_deg=20"]``.
    until
        Stop when every 95 % interval is narrow enough, such as ``"ci(position_error_m, median) < 0.5"``.
    jobs
        Worker processes; the cores if left out.
    out
        Run folder; ``runs/NAME-DIGEST`` if left out.
    variant
        Mitsuba variant; the fastest that works if left out.
    keep_images
        Whether every image is kept in the run folder.
    trial_limit_s
        How long an estimator may work at a trial; one that takes longer is stopped, and its row is an error. No limit
        if left out.
    listener
        Is told how the run goes; the logger ``campaign`` if left out.

    Returns
    -------
    DataFrame
        One row for each scenario, trial and estimator, with the columns of the table ``rows`` of the README, of no
        more trials than were asked for. ``attrs["folder"]`` is the run folder, for `reports.read_run`.

    Raises
    ------
    BoresightError
        If anything that is asked for is wrong, or the folder holds another run, is in use or cannot be written.
    """
    begun = start(
        str(name),
        overrides=overrides,
        seed=seed,
        trials=trials,
        until=until,
        jobs=jobs,
        out=None if out is None else Path(out),
        variant=variant,
        keep_images=keep_images,
        trial_limit_s=trial_limit_s,
    )
    folder = begun.go(listener or _Logged())
    stored = folder.table("rows")
    rows = stored[stored["trial"] < begun.request.trials].reset_index(drop=True)
    rows.attrs["folder"] = str(folder.path)
    return rows

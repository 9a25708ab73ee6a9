"""Start of a run from the command line or from Python; `boresight.run` returns the rows of a run."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from boresight.campaign import RUNS
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.runs.check import check_campaign
from boresight.campaign.runs.execute import Listener, run_campaign
from boresight.campaign.runs.manifest import Cluster, RunRequest
from boresight.campaign.runs.resolve import resolve
from boresight.campaign.store import RunFolder
from boresight.campaign.threads import workers
from boresight.campaign.trial.kind import Records
from boresight.renderers.mitsuba3 import choose_variant
from boresight.scenarios.errors import BoresightError

if TYPE_CHECKING:
    from boresight.campaign.runs.until import Until

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
    embedded: bool = False,
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
    embedded
        Whether built-in bodies replace the shape files that they stand for: the run gives values, but no verdicts.
    listener
        Is told how the run goes; the logger ``campaign`` if left out.

    Returns
    -------
    DataFrame
        One row for each scenario, trial and estimator, with the columns of the table ``rows`` of the README, of no
        more trials than were asked for. ``attrs["folder"]`` is the run folder, for `boresight.read_run`.

    Raises
    ------
    BoresightError
        If anything that is asked for is wrong, or the folder holds another run, is in use or cannot be written.
    """
    begun = start(
        str(name), overrides=overrides, seed=seed, trials=trials, until=until, jobs=jobs,
        out=None if out is None else Path(out), variant=variant, keep_images=keep_images, trial_limit_s=trial_limit_s,
        embedded=embedded,
    )  # fmt: skip
    folder = begun.go(listener or _Logged())
    stored = folder.table("rows")
    rows = stored[stored["trial"] < begun.request.trials].reset_index(drop=True)
    rows.attrs["folder"] = str(folder.path)
    return rows


@dataclass(frozen=True, slots=True)
class Start:
    """A run that is about to begin, all that could be refused beforehand checked.

    ``until`` says when to stop before all trials are run. ``advice`` is what would make this machine faster, or ''.
    """

    campaign: ResolvedCampaign
    request: RunRequest
    until: Until | None
    advice: str

    def go(self, listener: Listener) -> RunFolder:
        """Run what is not stored yet."""
        if self.until is None:
            return run_campaign(self.campaign, self.request, listener)
        # Imported here, as below: scipy.stats takes a third of the start-up, and most runs need none of it.
        from boresight.campaign.runs.until import run_until

        return run_until(self.campaign, self.request, self.until, listener)


def start(
    name: str,
    *,
    overrides: Sequence[str] = (),
    seed: int | None = None,
    trials: int | None = None,
    until: str | None = None,
    jobs: int | None = None,
    out: Path | None = None,
    variant: str | None = None,
    keep_images: bool = False,
    cluster: Cluster | None = None,
    trial_limit_s: float | None = None,
    embedded: bool = False,
    command: str = "",
) -> Start:
    """Read a campaign and say how it is to run; what is left out is as the campaign, or the machine, says.

    Raise BoresightError if a file, a key, a value or a name is wrong, or more trials are asked for than there are real
    images.
    """
    chosen = choose_variant(variant)
    campaign = resolve(name, overrides, seed, chosen.name, embedded=embedded)
    if embedded and not campaign.embedded and not any(one.spec.images for one in campaign.scenarios):
        raise BoresightError(f"--embedded: {name} reads no shape file that a built-in body stands for: leave it out")
    wanted = campaign.spec.trials if trials is None else trials
    processes = workers(jobs, chosen.name)
    for what, number in (("--trials", wanted), ("--jobs", processes)):
        if number < 1:
            raise BoresightError(f"{what} {number}: give 1 or more")
    check_campaign(campaign, wanted)
    if trial_limit_s is not None and not 0.0 < trial_limit_s < math.inf:
        raise BoresightError(f"--trial-limit {trial_limit_s:g}: give a number of seconds above 0")
    condition = None
    if until is not None:
        from boresight.campaign.runs.until import until as read_until

        condition = read_until(until, campaign)
    folder = out or RUNS / f"{campaign.spec.name}-{campaign.digest[:8]}"
    if cluster is not None and keep_images:
        raise BoresightError("--keep-images: workers of a cluster cannot write to the run folder: leave it out")
    request = RunRequest(folder, wanted, processes, keep_images, command, cluster, trial_limit_s)
    return Start(campaign, request, condition, chosen.advice)

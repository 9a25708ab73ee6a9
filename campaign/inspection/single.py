"""One image, or one trial of one method, for a program or a notebook: no campaign file, no run folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from boresight.campaign.imaging.world import check_views, open_world
from boresight.campaign.inspection.build import draw_case
from boresight.campaign.inspection.recompute import Case, Recomputed, recompute, reopened
from boresight.campaign.inspection.show import CaseFigures, show_of
from boresight.campaign.machine import cores
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.runs.check import check_campaign, kind_of
from boresight.campaign.runs.execute import build_products
from boresight.campaign.runs.manifest import RunRequest
from boresight.campaign.runs.resolve import of_scenario
from boresight.campaign.store import RunFolder, find_run
from boresight.campaign.trial.kind import InspectedTrial
from boresight.renderers.mitsuba3 import choose_variant
from boresight.reports.figures.named import NamedFigure
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import View
from boresight.scenarios.load import load_scenario


@dataclass(frozen=True, slots=True, eq=False)
class Rendered:
    """The image of a trial with its truth.

    Parameters
    ----------
    image
        (H, W) float32: digital numbers with a ``detector`` section, radiance factors without. Row 0 is the top.
    view
        Camera, pose (x_cam = R x_body + t, metres) and direction to the Sun in body axes. Of real images the reference.
    name
        File of a real image, else ''.
    """

    image: NDArray[np.float32]
    view: View
    name: str = ""

    def plot(self) -> Figure:
        """Draw the image in pixels: the centre of the first pixel is (0.5, 0.5)."""
        height, width = self.image.shape
        figure = Figure(figsize=(5.0, 5.0 * height / width), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.add_subplot()
        axes.imshow(self.image, cmap="gray", extent=(0.0, width, height, 0.0))
        axes.set(xlabel="u, px", ylabel="v, px", title=self.name)
        return figure


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """One trial of one method. The types of truth, observation and estimate are those of the kind of trial.

    Parameters
    ----------
    row
        What a campaign stores of it: status, reason, errors and circumstances, by the columns of the table ``rows``.
    tables
        The other tables that it adds to, by name.
    image
        (H, W), as the camera took it; None where methods see tracks or data.
    truth
        Of a single image its `View`; of sequences and orbits the true motion.
    observation
        What the method saw: of a single image an `Observation`, of a sequence a `TrackSequence`.
    estimate
        What the method returned; None where it raised or broke its contract.
    """

    row: Mapping[str, object]
    tables: Mapping[str, pd.DataFrame]
    image: NDArray[np.float32] | None
    truth: object
    observation: object
    estimate: object | None
    _again: Recomputed
    _campaign: ResolvedCampaign

    def _drawn(self) -> CaseFigures:
        return draw_case(self._again, show_of(self._campaign.spec.experiment), self._campaign)

    def figures(self) -> list[NamedFigure]:
        """Draw its stages, as ``boresight inspect`` does: figures with captions."""
        return list(self._drawn().figures)

    def plot(self) -> Figure:
        """Draw the first of its figures; of a single image, the body at the prior, the estimate and the truth.

        Raises
        ------
        BoresightError
            If the trial ended before there was anything to draw.
        """
        found = self._drawn()
        for first in found.figures:
            return first.figure
        raise BoresightError(f"{self._again.case}: {' '.join(found.notes)}")


def render(scenario: str | PathLike[str], trial: int = 0, *, seed: int = 1, overrides: Sequence[str] = ()) -> Rendered:
    """Render the image of a trial, or read it where images are real.

    Parameters
    ----------
    scenario
        A name from ``boresight list``, or a YAML file.
    trial, seed
        The view, the light and the noise follow from these, as in a campaign of that seed.
    overrides
        Keys to change, such as ``["camera.fov_deg=20"]``.

    Raises
    ------
    BoresightError
        If anything of the scenario is wrong, or it has no images of single views.
    """
    loaded = load_scenario(str(scenario), overrides)
    check_views(loaded)
    made = open_world(loaded, choose_variant().name).source.trial_image(seed, trial)
    return Rendered(made.image, made.view, made.image_name)


def trial(
    scenario: str | PathLike[str],
    estimator: str,
    trial: int = 0,
    *,
    seed: int = 1,
    options: Mapping[str, object] | None = None,
    overrides: Sequence[str] = (),
    experiment: str | None = None,
) -> Trial:
    """Run one trial of one method, as a campaign of that seed would.

    Parameters
    ----------
    scenario
        A name from ``boresight list``, or a YAML file.
    estimator
        A name from ``boresight list``, ``module:Class`` or ``file.py:Class``.
    trial, seed
        Which trial; data bases are built, or taken from the cache, before it.
    options
        Of the estimator.
    overrides
        Keys of the scenario to change, such as ``["camera.fov_deg=20"]``.
    experiment
        The kind of trial; that which the scenario's sections ask for if left out.

    Raises
    ------
    BoresightError
        If a name, a key or an option is wrong. What the method does wrong is in ``row``.
    """
    loaded = load_scenario(str(scenario), overrides)
    campaign = of_scenario(
        loaded, {estimator: dict(options or {})}, experiment or kind_of(loaded), seed, choose_variant().name
    )
    check_campaign(campaign, trial + 1)
    with TemporaryDirectory(prefix="boresight-") as folder:
        build_products(campaign, RunRequest(Path(folder), trial + 1, cores()), None)
        found = recompute(campaign, RunFolder(Path(folder)), Case(loaded.spec.name, campaign.labels[0], trial))
    return _trial(campaign, found)


def inspect(run: str | PathLike[str], scenario: str, estimator: str, trial: int) -> Trial:
    """Compute a trial of a stored run again.

    Parameters
    ----------
    run
        A run folder, or the name of a campaign for its newest run.
    scenario, estimator, trial
        Which one: the label of the estimator.

    Raises
    ------
    BoresightError
        If there is no such run or trial, or code or data differ from those that it was made with.
    """
    folder = find_run(str(run))
    campaign = reopened(folder)
    if scenario not in [one.spec.name for one in campaign.scenarios] or estimator not in campaign.labels:
        raise BoresightError(f"{folder.path}: has no trials of {scenario} / {estimator}")
    return _trial(campaign, recompute(campaign, folder, Case(scenario, estimator, trial)))


def _trial(campaign: ResolvedCampaign, found: Recomputed) -> Trial:
    tables = {name: pd.DataFrame(records) for name, records in found.records.items() if records and name != "rows"}
    seen = found.shown or InspectedTrial(None, None, None)
    shown = (seen.image, seen.truth, seen.observation, seen.estimate)
    return Trial(found.row, tables, *shown, found, campaign)

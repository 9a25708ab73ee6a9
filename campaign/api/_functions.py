"""The commands as functions: what they print or write, as values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import pandas as pd

from boresight.campaign import RUNS
from boresight.campaign.cli.catalog import as_yaml
from boresight.campaign.cli.report import source_of, write
from boresight.campaign.papers.page import paper_called, paper_page
from boresight.campaign.runs.read import CampaignFiles, is_campaign, read_campaign
from boresight.campaign.store import find_run
from boresight.reports.compare import compare_runs
from boresight.reports.compare.tables import consistency_tables, contrast_tables, subject_tables
from boresight.reports.pages.paper import write_paper
from boresight.scenarios.load import LoadedScenario, load_scenario

Name = str | PathLike[str]


def load(name: Name, overrides: Sequence[str] = ()) -> LoadedScenario | CampaignFiles:
    """Read a scenario or a campaign, checked and with every default filled in.

    Parameters
    ----------
    name
        A name from ``boresight list``, or a YAML file.
    overrides
        Keys of the scenario, or of every scenario, to change, such as ``["camera.fov_deg=20"]``.

    Raises
    ------
    BoresightError
        If there is none of that name, or a key or a value is wrong.
    """
    found = read_campaign if is_campaign(str(name)) else load_scenario
    return found(str(name), overrides)


def show(name: Name, overrides: Sequence[str] = ()) -> str:
    """Return a scenario or a campaign as YAML, every default filled in. Arguments and errors are those of `load`."""
    return as_yaml(load(name, overrides))


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Compared runs.

    Parameters
    ----------
    subjects
        One row for each subject and statistic, with n_ok, n and the 95 % interval.
    differences
        One row for each pair of subjects: differences on the same trials, with intervals.
    consistency
        NEES of subjects with a covariance.
    """

    subjects: pd.DataFrame
    differences: pd.DataFrame
    consistency: pd.DataFrame


def compare(
    *runs: Name, metric: str | None = None, by: Sequence[str] | None = None, unpaired: bool = False
) -> Comparison:
    """Compare estimators, scenarios or whole runs.

    Parameters
    ----------
    runs
        Run folders, or names of campaigns for their newest runs.
    metric
        Column to compare by; the position error if left out.
    by
        What makes the subjects: ``estimator``, ``scenario``, ``run`` or a key of the scenarios; estimator and scenario
        if left out, and the run where several runs have the same ones.
    unpaired
        Whether subjects whose trials are not the same are compared as independent samples.

    Raises
    ------
    BoresightError
        If a run cannot be read, metric or factor is unknown, or the trials of two runs are not the same.
    """
    found = compare_runs([find_run(str(run)).path for run in runs], metric, by, unpaired)
    return Comparison(subject_tables(found)[1], contrast_tables(found)[1], consistency_tables(found)[1])


def report(run: Name, *, worst: int = 3, pdf: bool = False) -> Path:
    """Write the report of a run into its folder, and return its page.

    Parameters
    ----------
    run
        A run folder, or the name of a campaign for its newest run.
    worst
        How many of the worst trials are computed again and drawn.
    pdf
        Whether figures are written as PDF too.

    Raises
    ------
    BoresightError
        If there is no such run, it has no finished trial, or its folder cannot be written.
    """
    folder = find_run(str(run))
    write(folder, worst, pdf, source_of(folder, worst, pdf))
    return folder.path / "report" / "report.html"


def figures(paper: str, *, runs: Name = RUNS, out: Name | None = None, jobs: int | None = None) -> Path:
    """Draw every figure of a paper from the newest runs of its campaigns, with its numbers and ours; return the page.

    Parameters
    ----------
    paper
        ``rowell2015``, ``delpech2015`` or ``cheng2003``.
    runs
        Folder of the run folders.
    out
        Where the page goes; ``figures/PAPER`` if left out.
    jobs
        Worker processes; the cores if left out.

    Raises
    ------
    BoresightError
        If there is no such paper, or the page cannot be written.
    """
    page = paper_page(paper_called(paper), Path(runs), jobs)
    return write_paper(page, Path("figures") / paper if out is None else Path(out))

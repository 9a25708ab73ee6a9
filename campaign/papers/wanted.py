"""Data sets of a paper, a campaign or a name."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from boresight.campaign.catalog import PAPERS
from boresight.campaign.runs.read import CATALOG, campaign_names
from boresight.campaign.runs.requirements import needs
from boresight.scenarios.data.datasets import DataSet, datasets, datasets_providing
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import load_campaign
from boresight.scenarios.load.files import SUFFIXES

ALL = "all"


@dataclass(frozen=True, slots=True)
class Wanted:
    """Data sets that can be fetched, those that a user must bring, and missing files of no known data set."""

    fetched: tuple[DataSet, ...]
    own: tuple[DataSet, ...]
    unknown: tuple[str, ...] = ()


def wanted(name: str) -> Wanted:
    """Return the data sets of a name: a data set, a campaign or its file, a paper, or ``all``.

    Raise BoresightError if there is nothing of that name, or it is a data set that cannot be fetched.
    """
    known = datasets()
    if name == ALL:
        return _sorted_out(known.values())
    if name in known:
        one = known[name]
        if one.published is not None:
            raise BoresightError(
                f"{name}: cannot be fetched, because its checksum or its licence is not known: bring your own into"
                f" {one.folder}; published at {one.published}"
            )
        return Wanted((one,), ())
    if name in PAPERS:
        # Imported here: a paper's figures take 2 s.
        from boresight.campaign.papers.page import paper_called, paper_campaigns

        return wanted_by(paper_campaigns(paper_called(name)))
    if name in campaign_names() or Path(name).suffix in SUFFIXES:
        return wanted_by([name])
    choices = [ALL, *PAPERS, *known, *campaign_names()]
    near = difflib.get_close_matches(name, choices, n=1)
    hint = f"did you mean {near[0]}?" if near else "see: boresight fetch --list"
    raise BoresightError(f"{name}: no such data set, campaign or paper; {hint}")


def wanted_by(campaigns: Iterable[str]) -> Wanted:
    """Return the data sets that campaigns read, named or given as files."""
    found: list[DataSet] = []
    unknown: list[str] = []
    for campaign in campaigns:
        for need in needs(load_campaign(campaign, CATALOG)):
            if need.kind:
                sets = datasets_providing([f"{need.kind}/{need.name}", need.name])
                found += sets
                unknown += [] if sets or need.found else [need.name]
    return _sorted_out(found, unknown)


def _sorted_out(found: Iterable[DataSet], unknown: Iterable[str] = ()) -> Wanted:
    sets = list({one.name: one for one in found}.values())
    return Wanted(
        tuple(one for one in sets if one.published is None),
        tuple(one for one in sets if one.published is not None),
        tuple(dict.fromkeys(unknown)),
    )

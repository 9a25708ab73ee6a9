"""The page of an estimator: what it does, when to use it, when it fails, its cost, its source and its options.

The texts are the docstring of the estimator's class, which has the sections `SECTIONS`.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import Field

from boresight.estimators.registry import (
    DETECTORS,
    ESTIMATORS,
    MATCHERS,
    ORBIT_ESTIMATORS,
    SEQUENCE_ESTIMATORS,
    Registry,
)
from boresight.scenarios.spec.base import SpecModel

FAMILIES: Mapping[str, Registry[Any]] = {
    "Estimators of single images": ESTIMATORS,
    "Estimators of sequences": SEQUENCE_ESTIMATORS,
    "Crater detectors": DETECTORS,
    "Crater matchers": MATCHERS,
    "Orbit determination": ORBIT_ESTIMATORS,
}
SECTIONS = ("Use it when", "It fails when", "Cost", "Source")
COSTS = "Median processor time on one core of an AMD EPYC; images, data bases and compilation are not included."
"""What the numbers of all sections on costs are."""

_HEADING = re.compile(rf"^({'|'.join(SECTIONS)})\n-+\n", re.MULTILINE)


class _SeenSpec(SpecModel):
    """What a trial of any crater matcher is told besides the matcher's own options."""

    detector: str | None = Field(
        None,
        description="Crater detector that finds the craters in rendered images (crater_pairs.images), such as"
        " crater-classic; left out where they are drawn by geometry (crater_pairs.craters)",
    )


@dataclass(frozen=True, slots=True)
class EstimatorPage:
    """The page of an estimator, whose name and version are those of a campaign and a row.

    ``family`` is a key of `FAMILIES`; '' for a class that no registry holds. ``summary`` is the first paragraph of the
    docstring, ``text`` the others before its sections, and ``sections`` the text of each of `SECTIONS` that it has.
    ``options`` are the models of its options: its own, if the class names one, and that of its family, if trials take
    more.
    """

    name: str
    version: int
    family: str
    summary: str
    text: str
    sections: Mapping[str, str]
    options: tuple[type[SpecModel], ...]


def family_of(name: str) -> str:
    """Return the family of an estimator's name; that of single images for ``module:Class``, '' for an unknown name."""
    if ":" in name:
        return next(iter(FAMILIES))
    return next((family for family, registry in FAMILIES.items() if name in registry.names()), "")


def page_of(name: str) -> EstimatorPage:
    """Return the page of a registered estimator.

    Raise BoresightError if the name is unknown, or a foreign class cannot be imported.
    """
    family = family_of(name)
    found = FAMILIES[family].find(name) if family else ESTIMATORS.find(name)
    # `__doc__` of the class itself: a class without a docstring inherits none.
    before, *rest = _HEADING.split(inspect.cleandoc(found.__doc__ or ""))
    summary, _, text = before.partition("\n\n")
    sections = {heading: told.strip() for heading, told in zip(rest[::2], rest[1::2], strict=True)}
    options = (getattr(found, "options_model", None), _SeenSpec if found.name in MATCHERS.names() else None)
    return EstimatorPage(
        found.name, found.version, family, summary, text.strip(), sections, tuple(filter(None, options))
    )

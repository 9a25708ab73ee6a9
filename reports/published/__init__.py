"""Published values that a campaign is compared with, each with its place in the paper and its tolerance."""

from __future__ import annotations

import re
from collections.abc import Sequence
from importlib import resources
from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from boresight.reports.schema.records import DERIVED, DIAGNOSTICS, RATIO, REDUCTION
from boresight.reports.schema.tables import measures, unit_of
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load.yaml_text import parse_yaml
from boresight.scenarios.reading import held_to

_FILES = ("cheng2003.yaml", "delpech2015.yaml", "rowell2015.yaml")
_SCALE = {("ms", "s"): 1e-3, ("pixels", "px"): 1.0} | {(unit, unit): 1.0 for unit in ("", "m", "deg", "s", "px", "%")}
"""Factors by unit of a printed number and unit of a measure."""
_PRINTED = r"^(?:up to )?~?(?P<low>[\d,]+(?:\.\d+)?)(?:-(?P<high>\d+(?:\.\d+)?))?(?: (?P<unit>%|[a-z]+))?$"


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class PublishedValue(_Model):
    """One printed number, or a printed range, whose middle is taken; ``place`` is where it is printed.

    ``measure``, ``stage`` and ``statistic`` name our number that it is compared with; ``scenario`` and ``estimator``
    whose it is, '' for all. For a reduction ``against`` is the scenario or the estimator whose mean the reduction is
    from, for a ratio the estimator whose mean is divided by.

    ``printed`` is number and unit, verbatim; ``words`` are the paper's where it gives no number, and ``printed`` is
    then how they are read. ``tolerance`` is the half-width of the band that counts as reproduced, in the measure's
    unit; None where no verdict is due. ``relation`` is ``about`` the number, or ``above`` or ``below`` it, whatever the
    tolerance. ``at_most`` bounds what is ``above`` where the words do: "somewhat broader than 3" is not 300. ``better``
    is the side of the band that is an improvement.
    """

    measure: str
    stage: str
    statistic: str
    printed: str = Field(pattern=_PRINTED.replace("?P<low>", "").replace("?P<high>", "").replace("?P<unit>", ""))
    tolerance: float | None = Field(None, gt=0)
    words: str = ""
    relation: Literal["about", "above", "below"] = "about"
    at_most: float | None = None
    scenario: str = ""
    estimator: str = ""
    against: str = ""
    better: Literal["lower", "higher", "neither"] = "neither"
    place: str = Field(min_length=1)

    @model_validator(mode="after")
    def _known(self) -> Self:
        if self.measure not in measures() and self.stage not in (DIAGNOSTICS, DERIVED):
            raise ValueError(f"measure {self.measure!r} is not one of {', '.join(sorted(measures()))}")
        if self.at_most is not None and (self.relation != "above" or self.at_most <= self.value):
            raise ValueError(f"at_most {self.at_most:g} bounds what is above {self.printed}, and lies above that")
        if (self.stage in (REDUCTION, RATIO)) != bool(self.against):
            raise ValueError(f"a {REDUCTION} or a {RATIO} names what it is against, and nothing else does")
        if (self._part("unit"), unit_of(self.measure)) not in _SCALE:
            raise ValueError(f"{self.printed!r}: unit {self._part('unit')!r} does not fit {self.measure}")
        return self

    @property
    def quoted(self) -> str:
        """The printed number, or the paper's words with our reading of them."""
        bound = "" if self.at_most is None else f", at most {self.at_most:g}"
        return f'"{self.words}" (read as {self.printed}{bound})' if self.words else self.printed

    def _part(self, name: str) -> str:
        found = re.match(_PRINTED, self.printed)
        return (found and found[name]) or ""

    @property
    def value(self) -> float:
        """The printed number, or the middle of the printed range, in the unit of the measure."""
        low = self._part("low").replace(",", "")
        middle = 0.5 * (float(low) + float(self._part("high") or low))
        return middle * _SCALE[self._part("unit"), unit_of(self.measure)]


class Term(_Model):
    """One of the values that a statement puts in order, by the fields in which it differs from the others.

    A field is '' for that of the statement.
    """

    estimator: str = ""
    against: str = ""
    scenario: str = ""
    stage: str = ""
    measure: str = ""
    statistic: str = ""

    @property
    def label(self) -> str:
        """The fields in which the value differs from the others of its statement."""
        whose = f"{self.estimator} / {self.against}" if self.against else self.estimator
        given = (self.scenario, whose, self.stage, self.measure, self.statistic)
        return ", ".join(part for part in given if part)


class PublishedClaim(_Model):
    """A statement of the paper in words, verbatim, and how our rows are compared with it; give one of three ways.

    ``order`` are values of one run that ascend by the words; a label alone is the value of that estimator. The other
    fields say which values, where its terms do not; ``against`` is the estimator that a ratio is over, ``scenario`` ''
    for every one.

    ``solves`` is the label of the estimator that "is functional": it solves at least the ``share`` of trials, nine of
    ten by our reading, 1 for "all". A trial is solved up to the true error ``within``, by ``measure`` and in its unit;
    without it, if the estimator itself calls it solved.

    ``unmeasured`` says why no stored row of ours can decide it, ``unjudged`` why no verdict is due, though our values
    are known.
    """

    text: str = Field(min_length=1)
    order: tuple[Term, ...] = ()
    estimator: str = ""
    against: str = ""
    measure: str = "position_error_m"
    stage: str = "final"
    statistic: str = "median"
    solves: str = ""
    share: float = Field(0.9, gt=0, le=1)
    within: float | None = Field(None, gt=0)
    unmeasured: str = ""
    unjudged: str = ""
    scenario: str = ""
    place: str = Field(min_length=1)

    @field_validator("order", mode="before")
    @classmethod
    def _labels(cls, order: object) -> object:
        if not isinstance(order, Sequence) or isinstance(order, str):
            return order
        return tuple({"estimator": item} if isinstance(item, str) else item for item in order)

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if [bool(self.order), bool(self.solves), bool(self.unmeasured)].count(True) != 1:
            raise ValueError("give one of order, solves and unmeasured")
        if len(self.order) == 1:
            raise ValueError("order: one value has none")
        if self.unjudged and not self.order:
            raise ValueError("unjudged says why an order has no verdict: give the order")
        if self.within is not None and not self.solves:
            raise ValueError("within says up to which error a trial is solved: give solves")
        return self

    @property
    def compared_statistic(self) -> str:
        """The statistic of our values."""
        return self.statistic if self.within is None else within_statistic(self.within)


def within_statistic(bound: float) -> str:
    """Return the statistic of a record that counts the trials with an error up to a bound."""
    return f"within {bound:g}"


class Comparison(_Model):
    """The values and the claims of one experiment of a paper.

    ``conditions`` say how the paper's numbers were obtained, and what differs from ours; ``verdicts`` is False where
    that is so much that a verdict would mean nothing. ``methods`` are the labels of the paper's own estimators, for
    values that name none. With ``radius_m`` the paper turns a pixel into a rotation and a displacement. ``bounds`` say
    by which rules tolerances and bounds were chosen, and what was known of our values then.
    """

    conditions: str
    methods: tuple[str, ...] = ()
    verdicts: bool = True
    values: tuple[PublishedValue, ...] = ()
    claims: tuple[PublishedClaim, ...] = ()
    radius_m: float | None = Field(None, gt=0)
    source: str = ""
    bounds: str = ""

    @model_validator(mode="after")
    def _distinct(self) -> Self:
        if not self.values and not self.claims:
            raise ValueError("neither values nor claims are given")
        keys = [(v.scenario, v.estimator, v.against, v.measure, v.stage, v.statistic) for v in self.values]
        repeated = {key for key in keys if keys.count(key) > 1}
        if repeated:
            raise ValueError(f"values are given twice: {sorted(repeated)}")
        return self

    def find(self, measure: str, stage: str, statistic: str) -> PublishedValue | None:
        """Look a value up; None if the paper does not print it."""
        key = (measure, stage, statistic)
        return next((value for value in self.values if (value.measure, value.stage, value.statistic) == key), None)


class _Document(_Model):
    source: str
    bounds: str
    methods: tuple[str, ...] = Field(description="Labels under which the paper's own methods run")
    comparisons: dict[str, Comparison]


def published_names() -> list[str]:
    """List the keys that a campaign's ``report:`` may name."""
    return sorted(name for file in _FILES for name in _read(file).comparisons)


def load_published(name: str) -> Comparison:
    """Load the published values called ``name``; raise `BoresightError` if there are none of that name."""
    for file in _FILES:
        document = _read(file)
        if name in document.comparisons:
            own = {"source": document.source, "bounds": document.bounds, "methods": document.methods}
            return document.comparisons[name].model_copy(update=own)
    raise BoresightError(f"report: no published values are called {name!r}; known are {', '.join(published_names())}")


def _read(file: str) -> _Document:
    return parse(resources.files(__name__).joinpath(file).read_text(encoding="utf-8"), file)


def parse(text: str, file: str) -> _Document:
    """Validate a file of published values; raise `BoresightError` if it is not YAML or does not fit the schema."""
    try:
        return held_to(_Document, parse_yaml(text, file).plain())
    except ValueError as error:
        raise BoresightError(f"{file}: {error}") from error

"""Several data bases of one campaign: what is drawn once in a run, and not in each trial, is drawn for each of them.

Data base 0 is that of a campaign with a single one, bit for bit.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

from scenarios.load import LoadedScenario
from scenarios.spec.base import SpecModel
from scenarios.spec.scenario import OnboardSpec

Options = TypeVar("Options", bound=SpecModel)

APART = 10_000
"""Between the seeds of two data bases, so that none meets a seed near by that something else was made with."""


def differs(scenario: LoadedScenario) -> frozenset[str]:
    """Name what of a scenario is drawn for a data base: ``world`` (its craters), ``knowledge`` (the shape on board)."""
    found = {"world"} if scenario.spec.craters is not None else set()
    return frozenset(found | ({"knowledge"} if _drawn_onboard(scenario.spec.onboard) else set()))


def with_world(scenario: LoadedScenario, database: int) -> LoadedScenario:
    """Return a scenario with the craters of a data base: its trials see them, and it is made of them."""
    craters = scenario.spec.craters
    if database == 0 or craters is None:
        return scenario
    return replace(scenario, spec=scenario.spec.model_copy(update={"craters": of_database(craters, database)}))


def with_knowledge(scenario: LoadedScenario, database: int) -> LoadedScenario:
    """Return a scenario with the errors of the shape on board that a data base has."""
    drawn = _drawn_onboard(scenario.spec.onboard)
    if database == 0 or not drawn:
        return scenario
    onboard = scenario.spec.onboard.model_copy(update={k: of_database(v, database) for k, v in drawn.items()})
    return replace(scenario, spec=scenario.spec.model_copy(update={"onboard": onboard}))


def of_database(options: Options, database: int) -> Options:
    """Return options with the seed of a data base; a seed that is left out counts as 0."""
    if database == 0:
        return options
    seed: int = getattr(options, "seed") or 0  # noqa: B009  not every model has one, but all that are given here
    return options.model_copy(update={"seed": seed + APART * database})


def _drawn_onboard(onboard: OnboardSpec) -> dict[str, SpecModel]:
    """Return the sections of the knowledge on board that chance decides, but not in each trial: they have a seed."""
    sections = {name: getattr(onboard, name) for name in OnboardSpec.model_fields}
    return {name: section for name, section in sections.items() if hasattr(section, "seed")}

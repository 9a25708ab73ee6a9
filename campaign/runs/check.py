"""Checks of a campaign before anything is built: bodies, images, scenarios, options and published values."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

from boresight.campaign.catalog import PAPERS
from boresight.campaign.imaging.preview import images_of, preview
from boresight.campaign.imaging.world import check_bodies, trial_limit
from boresight.campaign.machine import cores
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.runs.read import campaign_names, core_seconds, in_words, needs_of_scenario
from boresight.campaign.runs.unused import check_used, widest_kind
from boresight.campaign.trial.kind import kind_named
from boresight.reports.published import load_published
from boresight.reports.schema.records import CONTROLS, count_of
from boresight.reports.schema.tables import AFTER_REVOLUTIONS
from boresight.reports.statistics.requirements import Requirement, read_requirement
from boresight.scenarios.bodies import Body
from boresight.scenarios.data import data_folder
from boresight.scenarios.data.datasets import datasets
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import ConfigEntry, LoadedScenario
from boresight.scenarios.load.lengths import dotted
from boresight.scenarios.spec.body import STAND_INS
from boresight.scenarios.spec.campaign import CampaignSpec

_MOST_SHOWN = 4

_KINDS = {
    "viewpoint": "single-image",
    "images": "single-image",
    "sequence": "sequence",
    "crater_pairs": "crater-matching",
    "orbit": "orbit-determination",
}
"""Section of a scenario to the kind of trial that needs it, and no other."""

_WITHOUT_IMAGES = ("pose-convergence", "landmark-database")
"""Kinds whose trials show no image of the scenario's views."""


def check_campaign(campaign: ResolvedCampaign, trials: int) -> list[tuple[Body, Body]]:
    """Read all that a run of so many trials of each scenario reads, and refuse what could not run.

    Raise BoresightError if a shape or an image is missing or wrong, a scenario does not suit the kind of trial, an
    option is wrong, there are no such published values, or more trials are asked for than there are real images.
    Return the bodies of each scenario, see `check_bodies`.
    """
    check_data(campaign)
    if campaign.spec.report is not None:
        try:
            load_published(campaign.spec.report)
        except BoresightError as error:
            entry = campaign.entry("report")
            raise error if entry is None else BoresightError(f"{entry.place}: {error}") from error
    _check_requirements(campaign)
    kind = kind_named(campaign.spec.experiment)
    held = []  # scenarios of a grid share bodies, which are read once as long as they are held
    for scenario in campaign.scenarios:
        kind.build_methods(campaign, scenario)
        limit, bodies = check_scenario(scenario, campaign.spec.experiment)
        held.append(bodies)
        if limit is not None and trials > limit:
            entry = campaign.entry("trials") if trials == campaign.spec.trials else None
            asked = f"--trials {trials}" if entry is None else f"{entry.place}: {trials}"
            raise BoresightError(f"{asked}: {scenario.spec.name} has images for {limit} trials at most")
    return held


def _check_requirements(campaign: ResolvedCampaign) -> None:
    """Refuse a requirement that cannot be read, is asked twice, or of an estimator or a scenario that there is not."""
    known = {"estimators": campaign.labels, "scenarios": tuple(scenario.spec.name for scenario in campaign.scenarios)}
    entry = campaign.entry("requirements") or ConfigEntry(None, "requirements")
    items = entry.value if isinstance(entry.value, tuple) else (entry,) * len(campaign.spec.requirements)
    before = set[object]()
    for asked, item in zip(campaign.spec.requirements, items, strict=True):
        where = item.place
        try:
            requirement = read_requirement(asked.that, campaign.spec.experiment)
            for scenario in campaign.scenarios:
                if scenario.spec.name in (asked.scenarios or known["scenarios"]):
                    _check_revolutions(requirement, scenario)
        except BoresightError as error:
            raise BoresightError(f"{where}: {error}") from error
        same = replace(requirement, written=""), frozenset(asked.estimators), frozenset(asked.scenarios)
        if same in before:
            raise BoresightError(f"{where}: requirements: {asked.that!r} is there twice: leave one out")
        before.add(same)
        if not asked.estimators and set(campaign.labels) <= set(CONTROLS):
            raise BoresightError(f"{where}: {asked.that!r} is asked of no estimator: name some, or add one")
        for key, there in known.items():
            if not getattr(asked, key) and item.section is not None and key in item.section:
                place = item.section[key].place
                raise BoresightError(f"{place}: requirements: {key}: [] names none: leave the key out to ask all")
            unknown = [name for name in getattr(asked, key) if name not in there]
            if unknown:
                raise BoresightError(f"{where}: {key}: there is no {unknown[0]}: choose among {', '.join(there)}")


def _check_revolutions(requirement: Requirement, scenario: LoadedScenario) -> None:
    """Refuse the error after a revolution that the sequences of a scenario do not end."""
    found, sequence = AFTER_REVOLUTIONS.fullmatch(requirement.measure), scenario.spec.sequence
    ended = () if sequence is None else sequence.ended_revolutions
    if found is None or int(found[1]) in ended:
        return
    there = [f"error_after_{k}_m" for k in ended] or ["position_error_m"]
    named = ", ".join(there) if len(there) <= _MOST_SHOWN else f"{there[0]} to {there[-1]}"
    raise BoresightError(
        f"{requirement.written!r}: no frame of {scenario.spec.name} ends revolution {found[1]}: choose {named}"
    )


def check_data(campaign: ResolvedCampaign) -> None:
    """Raise `BoresightError` with all missing files of known data sets, and commands that bring them or do without."""
    absent: dict[str, str] = {}  # file or folder, as the scenario names it, to the data set that has it
    for scenario in campaign.scenarios:
        for need in needs_of_scenario(scenario):
            sets = [] if need.found else need.data_sets
            if sets:
                absent[need.name] = sets[0].name
    if not absent:
        return
    name, (they, them) = campaign.spec.name, ("is", "it") if len(absent) == 1 else ("are", "them")
    own = name if campaign.root is None or name in campaign_names() else campaign.root.place
    fetched = next((paper for paper in PAPERS if name.startswith(f"{paper}-")), own)
    made = dict.fromkeys(filter(None, (datasets()[one].made_by for one in absent.values())))
    fetch = any(datasets()[one].made_by is None for one in absent.values())
    ways = "; ".join(
        [*([f"boresight fetch {fetched} brings {them}"] if fetch else []), *(f"to make {them}: {one}" for one in made)]
    )
    if any(datasets()[one].published for one in absent.values()):
        ways += ", or says where to get what cannot be passed on"
    bodies = [STAND_INS[one] for one in absent if one in STAND_INS]
    if len(bodies) == len(absent) and all(scenario.spec.images is None for scenario in campaign.scenarios):
        ways += f"; or give the same command with --embedded, for values on the embedded body {' and '.join(bodies)}"
    named = [
        next(file for file, of in absent.items() if of == one) if count == 1 else f"{count} files of {one}"
        for one, count in Counter(absent.values()).items()
    ]
    raise BoresightError(f"{name}: {', '.join(named)} {they} missing, in {data_folder()} too: {ways}")


def check_scenario(scenario: LoadedScenario, experiment: str = "") -> tuple[int | None, tuple[Body, Body]]:
    """Read images and bodies of a scenario, and check it for a kind of trial, by default the one of its own section.

    Refuse keys that these trials would ignore. Return how many trials its real images allow, None if images are
    rendered; and its bodies, see `check_bodies`.
    """
    check_used(scenario, kind_named(experiment or widest_kind(scenario.spec)))
    limit, bodies, kind = trial_limit(scenario), check_bodies(scenario), kind_named(experiment or kind_of(scenario))
    unseen = [key for key in ("second_body", "stars") if getattr(scenario.spec, key) is not None]
    if unseen and kind.name in _WITHOUT_IMAGES:
        raise BoresightError(f"{scenario.path}: {unseen[0]} has no part in {kind.name}: leave it out")
    kind.check_scenario(scenario)
    return limit, bodies


def preflight(
    scenarios: Sequence[LoadedScenario],
    campaign: CampaignSpec | None = None,
    *,
    trials: int | None = None,
    detailed: bool = True,
) -> list[str]:
    """Describe the images of scenarios in a few lines each, the first name of those that are alike.

    Of a campaign, the time and the size of the images of ``trials``, by default its own, and the lengths that options
    leave out follow. See `preview` for ``detailed``.
    """
    trials = trials or (None if campaign is None else campaign.trials)
    names: dict[tuple[str, ...], str] = {}
    left = len(scenarios)
    for scenario in scenarios:
        if len(names) == _MOST_SHOWN:
            break
        names.setdefault(tuple(preview(scenario, detailed=detailed, trials=trials)), scenario.spec.name)
        left -= 1
    lines = [f"{name}: {line}" for told, name in names.items() for line in told]
    if left:
        lines.append(f"and {count_of(left, 'further scenario')}")
    if campaign is None or trials is None:
        return lines
    return [
        *lines,
        _cost_in_words(scenarios, campaign, trials),
        *lengths_in_words(scenarios, campaign),
    ]


def _cost_in_words(scenarios: Sequence[LoadedScenario], campaign: CampaignSpec, trials: int) -> str:
    """Say how long a campaign takes by its last run here, and what the images that it renders take at most."""
    core_s = core_seconds(campaign.name)
    time = "time not known before a first run here"
    if core_s is not None:
        time = f"{in_words(core_s * trials * len(scenarios) / cores())} on {cores()} core(s) by the last run here"
    specs = [scenario.spec for scenario in scenarios]
    # Four bytes a pixel, uncompressed.
    stored = sum(images_of(spec, trials) * 4 * spec.camera.width_px * spec.camera.height_px for spec in specs)
    size = f"; rendered images take {stored / 1e9:.2g} GB of the image store at most" if stored else ""
    return f"{count_of(trials, 'trial')} x {count_of(len(scenarios), 'scenario')}: {time}, data bases aside{size}"


def lengths_in_words(scenarios: Sequence[LoadedScenario], campaign: CampaignSpec) -> list[str]:
    """List the lengths that the options of methods leave out, over all scenarios; one line for methods that agree."""
    kind, labels = kind_named(campaign.experiment), dict[str, list[str]]()
    for entry in campaign.estimators:
        found: dict[str, list[float]] = {}
        for scenario in scenarios:
            for key, length_m in dotted(kind.lengths(entry, scenario)):
                found.setdefault(key, []).append(length_m)
        told = [
            f"{key} {' to '.join(f'{m:g}' for m in sorted({min(several), max(several)}))}"
            for key, several in found.items()
        ]
        if told:
            labels.setdefault(", ".join(told), []).append(entry.label)
    return [f"{', '.join(names)}: sizes from the pixels and the body, {told}" for told, names in labels.items()]


def kind_of(scenario: LoadedScenario) -> str:
    """Name the kind of trial that the sections of a scenario ask for."""
    return next(kind for section, kind in _KINDS.items() if getattr(scenario.spec, section) is not None)

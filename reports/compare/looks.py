"""What the figures of a comparison share."""

from __future__ import annotations

from reports.compare.factors import ESTIMATOR
from reports.compare.subjects import RunComparison, Subject
from reports.figures.looks import colour_of
from reports.figures.style import GREY, SERIES_COLOURS
from reports.schema.records import CONTROL


def subject_colours(found: RunComparison) -> dict[tuple[str, ...], str]:
    """Give each subject a colour: that of its estimator where each is of one, else one of its own; grey the control."""
    keys = [one.estimator or found.label(one.names) for one in found.subjects]
    named = [key for key in dict.fromkeys(keys) if key != CONTROL]
    pooled = any(not one.estimator for one in found.subjects)
    own = {key: SERIES_COLOURS[i % len(SERIES_COLOURS)] if pooled else colour_of(key) for i, key in enumerate(named)}
    return {one.names: own.get(key, GREY) for one, key in zip(found.subjects, keys, strict=True)}


def credit_lines(found: RunComparison) -> list[str]:
    """Credit lines of all runs, each once."""
    return list(dict.fromkeys(line for run in found.runs for line in run.manifest.credits))


def subjects_by_group(found: RunComparison) -> dict[str, dict[str, Subject]]:
    """Gather the subjects that differ in the estimator alone: name of the group, and label to subject.

    Where estimators are pooled, all subjects are one group.
    """
    gathered: dict[str, dict[str, Subject]] = {}
    for one in found.subjects:
        named = dict(zip(found.factors, one.names, strict=True))
        if ESTIMATOR not in found.factors:
            gathered.setdefault("", {})[found.label(one.names)] = one
            continue
        label = named.pop(ESTIMATOR)
        kept = [level for factor, level in named.items() if factor in found.varied]
        gathered.setdefault(", ".join(kept), {})[label] = one
    return gathered


def figure_title(found: RunComparison, what: str, group: str) -> str:
    """Write the title of a figure of one group."""
    return ", ".join(filter(None, (what, group, found.shared if ESTIMATOR in found.varied else "")))

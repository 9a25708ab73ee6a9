"""What the spacecraft was taken to know in a run: the line that stands beside each headline."""

from __future__ import annotations

from collections.abc import Iterator

from reports.run.data import RunData
from scenarios.known import Known, merged

UNTOLD = "What was known exactly on board cannot be told: the scenarios are of another version of boresight."
_FEW = 4


def short_line(*runs: RunData, scenario: str = "") -> str:
    """Say it of a scenario, or of all scenarios of some runs together, without details."""
    found = [run.known for run in runs]
    told = [one for known in found if known is not None for name, one in known.items() if scenario in ("", name)]
    return merged(told).line(short=True) if told and None not in found else UNTOLD


def known_lines(run: RunData) -> Iterator[str]:
    """Say it in full: a line for each group of scenarios with the same, or one for all of a grid."""
    if run.known is None:
        yield UNTOLD
        return
    groups: dict[Known, list[str]] = {}
    for name, one in run.known.items():
        groups.setdefault(one, []).append(name)
    if len(groups) > _FEW:
        yield merged(list(groups)).line()
        return
    for one, names in groups.items():
        yield f"{', '.join(names)}: {one.line()}" if len(groups) > 1 else one.line()

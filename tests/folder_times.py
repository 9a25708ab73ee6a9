"""``python tests/folder_times.py FOLDER [--write]``: processor time of the tests by folder, next to the committed one.

``BORESIGHT_TEST_TIMES=FOLDER make test`` writes the times (``tests/conftest.py``). All are divided by the yardstick
that the same processes ran, so that they depend little on the machine and on its load. Nothing fails here: a warning
says which folder takes half as much again as when ``folder_times.json`` was last written, which ``--write`` does.
"""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from pathlib import Path

COMMITTED = Path(__file__).with_suffix(".json")
GROWN = 1.5
"""Ratio to the committed time from which a folder is reported."""


def read_times(folder: Path) -> tuple[dict[str, float], float]:
    """Return the processor times of each folder of tests and of collecting, and the mean yardstick, in seconds."""
    seconds, yardsticks = defaultdict[str, float](float), []
    for file in sorted(folder.glob("*.jsonl")):
        for line in file.read_text().splitlines():
            what, value = json.loads(line)
            if what == "yardstick":
                yardsticks.append(value)
            else:
                seconds[what.partition("::")[0].rpartition("/")[0] or what] += value
    if not yardsticks:
        raise SystemExit(f"{folder}: no times of tests: run them with BORESIGHT_TEST_TIMES={folder}")
    return dict(seconds), sum(yardsticks) / len(yardsticks)


def table(seconds: dict[str, float], yardstick_s: float, committed: dict[str, float]) -> str:
    """Return one line for each folder and one for all, with a warning where a folder has grown."""
    found = {**dict(sorted(seconds.items())), "all": sum(seconds.values())}
    lines = [f"{'processor time of the tests':28}{'s':>9}{'yardsticks':>12}{'committed':>11}"]
    for name, value in found.items():
        units, before = value / yardstick_s, committed.get(name)
        warning = f"  WARNING: {units / before:.1f} times as much" if before and units > GROWN * before else ""
        lines.append(f"{name:28}{value:9.1f}{units:12.0f}{'new' if before is None else f'{before:.0f}':>11}{warning}")
    return "\n".join([*lines, f"one yardstick: {yardstick_s:.3f} s"])


def main() -> None:
    """Print the table, or write the times as those to compare with."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--write", action="store_true", help=f"write {COMMITTED.name}")
    asked = parser.parse_args()
    seconds, yardstick_s = read_times(asked.folder)
    committed = json.loads(COMMITTED.read_text()) if COMMITTED.exists() else {}
    print(table(seconds, yardstick_s, committed))  # noqa: T201  a command
    if asked.write:
        units = {name: round(value / yardstick_s) for name, value in sorted(seconds.items())}
        COMMITTED.write_text(json.dumps({**units, "all": sum(units.values())}, indent=2) + "\n")


if __name__ == "__main__":
    main()

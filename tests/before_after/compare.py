"""Compare the rows of small campaigns, one or more of each kind, before and after a change of the code, bit for bit.

    python tests/before_after/compare.py run CHECKOUT FOLDER
    python tests/before_after/compare.py compare BEFORE AFTER

``run`` runs every campaign beside this file, and the smoke campaigns of the catalog, with the code of a checkout: that
of the commit before the change in a worktree, and that with it. ``compare`` lists what differs and exits with 1 if a
value does. A column that has moved to another table of the same trials is found there by its name.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).parents[1]))
from link_tree import link_tree

CAMPAIGNS = Path(__file__).parent / "campaigns"
CATALOG = {"quickstart": 20, "delpech2015-smoke": 3, "orbit-smoke": 2, "endtoend-smoke": 1}
"""Campaigns that come with boresight, and how many trials of each are run."""

CLOCK_OR_TEXT = ("timings", "tracebacks", "said")
"""Tables that differ between two runs of the same code, or hold traces with the lines of the code."""

KEYS = ("trial", "scenario", "estimator")


def main() -> int:
    """Run the command that is asked for and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    first = commands.add_parser("run")
    first.add_argument("checkout", type=Path)
    first.add_argument("folder", type=Path)
    first.set_defaults(handler=lambda given: run(given.checkout.resolve(), given.folder.resolve()))
    second = commands.add_parser("compare")
    second.add_argument("before", type=Path)
    second.add_argument("after", type=Path)
    second.set_defaults(handler=lambda given: compare(given.before, given.after))
    given = parser.parse_args()
    return int(given.handler(given))


def run(checkout: Path, folder: Path) -> int:
    """Run all campaigns with the code of a checkout; each has a run folder of its own."""
    files = {file.stem: [str(file)] for file in sorted(CAMPAIGNS.glob("*.yaml")) if "estimators:" in file.read_text()}
    wanted = files | {name: [name, "--trials", str(trials)] for name, trials in CATALOG.items()}
    worst, tree = 0, folder / ".tree"
    link_tree(checkout, tree)
    for name, words in wanted.items():
        if (folder / name).exists():
            continue
        command = ["run", *words, "--jobs", "2", "--no-report", "--out", str(folder / name)]
        print(name, flush=True)
        worst = max(
            worst,
            subprocess.run(
                [sys.executable, "-m", "boresight", *command],
                cwd=checkout,
                env={**os.environ, "PYTHONPATH": str(tree)},
                check=False,
            ).returncode,
        )
    return worst


def compare(before: Path, after: Path) -> int:
    """Print what differs in the rows of two folders of runs."""
    differences, cells = 0, 0
    names = sorted(
        {path.name for path in (*before.iterdir(), *after.iterdir()) if path.is_dir() and path.name != ".tree"}
    )
    for name in names:
        old, new = tables(before / name), tables(after / name)
        cells += sum(table.size for table in old.values())
        for line, counts in unlike(old, new):
            differences += counts
            print(f"{name}: {line}")
    print(f"{len(names)} campaigns, {cells} values before; {differences} columns or tables differ")
    return int(differences > 0)


def tables(run_folder: Path) -> dict[str, pd.DataFrame]:
    """Read the tables of a run, in the order of their trials."""
    found = {}
    for path in sorted(run_folder.iterdir()) if run_folder.is_dir() else ():
        parts = sorted(path.glob("*.parquet"))
        if parts and path.name not in CLOCK_OR_TEXT:
            table = pd.concat([pd.read_parquet(part) for part in parts], ignore_index=True)
            found[path.name] = table.sort_values([k for k in KEYS if k in table], kind="stable", ignore_index=True)
    return found


def unlike(old: dict[str, pd.DataFrame], new: dict[str, pd.DataFrame]) -> Iterator[tuple[str, bool]]:
    """Yield a line for each column that has moved, is gone or differs, and whether that is a difference of values."""
    if not old or not new:
        yield f"there is no run {'before' if not old else 'after'}", True
        return
    for name, table in old.items():
        for column in (c for c in table.columns if c not in KEYS):
            if (table[column].isna() | (table[column] == "")).all() and column not in new.get(name, table):
                yield f"{name}.{column}: was empty, is gone", False
                continue
            where = [k for k, t in new.items() if column in t and same_trials(table, t)]
            if not where:
                yield f"{name}.{column}: is gone, or is of other trials", True
                continue
            here = name if name in where else where[0]
            if here != name:
                yield f"{name}.{column}: is in {here} now", False
            wrong = different(table[column], new[here][column])
            if wrong.any():
                row = int(np.flatnonzero(wrong)[0])
                key = ", ".join(f"{k} {table[k][row]}" for k in KEYS if k in table)
                then, now = table[column][row], new[here][column][row]
                yield f"{name}.{column}: {wrong.sum()} of {len(wrong)} differ, first {key}: {then!r}, now {now!r}", True


def same_trials(old: pd.DataFrame, new: pd.DataFrame) -> bool:
    """Tell whether two tables have a line each for the same trials."""
    keys = [key for key in KEYS if key in old]
    return len(old) == len(new) and keys == [key for key in KEYS if key in new] and old[keys].equals(new[keys])


def different(old: pd.Series, new: pd.Series) -> np.ndarray:
    """Compare two columns, bit for bit; two missing values are the same."""
    missing = (old.isna() & new.isna()).to_numpy()
    if pd.api.types.is_float_dtype(old) and pd.api.types.is_float_dtype(new):
        same = old.to_numpy(np.float64).view(np.int64) == new.to_numpy(np.float64).view(np.int64)
    else:
        same = (old.astype(object) == new.astype(object)).to_numpy()
    return ~(same | missing)


if __name__ == "__main__":
    sys.exit(main())

"""``python -m hostile.survey READER... [--inputs N] [--seed N] [--keep FOLDER]``: all that goes wrong, not one thing.

Inputs are drawn as those of the fast tests, without hypothesis's search and shrinking, which makes this several times
faster than the long ones. Each fault is told once, by its kind and the innermost line of boresight, with the shortest
input that shows it.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path

from hostile.guard import fed
from hostile.mutations import drawn
from hostile.targets import TARGETS

_OURS = ("/scenarios/", "/renderers/", "/estimators/", "/reports/", "/campaign/")


def surveyed(name: str, inputs: int, seed: int, keep: Path | None) -> Counter[str]:
    """Feed a reader; return how often it went wrong in which way."""
    target, faults, shortest = TARGETS[name], Counter[str](), dict[str, bytes]()
    with tempfile.TemporaryDirectory() as folder:
        for content in drawn(target, inputs, seed):
            try:
                fed(target, content, Path(folder))
            except BaseException as error:
                if isinstance(error, KeyboardInterrupt):
                    raise
                kind = described(error)
                faults[kind] += 1
                if len(content) < len(shortest.get(kind, content + b" ")):
                    shortest[kind] = content
    for number, (kind, count) in enumerate(faults.most_common()):
        _say(f"{name}: {count} x {kind}\n    {shortest[kind][:300]!r}")
        if keep is not None:
            (keep / f"{name}-{number}").write_bytes(shortest[kind])
    return faults


def described(error: BaseException) -> str:
    """Tell a fault from others: its kind, and where in boresight it came from."""
    ours = [f for f in traceback.extract_tb(error.__traceback__) if any(part in f.filename for part in _OURS)]
    place = f"{Path(ours[-1].filename).name}:{ours[-1].lineno}" if ours else "?"
    what = "" if isinstance(error, AssertionError) else f": {' '.join(str(error).split())[:150]}"
    return f"{type(error).__name__} at {place}{what}"


def _say(text: str) -> None:
    print(text, flush=True)  # noqa: T201  a command


def main() -> None:
    """Survey the readers that are named, or all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("readers", nargs="*", default=[], help="names; all if none is given")
    parser.add_argument("--inputs", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, help="folder for the inputs that show a fault")
    asked = parser.parse_args()
    warnings.simplefilter("error")
    if asked.keep is not None:
        asked.keep.mkdir(parents=True, exist_ok=True)
    found = 0
    for name in asked.readers or TARGETS:
        started = time.process_time()
        faults = surveyed(name, asked.inputs, asked.seed, asked.keep)
        spent = time.process_time() - started
        _say(f"{name}: {asked.inputs} inputs, {len(faults)} kinds of faults, {spent:.1f} s")
        found += len(faults)
    sys.exit(1 if found else 0)


if __name__ == "__main__":
    main()

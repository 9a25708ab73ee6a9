"""``status``: print how far a run is."""

from __future__ import annotations

import argparse
import shlex
from collections import Counter
from collections.abc import Mapping
from typing import Any

from boresight.campaign.cli.terminal import console
from boresight.campaign.store import RunFolder, find_run, run_words
from boresight.scenarios.errors import BoresightError, display

_COUNTED = ("scenario", "estimator", "trial", "status")


def status_command(arguments: argparse.Namespace) -> int:
    """Print how many trials of a run are stored, and with which results."""
    folder = find_run(arguments.run)
    manifest = folder.read_manifest()
    if manifest is None:
        raise BoresightError(f"{folder.path}: no run has started there")
    rows = folder.arrow("rows")
    scenario, estimator, trial, status = (rows.column(name).to_pylist() for name in _COUNTED)
    total = manifest["trials"] * len(manifest["scenarios"])
    done = len(set(zip(scenario, trial, strict=True)))
    out = console()
    finished = manifest.get("finished") if done >= total else None
    out.print(f"{display(folder.path)}: {manifest['name']}, {done} of {total} trials stored, seed {manifest['seed']}")
    out.print(
        f"started {manifest.get('created') or 'some time'}, " + (f"finished {finished}" if finished else "not finished")
    )
    if not finished:
        out.print(f"{'to end it' if done >= total else 'to continue'}: {_again(manifest, folder)}")
    results = Counter(zip(scenario, estimator, status, strict=True))
    for pair in sorted(set(zip(scenario, estimator, strict=True))):
        own = [f"{n} {what}" for (*of, what), n in results.most_common() if tuple(of) == pair and what]
        out.print(f"  {' / '.join(pair)}: {', '.join(own)}")
    return 0


def _again(manifest: Mapping[str, Any], folder: RunFolder) -> str:
    """Say how a run goes on: as it was started last, but for all of the trials that it was ever asked for, and here."""
    trials, words = str(manifest["trials"]), run_words(manifest)
    if not words:
        return f"run the campaign again into the same folder, with {trials} trials of each scenario"
    # Of an option that is given twice the last counts.
    asked = ["--out", display(folder.path), *([] if "--until" in words else ["--trials", trials])]
    return shlex.join([*words, *asked])

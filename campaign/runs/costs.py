"""What a campaign costs on this machine, by the rate of its last run here, which is kept in the cache."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path

from scenarios.cache import default_cache

_KIND, _FILE = "rates", "rate.json"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,127}")
_LEAST_TRIALS = 2


@dataclass(frozen=True, slots=True)
class Rate:
    """Core seconds of a trial: of one scenario, with all estimators."""

    core_s: float

    def describe(self, trials: int, cores: int) -> str:
        """Say how long so many trials take with all cores busy, data bases aside."""
        seconds = self.core_s * trials / cores
        scale, unit = next(((s, u) for s, u in ((3600.0, "h"), (60.0, "min")) if seconds >= 1.5 * s), (1.0, "s"))
        return f"{max(seconds / scale, 1.0):.2g} {unit}"


def remember(name: str, trials: int, seconds: float, jobs: int) -> None:
    """Keep how long the trials of a run took; a few tell nothing, as the first ones compile and open what they need."""
    if trials >= _LEAST_TRIALS and _NAME.fullmatch(name):
        told = json.dumps({"core_s": seconds * jobs / trials, "trials": trials})
        default_cache().put(_KIND, name, lambda folder: _write(folder, told))


def rate_of(name: str) -> Rate | None:
    """Return the rate of a campaign; None where it has not been run here, or nobody can read how long it took."""
    kept = default_cache().find(_KIND, name) if _NAME.fullmatch(name) else None
    try:
        return None if kept is None else Rate(float(json.loads((kept / _FILE).read_text(encoding="utf-8"))["core_s"]))
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _write(folder: Path, told: str) -> None:
    (folder / _FILE).write_text(told, encoding="utf-8")

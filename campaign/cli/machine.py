"""``doctor`` and ``cache``: what this machine offers and what boresight keeps on it."""

from __future__ import annotations

import argparse
import os

from rich.table import Table

from boresight.campaign.cli.terminal import console
from boresight.campaign.data.fetch import state
from boresight.campaign.machine import cores, describe, memory_gib, package_versions
from boresight.renderers.mitsuba3 import choose_variant, find_llvm, gpu_status
from boresight.scenarios.cache import default_cache
from boresight.scenarios.data import DATA_VARIABLE, data_folder
from boresight.scenarios.data.datasets import datasets
from boresight.scenarios.errors import BoresightError

_COMFORTABLE_GIB = 8.0
_MOST_LISTED = 20  # entries of a kind
_EVERYTHING = ""


def doctor_command(_: argparse.Namespace) -> int:
    """Print what this machine offers, and advice on what is missing."""
    search = find_llvm()  # before the variant is chosen, which hands the library on in the environment
    variant, machine = choose_variant(), describe()
    facts = Table(box=None, show_header=False, pad_edge=False)
    facts.add_row("system", f"{machine['system']}, Python {machine['python']}")
    facts.add_row("processor", f"{machine['processor']}, {cores()} core(s) for this process")
    facts.add_row("memory", f"{memory_gib():.1f} GiB")
    facts.add_row("GPU", gpu_status())
    facts.add_row("Mitsuba variant", f"{variant.name}: {variant.why}")
    facts.add_row("libLLVM", f"{search.found.version}, {search.found.path}" if search.found else "none that is usable")
    for rejected in search.rejected:
        facts.add_row("", f"not taken: {rejected.path}: {rejected.reason}")
    states = [state(one, data_folder()) for one in datasets().values() if one.files]
    unset = "" if DATA_VARIABLE in os.environ else f" ({DATA_VARIABLE} is not set)"
    facts.add_row("data folder", f"{data_folder()}{unset}, {states.count('there')} of {len(states)} data sets")
    facts.add_row("cache", str(default_cache().root))
    for name, version in package_versions().items():
        facts.add_row(name, version)
    out = console()
    out.print(facts)
    advice = _advice(variant.advice, "there" in states)
    out.print("\n".join(["", "What to do:", *(f"- {line}" for line in advice)]) if advice else "\nNothing is missing.")
    return 0


def _advice(about_variant: str, any_data: bool) -> list[str]:
    missing = [name for name, version in package_versions().items() if version == "missing"]
    lines = [about_variant] if about_variant else []
    if missing:
        lines.append(f"install {', '.join(missing)}: pip install -c constraints.txt {' '.join(missing)}")
    if memory_gib() / cores() < _COMFORTABLE_GIB / 2:
        lines.append("a worker with a 3.1 M facet body takes up to 4 GiB: use fewer --jobs on such bodies")
    if not any_data:
        lines.append(
            "for campaigns that need data of missions: boresight fetch all, or fetch NAME, or set"
            f" {DATA_VARIABLE} to the folder that has them; or run those campaigns with --embedded"
        )
    return lines


def cache_command(arguments: argparse.Namespace) -> int:
    """List the cache, or clear it."""
    out, cache = console(), default_cache()
    kinds = sorted({entry.kind for entry in cache.entries()})
    if arguments.clear is not None:
        if arguments.clear not in (_EVERYTHING, *kinds):
            raise BoresightError(f"--clear {arguments.clear}: the cache holds {', '.join(kinds) or 'nothing'}")
        kind = arguments.clear or None
        freed = cache.size_bytes(kind)
        out.print(f"{cache.root}: {cache.clear(kind)} entries removed, {freed / 2**20:.1f} MiB freed")
        return 0
    out.print(f"{cache.root}: {cache.size_bytes() / 2**20:.1f} MiB of {cache.limit_bytes / 2**30:.1f} GiB")
    for kind in kinds:
        mine = [entry for entry in cache.entries() if entry.kind == kind]
        out.print(f"{kind}: {len(mine)} entries, {sum(entry.size_bytes for entry in mine) / 2**20:.1f} MiB")
        for entry in mine if len(mine) <= _MOST_LISTED else ():
            out.print(f"  {entry.key[:20]}  {entry.size_bytes / 2**20:.1f} MiB")
    return 0

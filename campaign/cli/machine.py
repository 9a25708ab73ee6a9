"""``doctor`` and ``cache``: what this machine offers and what boresight keeps on it."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from campaign.cli.terminal import console
from campaign.machine import cores, memory_gib, package_versions, processor
from renderers.mitsuba3 import choose_variant, find_llvm
from scenarios import cache

if TYPE_CHECKING:
    from argparse import _SubParsersAction


def add_commands(commands: _SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the commands to the parser."""
    doctor = commands.add_parser("doctor", help="say what this machine offers and what to do about what is missing")
    doctor.set_defaults(handler=_doctor)
    store = commands.add_parser("cache", help="show the cache of bodies and data bases, or clear it")
    store.add_argument("--clear", action="store_true", help="delete everything in it")
    store.set_defaults(handler=_cache)


def _doctor(_: argparse.Namespace) -> int:
    return 0


def _cache(arguments: argparse.Namespace) -> int:
    out = console()
    if arguments.clear:
        freed = cache.clear()
        out.print(f"{cache.place()}: cleared, {freed / 2**20:.1f} MiB freed")
        return 0
    out.print(f"{cache.place()}: {cache.size_bytes() / 2**20:.1f} MiB of {cache.limit_bytes() / 2**30:.1f} GiB")
    for entry in cache.entries():
        out.print(f"  {entry.kind}  {entry.key}  {entry.size_bytes / 2**20:.1f} MiB")
    return 0

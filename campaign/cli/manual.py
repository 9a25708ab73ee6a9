"""What ``--help`` says beyond the arguments: what a command does, examples, files and exit codes."""

from __future__ import annotations

import argparse
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from argparse import _SubParsersAction


@dataclass(frozen=True, slots=True)
class Page:
    """The page of a command: a sentence or two, and examples with what they do."""

    text: str
    examples: Mapping[str, str]

    def epilog(self) -> str:
        """Write the examples below each other."""
        wide = max(map(len, self.examples))
        lines = [f"  {example:<{wide}}   {what}" for example, what in self.examples.items()]
        return "\n".join(["examples:", *lines])


def _read() -> tuple[str, Mapping[str, Page]]:
    told = tomllib.loads(resources.files("campaign.cli").joinpath("manual.toml").read_text(encoding="utf-8"))
    pages = {name: Page(page["text"].strip(), page["examples"]) for name, page in told["commands"].items()}
    return told["whole"], MappingProxyType(pages)


WHOLE, PAGES = _read()


def write_manual(parser: argparse.ArgumentParser, commands: _SubParsersAction[argparse.ArgumentParser]) -> None:
    """Put the pages on the parsers of the commands."""
    parser.epilog, parser.formatter_class = WHOLE, argparse.RawDescriptionHelpFormatter
    for name, page in PAGES.items():
        own = commands.choices[name]
        own.description, own.epilog = page.text, page.epilog()
        own.formatter_class = _Kept


class _Kept(argparse.HelpFormatter):
    """Wraps what a command does, and keeps its examples as they are written."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        if text.startswith("examples:"):
            return "".join(indent + line for line in text.splitlines(keepends=True))
        return super()._fill_text(text, width, indent)

"""Build the argument parser: all commands with their arguments, and the manual that ``--help`` prints."""

from __future__ import annotations

import argparse
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from importlib.metadata import version
from types import MappingProxyType
from typing import NoReturn

from campaign.cli.arguments import add_commands
from scenarios.errors import BoresightError


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line; its errors are raised as `BoresightError`."""
    parser: argparse.ArgumentParser = _Parser(
        prog="boresight", description="Monte Carlo evaluation of camera navigation around asteroids."
    )
    parser.add_argument("--version", action="version", version=f"boresight {version('boresight')}")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    add_commands(commands)
    pages = manual()
    parser.epilog, parser.formatter_class = pages.whole, argparse.RawDescriptionHelpFormatter
    for name, page in pages.commands.items():
        command = commands.choices[name]
        command.description, command.epilog = page.text, page.epilog()
        command.formatter_class = _CommandFormatter
    return parser


@dataclass(frozen=True, slots=True)
class ManualPage:
    """The page of a command: a sentence or two, and examples with what they do."""

    text: str
    examples: Mapping[str, str]

    def epilog(self) -> str:
        """Write the examples below each other."""
        wide = max(map(len, self.examples))
        lines = [f"  {example:<{wide}}   {what}" for example, what in self.examples.items()]
        return "\n".join(["examples:", *lines])


@dataclass(frozen=True, slots=True)
class Manual:
    """The text below ``boresight --help``, and the page of each command."""

    whole: str
    commands: Mapping[str, ManualPage]


@lru_cache(maxsize=1)
def manual() -> Manual:
    """Read the manual from ``manual.toml``."""
    stored = tomllib.loads(resources.files("campaign.cli").joinpath("manual.toml").read_text(encoding="utf-8"))
    pages = {name: ManualPage(page["text"].strip(), page["examples"]) for name, page in stored["commands"].items()}
    return Manual(stored["whole"], MappingProxyType(pages))


class _Parser(argparse.ArgumentParser):
    """Raises wrong arguments as an error of one line."""

    def error(self, message: str) -> NoReturn:
        raise BoresightError(f"{message}; see {self.prog} --help")


class _CommandFormatter(argparse.HelpFormatter):
    """Wraps the description of a command, and prints its examples as they are written."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        if text.startswith("examples:"):
            return "".join(indent + line for line in text.splitlines(keepends=True))
        return super()._fill_text(text, width, indent)

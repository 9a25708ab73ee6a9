"""Entry point of the command line: argument parser with manual, import of the command, errors and exit codes."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module, resources
from types import MappingProxyType
from typing import NoReturn, cast

from boresight.campaign.cli.arguments import add_commands
from boresight.scenarios.atomic import explain_write_error
from boresight.scenarios.errors import BoresightError

EXIT_OK, EXIT_USER_ERROR, EXIT_ESTIMATOR_ERRORS, EXIT_INTERRUPTED = 0, 2, 3, 130


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line; its errors are raised as `BoresightError`."""
    parser: argparse.ArgumentParser = _Parser(
        prog="boresight", description="Monte Carlo evaluation of camera navigation around asteroids."
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
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
    stored = tomllib.loads(
        resources.files("boresight.campaign.cli").joinpath("manual.toml").read_text(encoding="utf-8")
    )
    pages = {name: ManualPage(page["text"].strip(), page["examples"]) for name, page in stored["commands"].items()}
    return Manual(stored["whole"], MappingProxyType(pages))


class _Parser(argparse.ArgumentParser):
    """Raises wrong arguments as an error of one line."""

    def error(self, message: str) -> NoReturn:
        raise BoresightError(f"{message}; see {self.prog} --help")


class _Version(argparse.Action):
    """Prints the version. Only here are the metadata of the installation imported and read."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        from importlib.metadata import version

        sys.stdout.write(f"boresight {version('boresight')}\n")
        parser.exit()


class _CommandFormatter(argparse.HelpFormatter):
    """Wraps the description of a command, and prints its examples as they are written."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        if text.startswith("examples:"):
            return "".join(indent + line for line in text.splitlines(keepends=True))
        return super()._fill_text(text, width, indent)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code.

    0: done; 1: an inspected trial is not the stored one, or a speed fell (bench --check); 2: bad input, said in one
    line; 3: done, but an estimator raised, hung or returned an invalid result in some trials, or runs that cannot be
    read were left out (figures, board); 130: interrupted.
    """
    words = sys.argv[1:] if arguments is None else list(arguments)
    try:
        if "_ARGCOMPLETE" in os.environ:
            _complete()
        parsed = make_parser().parse_args(words, argparse.Namespace(command=shlex.join(["boresight", *words])))
        return handler(parsed.handler)(parsed)
    except BoresightError as error:
        _complain(str(error))
        return EXIT_USER_ERROR
    except KeyboardInterrupt:
        _complain("interrupted; the same command continues")
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        sys.stderr.close()
        return EXIT_OK
    except OSError as error:
        _complain(explain_write_error(error.filename or "standard output", error))
        return EXIT_USER_ERROR


def _complete() -> None:
    """Tell a shell with ``eval "$(register-python-argcomplete boresight)"`` how a word may end, and exit."""
    import argcomplete

    from boresight.campaign.runs.read import campaign_names
    from boresight.scenarios.load import scenario_names

    def names(prefix: str, **_: object) -> list[str]:
        return [*campaign_names(), *scenario_names(), *argcomplete.FilesCompleter()(prefix)]

    argcomplete.autocomplete(make_parser(), default_completer=names)


def handler(name: str) -> Callable[[argparse.Namespace], int]:
    """Import the function that carries out a command, named MODULE:FUNCTION within this package.

    Only the libraries of the command that is run are loaded: those of all commands take 2 s to import.
    """
    module, function = name.split(":")
    return cast(
        "Callable[[argparse.Namespace], int]", getattr(import_module(f"boresight.campaign.cli.{module}"), function)
    )


def _complain(text: str) -> None:
    for line in text.splitlines():
        print(f"boresight: {line}", file=sys.stderr)  # noqa: T201  the command line speaks

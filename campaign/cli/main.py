"""Entry point of the command line: argument parser with manual, import of the command, errors and exit codes."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
import tomllib
from collections.abc import Callable, Sequence
from importlib import import_module, resources
from typing import Any, NoReturn, cast

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
    parser.epilog, parser.formatter_class = pages["whole"], argparse.RawDescriptionHelpFormatter
    for name, page in pages["commands"].items():
        command, wide = commands.choices[name], max(map(len, page["examples"]))
        lines = [f"  {example:<{wide}}   {what}" for example, what in page["examples"].items()]
        command.description, command.epilog = page["text"].strip(), "\n".join(["examples:", *lines])
        command.formatter_class = _CommandFormatter
    return parser


def manual() -> dict[str, Any]:
    """Read ``manual.toml``: the text below ``boresight --help`` (``whole``), and the page of each of ``commands``."""
    file = resources.files("boresight.campaign.cli").joinpath("manual.toml")
    return tomllib.loads(file.read_text(encoding="utf-8"))


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

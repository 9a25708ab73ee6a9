"""Arguments in, exit code out."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Sequence
from importlib.metadata import version
from typing import NoReturn

from campaign.cli import bench, catalog, compare, craters, export, fetch, figures, inspect, machine, runs, sensitivity
from campaign.cli.manual import write_manual
from scenarios.atomic import explain_write_error
from scenarios.errors import BoresightError

EXIT_OK, EXIT_USER_ERROR, EXIT_ESTIMATOR_ERRORS, EXIT_INTERRUPTED = 0, 2, 3, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code.

    0: done; 1: an inspected trial is not the stored one, or a speed fell (bench --check); 2: bad input, said in one
    line; 3: done, but an estimator raised, hung or returned rubbish in some trials, or runs that cannot be read were
    left out (figures); 130: interrupted.
    """
    words = sys.argv[1:] if arguments is None else list(arguments)
    try:
        parsed = _parser().parse_args(words, argparse.Namespace(command=shlex.join(["boresight", *words])))
        return int(parsed.handler(parsed))
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


def _complain(text: str) -> None:
    for line in text.splitlines():
        print(f"boresight: {line}", file=sys.stderr)  # noqa: T201  the command line speaks


class _Parser(argparse.ArgumentParser):
    """Complains in one line, as everything else here does."""

    def error(self, message: str) -> NoReturn:
        raise BoresightError(f"{message}; see {self.prog} --help")


def _parser() -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = _Parser(
        prog="boresight", description="Monte Carlo evaluation of camera navigation around asteroids."
    )
    parser.add_argument("--version", action="version", version=f"boresight {version('boresight')}")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    catalog.add_commands(commands)
    runs.add_commands(commands)
    inspect.add_commands(commands)
    export.add_commands(commands)
    compare.add_commands(commands)
    sensitivity.add_commands(commands)
    figures.add_commands(commands)
    craters.add_commands(commands)
    bench.add_commands(commands)
    fetch.add_commands(commands)
    machine.add_commands(commands)
    write_manual(parser, commands)
    return parser

"""Run a command from its arguments, and turn errors into one line and an exit code."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import cast

from campaign.cli.parser import make_parser
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


def handler(name: str) -> Callable[[argparse.Namespace], int]:
    """Import the function that carries out a command, named MODULE:FUNCTION within this package.

    Only the libraries of the command that is run are loaded: those of all commands take 2 s to import.
    """
    module, function = name.split(":")
    return cast("Callable[[argparse.Namespace], int]", getattr(import_module(f"campaign.cli.{module}"), function))


def _complain(text: str) -> None:
    for line in text.splitlines():
        print(f"boresight: {line}", file=sys.stderr)  # noqa: T201  the command line speaks

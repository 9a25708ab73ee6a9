"""``python -m hostile.atheris_run [READER...] [--runs N] [--seed N]``: inputs that follow the coverage of the code.

libFuzzer edits the seeds of a reader; what reaches new code in boresight or in a parser in Python is kept and edited
further. A fault ends a reader's inputs: it is told with its traceback, and its input stays in ``READER-crash*``. Needs
the extra ``fuzz``. Each reader has a process of its own, forked from one that has instrumented all code once.
"""

from __future__ import annotations

import argparse
import os
import resource
import sys
import tempfile
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

import atheris

with atheris.instrument_imports(
    include=["scenarios", "renderers", "estimators", "reports", "campaign", "yaml", "pvl", "trimesh", "astropy"]
):
    from hostile.found import FOUND
    from hostile.guard import fed
    from hostile.mutations import NUMBERS, WORDS
    from hostile.targets import TARGETS

_LONGEST, _LONGEST_WORD, _LONGEST_SAID = 8192, 64, 3000


def main() -> None:
    """Fuzz the readers that are named, or all; exit with 1 if one of them went wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("readers", nargs="*", metavar="READER", help="names; all if none is given")
    parser.add_argument("--runs", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=2003)
    asked = parser.parse_args()
    if unknown := sorted(set(asked.readers) - set(TARGETS)):
        parser.error(f"{', '.join(unknown)}: no such reader; these are: {', '.join(TARGETS)}")
    wrong = [name for name in asked.readers or TARGETS if not _is_sound(name, asked.runs, asked.seed)]
    sys.exit(1 if wrong else 0)


def _is_sound(reader: str, runs: int, seed: int) -> bool:
    """Fuzz one reader in a process of its own, and tell how it went."""
    with tempfile.TemporaryDirectory(prefix="boresight-fuzz-") as folder:
        said = Path(folder) / "said"
        child = os.fork()
        if child == 0:
            options = [f"-runs={runs}", f"-seed={seed}", f"-max_len={_LONGEST}", f"-artifact_prefix={reader}-"]
            _end_with(lambda: _fuzz(reader, options, Path(folder)), said)
        before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        spent = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
        told = f"{runs} inputs, none went wrong" if status == 0 else f"went wrong:\n{_end(said)}"
        print(f"{reader}: {told}, {spent:.1f} s", flush=True)  # noqa: T201  a command
        return status == 0


def _end_with(work: Callable[[], None], said: Path) -> NoReturn:
    """Work and end this process, what libFuzzer and parsers in C print in a file; a crash has ended it by then."""
    code = 1
    try:
        file = os.open(said, os.O_WRONLY | os.O_CREAT, 0o600)
        for stream in (1, 2):
            os.dup2(file, stream)
        work()
    except SystemExit as ended:
        code = int(ended.code or 0)
    finally:
        os._exit(code)


def _end(said: Path) -> str:
    return said.read_text(errors="replace")[-_LONGEST_SAID:]


def _fuzz(reader: str, options: Sequence[str], folder: Path) -> None:
    warnings.simplefilter("error")
    target, laid, corpus = TARGETS[reader], folder / "laid", folder / "corpus"
    laid.mkdir()
    corpus.mkdir()
    for number, content in enumerate((*target.seeds(), *FOUND.get(reader, ()))):
        (corpus / str(number)).write_bytes(content)
    words = (word for word in (*target.words, *WORDS, *NUMBERS) if 0 < len(word) < _LONGEST_WORD)
    (folder / "words").write_text("".join(f'"{_escaped(word)}"\n' for word in words))

    def feed(content: bytes) -> None:
        try:
            fed(target, content, laid)
        except BaseException:
            Path(f"{reader}-crash").write_bytes(content)
            raise

    atheris.Setup([sys.argv[0], *options, f"-dict={folder / 'words'}", str(corpus)], feed)
    atheris.Fuzz()


def _escaped(word: bytes) -> str:
    return "".join(f"\\x{byte:02x}" for byte in word)


if __name__ == "__main__":
    main()

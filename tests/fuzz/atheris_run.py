"""``python -m fuzz.atheris_run READER FOLDER RUNS``: inputs that follow the coverage of the code (extra ``fuzz``).

libFuzzer edits the seeds of a reader in FOLDER; what reaches new code in boresight or in a parser in Python is edited
further. A fault ends it with a traceback, and its input stays in ``FOLDER/crash-*``.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["boresight", "yaml", "pvl", "trimesh", "astropy"]):
    from fuzz.guard import fed
    from fuzz.mutations import NUMBERS, WORDS
    from fuzz.readers import READERS, found, valid

_LONGEST, _LONGEST_WORD = 8192, 64


def main(name: str, folder: Path, runs: int) -> None:
    """Fuzz one reader; libFuzzer ends the process."""
    warnings.simplefilter("error")
    for place in (work := folder / "work", corpus := folder / "corpus"):
        place.mkdir()
    for number, content in enumerate((*valid(name), *found(name))):
        (corpus / str(number)).write_bytes(content)
    words = (word for word in (*READERS[name].words, *WORDS, *NUMBERS) if 0 < len(word) < _LONGEST_WORD)
    escaped = ("".join(f"\\x{byte:02x}" for byte in word) for word in words)
    (folder / "words").write_text("".join(f'"{word}"\n' for word in escaped))
    options = [f"-runs={runs}", "-seed=2003", f"-max_len={_LONGEST}", f"-artifact_prefix={folder}/"]
    feed = lambda content: fed(READERS[name].read, content, work) and None  # noqa: E731
    atheris.Setup([sys.argv[0], *options, f"-dict={folder / 'words'}", str(corpus)], feed)
    atheris.Fuzz()


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]))

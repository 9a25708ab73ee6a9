"""Text files of records: one a line, first the kind of the record, then its fields.

Numbers are written as Python's ``repr``, the shortest text that reads back as the same number. A line that begins with
``#`` is a comment; the first line names the format and its version.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from boresight.scenarios.atomic import write_text
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.reading import LARGEST_NUMBER

_MAX_DIGITS = 18  # more may not fit 64 bits


@dataclass(frozen=True, slots=True)
class TextRecord:
    """A line of a file: its place, its kind and its fields."""

    path: Path
    line: int
    kind: str
    fields: tuple[str, ...]

    def error(self, what: str) -> BoresightError:
        """Return an error whose message begins with the file and line."""
        return BoresightError(f"{self.path}:{self.line}: {what}")

    def integer(self, field: int) -> int:
        """Read a field as a non-negative integer."""
        text = self.fields[field]
        if not text.isdecimal() or len(text) > _MAX_DIGITS:
            raise self.error(
                f"field {field + 1} of the {self.kind} is {text!r}, not a whole number of at most {_MAX_DIGITS} digits"
            )
        return int(text)

    def numbers(self, first: int, last: int) -> list[float]:
        """Read fields ``first`` to before ``last`` as finite numbers."""
        values = []
        for field in range(first, last):
            try:
                value = float(self.fields[field])
            except ValueError:
                value = float("nan")
            if not abs(value) <= LARGEST_NUMBER:
                raise self.error(
                    f"field {field + 1} of the {self.kind} is {self.fields[field]!r}, not a finite number of any use"
                )
            values.append(value)
        return values


def write_records(path: Path, head: str, lines: Iterable[str]) -> None:
    """Write a file whole or not at all; raise BoresightError if it cannot be written."""
    write_text(path, "".join(f"{line}\n" for line in (f"# {head}", *lines)))


def read_records(path: Path, head: str, fields: Mapping[str, int]) -> Iterator[TextRecord]:
    """Read the records of a file; ``fields`` gives the number of fields of each kind.

    Raise BoresightError if the file cannot be read, is of another format, or a line is of an unknown kind or length.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise BoresightError(f"{path}: cannot be read: {error}") from error
    if not lines or lines[0] != f"# {head}":
        raise BoresightError(f"{path}:1: the first line is not '# {head}'")
    for number, line in enumerate(lines[1:], start=2):
        parts = line.split()
        if not parts or parts[0].startswith("#"):
            continue
        record = TextRecord(path, number, parts[0], tuple(parts[1:]))
        if record.kind not in fields:
            raise record.error(f"{record.kind!r} is no kind of record; there are: {', '.join(sorted(fields))}")
        if len(record.fields) != fields[record.kind]:
            wanted = fields[record.kind]
            raise record.error(f"a {record.kind} has {wanted} fields, not {len(record.fields)}")
        yield record


def format_record(*values: str | float) -> str:
    """Format values as one line: integers and texts as they are, other numbers exactly."""
    return " ".join(str(v) if isinstance(v, int | str) else repr(float(v)) for v in values)

"""Files that are nearly right: edits of valid ones, by words that break parsers."""

from __future__ import annotations

import random
import re
from collections.abc import Iterator, Sequence

from hypothesis import strategies as st

from hostile.target import Target

NUMBERS = (
    b"0", b"-1", b"1", b"nan", b"inf", b"-inf", b"1e400", b"-1e308", b"1e-400", b"9" * 30, b"9" * 5000, b"2147483648",
    b"4294967295", b"1000000000", b"18446744073709551616", b"-9223372036854775808", b"1e99999999999", b"0x10", b"1_0",
    b"0.5", b"1,5", b"+", b"-", b"\xd9\xa3", b"\xc2\xb2", b"00", b"1e200", b"1e-320", b"16777216",
)  # fmt: skip
WORDS = (
    b"", b"\n", b"\r", b"\0", b" ", b"\t", b",", b";", b'"', b"'", b"#", b"=", b"/", b"\\", b"(", b")", b"[", b"{",
    b"}", b"]", b"<", b">", b"\xff", b"\xc3", b"\xe2\x80\xa8", b"\x85", b"\x0c", b"\x1b[31m", b"\xef\xbb\xbf",
    b"\xff\xfe",
    b"\xed\xa0\x80", b"\xf0\x9f\x92\xa5", b"null", b"true", b"..", b"../../../../etc/passwd", b"/dev/zero",
    b"a" * 70000,
    b"(" * 3000, b"[" * 3000, b'{"a":' * 3000, b"%s%n", b"\n" * 3,
)  # fmt: skip
_NUMBER = re.compile(rb"[-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?")
_WORD = re.compile(rb"[^\s,]+")
_BINARY = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0x40000000, 0x10000)
EDITS = (
    "number", "number", "word", "insert", "over", "flip", "cut", "drop line", "repeat line", "swap lines", "binary",
)  # fmt: skip
_LARGEST = 1 << 20
_RUBBISH = 0.05

Edit = tuple[str, int, int]


def mutated(target: Target) -> st.SearchStrategy[bytes]:
    """Draw damaged files of a reader: up to five edits of a valid one, and now and then bytes of no format at all."""
    seeds, words = target.seeds(), (*target.words, *WORDS)
    edit = st.tuples(st.sampled_from(EDITS), st.integers(0, 2**24 - 1), st.integers(0, 2**16 - 1))
    damaged = st.tuples(st.integers(0, len(seeds) - 1), st.lists(edit, min_size=1, max_size=5)).map(
        lambda drawn: edited(seeds[drawn[0]], drawn[1], words)
    )
    return st.one_of(*[damaged] * 9, st.binary(max_size=300))


def drawn(target: Target, inputs: int, seed: int) -> Iterator[bytes]:
    """Draw such files without hypothesis, several times faster: the same ones for the same seed."""
    rng = random.Random(seed)  # noqa: S311  nothing is secret here
    seeds, words = target.seeds(), (*target.words, *WORDS)
    for _ in range(inputs):
        if rng.random() < _RUBBISH:
            yield rng.randbytes(rng.randrange(300))
        else:
            edits = [(rng.choice(EDITS), rng.randrange(2**24), rng.randrange(2**16)) for _ in range(rng.randint(1, 5))]
            yield edited(rng.choice(seeds), edits, words)


def edited(content: bytes, edits: Sequence[Edit], words: Sequence[bytes]) -> bytes:
    """Apply edits one after the other; 1 MiB at most comes out."""
    for kind, where, what in edits:
        content = _edit(content, kind, where, what, words)[:_LARGEST]
    return content


def _edit(content: bytes, kind: str, where: int, what: int, words: Sequence[bytes]) -> bytes:
    at = where % (len(content) + 1)
    if kind in ("number", "word"):
        pattern, choice = (_NUMBER, NUMBERS) if kind == "number" else (_WORD, (*words, *NUMBERS))
        found = pattern.search(content, at) or pattern.search(content)
        if not found:
            return content
        start, end = found.span()
        return content[:start] + choice[what % len(choice)] + content[end:]
    if kind == "insert":
        return content[:at] + words[what % len(words)] + content[at:]
    if kind == "over":
        word = words[what % len(words)]
        return content[:at] + word + content[at + len(word) :]
    if kind == "flip" and at < len(content):
        return content[:at] + bytes([content[at] ^ (1 << what % 8)]) + content[at + 1 :]
    if kind == "cut":
        return content[:at]
    if kind == "binary":
        return _overwritten(content, at, what)
    return _lines(content, kind, where, what)


def _overwritten(content: bytes, at: int, what: int) -> bytes:
    """Put a whole number that counts or offsets cannot bear, in one of the usual widths and orders."""
    width, order = (1, 2, 4, 8)[what % 4], ("little", "big")[what // 4 % 2]
    value = _BINARY[what // 8 % len(_BINARY)] % (1 << 8 * width)
    return content[:at] + value.to_bytes(width, order) + content[at + width :]  # type: ignore[arg-type]


def _lines(content: bytes, kind: str, where: int, what: int) -> bytes:
    lines = content.splitlines(keepends=True)
    if not lines:
        return content
    here, there = where % len(lines), what % len(lines)
    if kind == "drop line":
        del lines[here]
    elif kind == "repeat line":
        lines[here:here] = [lines[here]] * (1 + what % 3)
    else:
        lines[here], lines[there] = lines[there], lines[here]
    return b"".join(lines)

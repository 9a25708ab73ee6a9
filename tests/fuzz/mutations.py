"""Files that are nearly right: edits of valid ones, by words that break parsers."""

from __future__ import annotations

import random
import re
from collections.abc import Iterator, Sequence

NUMBERS = (
    b"0", b"-1", b"1", b"nan", b"inf", b"-inf", b"1e400", b"-1e308", b"1e-400", b"9" * 30, b"9" * 5000, b"2147483648",
    b"4294967295", b"1000000000", b"18446744073709551616", b"-9223372036854775808", b"1e99999999999", b"0x10", b"1_0",
    b"0.5", b"1,5", b"+", b"-", b"\xd9\xa3", b"\xc2\xb2", b"00", b"1e200", b"1e-320", b"16777216",
)  # fmt: skip
WORDS = (
    b"", b"\n", b"\r", b"\0", b" ", b"\t", b",", b";", b'"', b"'", b"#", b"=", b"/", b"\\", b"(", b")", b"[", b"{",
    b"}", b"]", b"<", b">", b"\xff", b"\xc3", b"\xe2\x80\xa8", b"\x85", b"\x0c", b"\x1b[31m", b"\xef\xbb\xbf",
    b"\xff\xfe", b"\xed\xa0\x80", b"\xf0\x9f\x92\xa5", b"null", b"true", b"..", b"../../../../etc/passwd",
    b"/dev/zero", b"a" * 70000, b"(" * 3000, b"[" * 3000, b'{"a":' * 3000, b"%s%n", b"\n" * 3,
)  # fmt: skip
_BINARY = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0x40000000, 0x10000)
_NUMBER = re.compile(rb"[-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?")
_WORD = re.compile(rb"[^\s,]+")
_EDITS = ("number", "number", "word", "insert", "over", "flip", "cut", "binary", "drop", "repeat", "swap")
_LARGEST = 1 << 20
_NO_FORMAT = 0.05


def drawn(seeds: Sequence[bytes], words: Sequence[bytes], inputs: int, seed: int) -> Iterator[bytes]:
    """Draw damaged files, up to five edits of a valid one, and now and then bytes of no format at all."""
    rng, words = random.Random(seed), (*words, *WORDS)  # noqa: S311  nothing is secret here
    for _ in range(inputs):
        if rng.random() < _NO_FORMAT:
            yield rng.randbytes(rng.randrange(300))
            continue
        content = rng.choice(seeds)
        for _ in range(rng.randint(1, 5)):
            content = _edited(content, words, rng)[:_LARGEST]
        yield content


def _edited(content: bytes, words: Sequence[bytes], rng: random.Random) -> bytes:
    kind, at = rng.choice(_EDITS), rng.randrange(len(content) + 1)
    if kind in ("number", "word"):
        pattern, choice = (_NUMBER, NUMBERS) if kind == "number" else (_WORD, (*words, *NUMBERS))
        found = pattern.search(content, at) or pattern.search(content)
        return content[: found.start()] + rng.choice(choice) + content[found.end() :] if found else content
    if kind in ("insert", "over"):
        word = rng.choice(words)
        return content[:at] + word + content[at + (len(word) if kind == "over" else 0) :]
    if kind == "flip":
        return content[:at] + bytes(byte ^ (1 << rng.randrange(8)) for byte in content[at : at + 1]) + content[at + 1 :]
    if kind == "cut":
        return content[:at]
    if kind == "binary":  # a whole number that counts or offsets cannot bear, in one of the usual widths and orders
        width = rng.choice((1, 2, 4, 8))
        value = rng.choice(_BINARY) % (1 << 8 * width)
        return content[:at] + value.to_bytes(width, rng.choice(("little", "big"))) + content[at + width :]
    lines = content.splitlines(keepends=True) or [b""]
    here, there = rng.randrange(len(lines)), rng.randrange(len(lines))
    if kind == "drop":
        del lines[here]
    elif kind == "repeat":
        lines[here:here] = [lines[here]] * rng.randint(1, 3)
    else:
        lines[here], lines[there] = lines[there], lines[here]
    return b"".join(lines)

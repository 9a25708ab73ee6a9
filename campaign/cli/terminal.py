"""Printing of plain text on the console."""

from __future__ import annotations

from typing import Any

from rich.console import Console

from boresight.scenarios.errors import printable

_WIDTH = 160


class _Plain(Console):
    """Ignores markup and control characters in printed text."""

    def print(self, *objects: Any, **how: Any) -> None:
        super().print(*(_shown(one) if isinstance(one, str) else one for one in objects), **how)


def console() -> Console:
    """Return a console on standard output that wraps no text when it is not a terminal; tables are so wide then."""
    plain = _Plain(markup=False, emoji=False)
    if plain.is_terminal:
        return plain
    return _Plain(width=_WIDTH, soft_wrap=True, highlight=False, markup=False, emoji=False)


def _shown(text: str) -> str:
    return "\n".join(map(printable, text.split("\n")))

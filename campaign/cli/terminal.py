"""How the command line prints."""

from __future__ import annotations

from rich.console import Console

_WIDTH = 160


def console(width: int = _WIDTH) -> Console:
    """Return a console on standard output that wraps no text when it is not a terminal; tables are so wide then."""
    plain = Console()
    return plain if plain.is_terminal else Console(width=width, soft_wrap=True, highlight=False)

"""How the command line prints."""

from __future__ import annotations

from rich.console import Console


def console() -> Console:
    """Return a console on standard output that wraps nothing when it is not a terminal."""
    plain = Console()
    return plain if plain.is_terminal else Console(width=160, soft_wrap=True, highlight=False)

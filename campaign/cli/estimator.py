"""The page of an estimator in the terminal: ``boresight show ESTIMATOR``."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator

from rich.text import Text

from boresight.campaign.cli.terminal import console
from boresight.estimators.pages import COSTS, EstimatorPage, page_of
from boresight.scenarios.load.keys import keys_of

_WIDEST = 100
"""Characters of a line at most, however wide the terminal is."""


def print_page(name: str) -> None:
    """Print what an estimator does, when to use it, when it fails, its cost, source and options."""
    page, out = page_of(name), console()
    width = min(out.width, _WIDEST)
    out.print(Text(f"{page.name}, version {page.version}", style="bold"))
    for paragraph in (page.summary, *filter(None, page.text.split("\n\n"))):
        out.print("\n" + _filled(paragraph, width))
    for heading, text in page.sections.items():
        out.print(Text(f"\n{heading}", style="bold"))
        out.print(_filled(f"{text} {COSTS}" if heading == "Cost" and text != "None." else text, width, "  ", "  "))
    out.print(Text("\nOptions", style="bold"))
    for line in _option_lines(page):
        out.print(_filled(line, width, "  ", "      "))


def _filled(text: str, width: int, first: str = "", others: str = "") -> str:
    """Wrap text without the marks of literals."""
    told = text.replace("`", "")
    return textwrap.fill(told, width, initial_indent=first, subsequent_indent=others, break_on_hyphens=False)


def _option_lines(page: EstimatorPage) -> Iterator[str]:
    """Yield a line for each option; the keys of its sections are in the documentation."""
    keys = [key for model in page.options for key in keys_of(model)]
    for key in keys:
        default = "required" if key.default is None else f"default: {key.default}"
        yield f"{key.name}: {key.meaning} ({', '.join(filter(None, (key.type, key.unit, default)))})"
    if not keys:
        yield "None."

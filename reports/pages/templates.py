"""HTML pages from the templates of this package, with embedded style sheet and figures."""

from __future__ import annotations

import base64
from collections.abc import Iterable
from importlib import resources

from jinja2 import Environment, PackageLoader, StrictUndefined

from boresight.reports.schema.named_figure import NamedFigure


def fill_template(template: str, **values: object) -> str:
    """Fill a template with values and the style sheet."""
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
        loader=PackageLoader("boresight.reports.pages", "."),
    )  # fmt: skip
    return environment.get_template(template).render(css=template_text("page.css"), **values)


def template_text(name: str) -> str:
    """Read a file of the templates' folder."""
    return resources.files("boresight.reports.pages").joinpath(name).read_text(encoding="utf-8")


def embed_figures(figures: Iterable[tuple[NamedFigure, bytes]]) -> list[tuple[NamedFigure, str]]:
    """Encode the PNG of each figure for its place in a page."""
    return [(figure, base64.b64encode(png).decode()) for figure, png in figures]

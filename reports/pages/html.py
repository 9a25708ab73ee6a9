"""One self-contained page: nothing is fetched from elsewhere, and all of it is there without its script."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence

from reports.kinds.kind import Content
from reports.kinds.report import report_grids
from reports.pages.distributions import distributions
from reports.pages.templates import embedded, filled, text_of
from reports.run.row_files import row_links
from reports.schema.named_figure import NamedFigure


def html_page(content: Content, figures: Sequence[tuple[NamedFigure, bytes]]) -> str:
    """Fill the page's template.

    Parameters
    ----------
    content
        What is said.
    figures
        Each with its PNG, which is embedded.
    """
    manifest = content.run.manifest
    return filled(
        "page.html",
        manifest=manifest,
        progress=content.run.progress(),
        facts=_facts(content),
        notes=content.notes,
        js=text_of("page.js"),
        grids=[(grid, row_links(content.run, grid)) for grid in report_grids(content)],
        distributions=list(distributions(content.run)),
        figures=embedded(figures),
        resolved={
            "scenarios": json.dumps(dict(manifest.scenarios), indent=2, ensure_ascii=False),
            "estimators": json.dumps(manifest.estimators, indent=2, ensure_ascii=False),
        },
        command=reproduce_command(content),
    )


def reproduce_command(content: Content) -> str:
    """Write the command line that makes this run again."""
    manifest = content.run.manifest
    return manifest.command or f"boresight run {manifest.name} --trials {manifest.trials} --seed {manifest.seed}"


def _facts(content: Content) -> list[tuple[str, str]]:
    """Say how the run was made, as names and values."""
    manifest = content.run.manifest
    done, total = content.run.progress()
    facts = [
        ("Campaign", manifest.name),
        ("Trials", f"{done} of {total}"),
        ("Seed", str(manifest.seed)),
        ("Created", manifest.created),
        ("Commit", manifest.commit),
        ("Machine", _listed(manifest.machine)),
        ("Versions", _listed(manifest.versions)),
    ]
    return [(name, value) for name, value in facts if value]


def _listed(mapping: Mapping[str, object]) -> str:
    """Write what a mapping says on one line."""
    said = {name: value for name, value in mapping.items() if value not in ("", None)}
    return ", ".join(f"{name.replace('_', ' ')} {value}" for name, value in said.items())

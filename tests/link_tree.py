"""Lay the folders of a checkout out as the package `boresight`, by links.

    python tests/link_tree.py CHECKOUT FOLDER

An editable install maps the folders when they are imported, which mypy and import-linter cannot follow; they, and
another checkout than the installed one, are given FOLDER on their path.
"""

from __future__ import annotations

import sys
from pathlib import Path

FOLDERS = ("scenarios", "renderers", "estimators", "reports", "campaign")


def link_tree(checkout: Path, folder: Path) -> None:
    """Link the five folders, and the files of the package itself, below ``folder``."""
    package = folder / "boresight"
    package.mkdir(parents=True, exist_ok=True)
    api = (path for path in (checkout / "campaign" / "api").iterdir() if path.is_file())
    for path in (*(checkout / name for name in FOLDERS), *api):
        link = package / path.name
        link.unlink(missing_ok=True)
        link.symlink_to(path.resolve())


if __name__ == "__main__":
    link_tree(*map(Path, sys.argv[1:]))

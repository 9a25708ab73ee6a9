"""An index page of runs: a line for each, with its headline numbers, its verdicts and the way to its report."""

from __future__ import annotations

import base64
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from urllib.parse import quote

import cv2
from markupsafe import Markup

from boresight.reports.pages.build import LEAD
from boresight.reports.pages.content import content_of, estimator_results, verdict_counts
from boresight.reports.pages.document import Document, write_document
from boresight.reports.run.data import RunData, read_run
from boresight.reports.schema.grid import NO_VALUE, Grid, number
from boresight.reports.schema.records import count_of
from boresight.reports.tables import interval
from boresight.scenarios.errors import BoresightError

_HEADS = ("run", "title", "started", "trials", "measure", "estimator", "ok", "median [95 %]", "prior", "verdicts")
_NOTE = (
    "Medians over all scenarios of a run, with their 95 % intervals, of the trials that have a value (ok: of all);"
    " prior: the median of the same error of the priors."
)
_THUMB_PX = 200


def write_board(folders: Sequence[Path], out: Path, command: str) -> tuple[Path, tuple[str, ...]]:
    """Write ``index.html`` on runs into a folder; return its path and what is wrong with runs that cannot be read.

    Raises `OSError` if the page cannot be written.
    """
    rows, refused = [], []
    for folder in folders:
        try:
            rows.append(_line(read_run(folder), out))
        except BoresightError as error:
            refused.append(str(error))
    document = Document(
        product="boresight board",
        title=f"Runs in {out.absolute()}",
        facts=(),
        lists=[("Not read", refused)],
        grids=[
            Grid(
                f"{count_of(len(rows), 'run')}, the newest first",
                _HEADS,
                tuple(rows),
                frozenset({0, 1, 2, 4, 5, 9}),
                _NOTE,
            )
        ],
        command=command,
    )
    return write_document(document, out, "index.html"), tuple(refused)


def _line(run: RunData, out: Path) -> tuple[str, ...]:
    """Lay out the cells of a run; those on its estimators have a line for each."""
    manifest, report = run.manifest, run.folder / "report" / "report.html"
    done, total = run.progress()
    try:
        metric, found = estimator_results(run)
        measured = metric.axis
    except BoresightError:  # its trials have no number to go by
        found, measured = [], NO_VALUE
    estimators = [(one.estimator, f"{one.n_ok}/{one.n}", interval(one.solved[0]), number(one.prior)) for one in found]
    name: str = run.folder.name
    if report.exists():
        way = quote(Path(os.path.relpath(report, out)).as_posix())
        name = Markup('<a href="{}">{}</a>').format(way, name)
    verdicts = verdict_counts(content_of(run)) if manifest.report else ""
    return (
        name,
        Markup("{}{}").format(manifest.title or manifest.name, _thumb(run.folder / "report" / f"{LEAD}.png")),
        _lines([manifest.created[:16].replace("T", " ")]),
        f"{done}/{total}",
        measured,
        *(_lines(column) for column in (zip(*estimators, strict=True) if estimators else [[NO_VALUE]] * 4)),
        verdicts or NO_VALUE,
    )


def _lines(texts: Iterable[str]) -> str:
    return Markup('<span class="lines">{}</span>').format(Markup("<br>").join(texts))


def _thumb(picture: Path) -> str:
    """Return the lead picture of a report, scaled down; '' where there is none."""
    pixels = cv2.imread(str(picture)) if picture.exists() else None
    if pixels is None:
        return ""
    scale = _THUMB_PX / max(pixels.shape[:2])
    small = cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    png = base64.b64encode(cv2.imencode(".png", small)[1].tobytes()).decode()
    return Markup('<img class="thumb" src="data:image/png;base64,{}" alt="">').format(png)

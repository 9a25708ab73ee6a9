"""Report of crater navigation before the orbit: images, craters, matches and landmarks."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import pandas as pd

from boresight.reports.figures.craters import draw_crater_counts, draw_landmark_spans
from boresight.reports.figures.named import NamedFigure, file_stem
from boresight.reports.kinds.orbit_determination import REPORT as ORBIT_REPORT
from boresight.reports.run.data import TRIAL_KEY, RunData
from boresight.reports.run.limits import limited_title
from boresight.reports.schema.grid import ESTIMATOR, SCENARIO, Grid, record_column, record_grid
from boresight.reports.schema.records import Key, Record
from boresight.reports.statistics.measured import MEAN, MEDIAN, table_records

NAVIGATION = "navigation"
"""Stage of what the chain comes to before the orbit."""
_NOTE = (
    "Of the last round. False: detections that are no crater. Wrong: matches that join two different craters; found:"
    " right matches over the craters that matched images have in common. Mixed: sightings in the data base of another"
    " crater than most of their number. Truth has a part in these counts, and in what the chain is given: centre of"
    " mass and the RMS error of the believed shape are the true ones, and the spin where nothing else is said."
)


def navigation_records(run: RunData) -> Iterable[Record]:
    """Compute error statistics of the navigation runs, under the stage ``navigation``."""
    if run.table("navigation").empty:
        return ()
    table = run.table("navigation").set_index(TRIAL_KEY)
    images = run.table("navigated_images").groupby(TRIAL_KEY)["n_detections"]
    landmarks = run.table("navigated_landmarks").groupby(TRIAL_KEY)
    worked = run.table("timings")[~run.table("timings")["stage"].isin(["imaging", "scoring"])]
    hits = landmarks["hits"].sum().reindex(table.index)
    numbers = {
        "rounds": table["rounds"],
        "images_taken": table["n_images"],
        "craters_detected": table["n_detections"],
        "craters_per_image": images.mean(),
        "median_craters_per_image": images.median(),
        "listed_false_alarm_share": _percent(table["n_false"], table["n_detections"]),
        "image_pairs": table["n_pairs"],
        "matching_recall_share": _percent(table["n_correct"], table["n_common"]),
        "matching_wrong_share": _percent(table["n_wrong"], table["n_correct"] + table["n_wrong"]),
        "database_landmarks": table["n_landmarks"],
        "hits_per_landmark": hits / table["n_landmarks"].where(table["n_landmarks"] > 0),
        "mixed_share": _percent(landmarks["n_other"].sum().reindex(table.index), hits),
        "processing_seconds": worked.groupby(TRIAL_KEY)["seconds"].sum(),
    }
    statistics = dict.fromkeys(numbers, (MEAN, MEDIAN))
    return table_records(run, pd.DataFrame(numbers).reset_index(), NAVIGATION, statistics)


def _percent(part: pd.Series, whole: pd.Series) -> pd.Series:
    return 100.0 * part / whole.where(whole > 0)


_COLUMNS = (
    SCENARIO,
    ESTIMATOR,
    *(
        record_column(head, name, MEAN.name, ended=True)
        for name, head in {
            "rounds": "rounds", "images_taken": "images", "craters_per_image": "craters an image",
            "listed_false_alarm_share": "false %", "image_pairs": "pairs", "matching_recall_share": "found %",
            "matching_wrong_share": "wrong %", "database_landmarks": "landmarks", "hits_per_landmark": "images each",
            "mixed_share": "mixed %", "processing_seconds": "time s",
        }.items()
    ),
)  # fmt: skip


def navigation_grid(records: Sequence[Record], run: RunData) -> Grid | None:
    """Tabulate the chain up to the data base; None without one."""
    lines = [] if run.table("navigation").empty else [Key(*pair, NAVIGATION) for pair in run.pairs()]
    title = limited_title("From images to the data base", run)
    return record_grid(title, _COLUMNS, records, lines, _NOTE)


def navigation_figures(run: RunData) -> Iterator[NamedFigure]:
    """Draw the counts and the spans of the first trial of each scenario and chain."""
    for scenario, estimator in run.pairs():
        if len(run.of(scenario, estimator, "navigated_images")):
            yield counts_figure(run, scenario, estimator)
        landmarks = run.of(scenario, estimator, "navigated_landmarks")
        if len(landmarks):
            title = f"Landmarks over time, {scenario}, {estimator}, first trial"
            yield NamedFigure(
                file_stem("landmark_spans", scenario, estimator),
                draw_landmark_spans(_first(landmarks), title),
                f"{title}: from the first to the last image that shows each landmark of the data base.",
                "A horizontal line for each landmark over the days of the arc.",
            )


def counts_figure(run: RunData, scenario: str, estimator: str) -> NamedFigure:
    """Draw how many craters images have and how many images landmarks, in the first trial."""
    images = _first(run.of(scenario, estimator, "navigated_images"))
    landmarks = _first(run.of(scenario, estimator, "navigated_landmarks"))
    title = f"Craters of images and images of landmarks, {scenario}, {estimator}, first trial"
    return NamedFigure(
        file_stem("crater_counts", scenario, estimator),
        draw_crater_counts(images, landmarks, title),
        f"{title} (figures 8b and 9 of Cheng et al. 2003): {images['n_detections'].mean():.3g}"
        f" craters an image on average, median {images['n_detections'].median():.3g}.",
        "Two histograms: craters detected in an image, and images that show a landmark.",
    )


def _first(table: pd.DataFrame) -> pd.DataFrame:
    """Leave only the first trial that is stored."""
    first: pd.DataFrame = table[table["trial"] == table["trial"].min()]
    return first


REPORT = replace(
    ORBIT_REPORT,
    records=lambda run, comparison: (*navigation_records(run), *ORBIT_REPORT.records(run, comparison)),
    tables=lambda content: (navigation_grid(content.records, content.run), *ORBIT_REPORT.tables(content)),
    figures=lambda content: (*navigation_figures(content.run), *ORBIT_REPORT.figures(content)),
)

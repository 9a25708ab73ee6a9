"""The tables of a report: the same cells for the page, for Markdown and for the terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from reports.comparison import VERDICT_RULE, ComparedClaim, ComparedValue
from reports.detection import AUC, BAD, DEFINITIONS, MEASURE, THRESHOLD, TRUE_POSITIVES
from reports.measures import CONTROL, DERIVED, DIAGNOSTICS, FAILURES_AT_PRIOR, Record, find, unit_of
from reports.paired import (
    BETTER,
    DIFFERENCE,
    DIFFERENCES,
    FAILURE_RATE,
    OWN,
    PAIRED,
    SIGN_TEST,
    THEIRS,
)
from reports.run_data import RunData
from reports.statistics import MEAN, MEDIAN, P95, RMS, ROOT_MEDIAN_SQUARE

NO_VALUE = "-"
_STAGES = {
    CONTROL: "prior",
    "centroid": "after centroiding",
    "alignment": "after alignment",
    "recognition": "after recognition",
    "range": "after the range",
    "final": "final",
    FAILURES_AT_PRIOR: "failures at prior",
    "database": "data base",
    DIAGNOSTICS: "of each trial",
    DERIVED: "of the scenario",
}
_TIMED = {
    "mesh_rendering": "data base image rendering",
    "centroid": "brightness centroid",
    "feature_extraction": "feature extraction",
    "recognition": "recognition and pose estimation",
    "consistency": "consistency of the solution",
    "range": "fusion of the range",
    "image": "image (rendered or read)",
    "stored_image": "image (from the store)",
}
_FRAME = r"^frame \d+: "
_NUMBER = r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?![\w])"
_MEASURES = {
    "position_error_m": "position error",
    "position_error_x_m": "position error, x",
    "position_error_y_m": "position error, y",
    "position_error_z_m": "position error, z",
    "attitude_error_deg": "attitude error",
    "n_landmarks": "landmarks an image",
    "four_landmarks_share": "four landmarks or more",
    "landmark_observations": "landmark observations",
    "landmark_error_m": "landmark error",
    "chi_square": "chi-square of a landmark",
    "error_after_1_m": "position error after 1 revolution",
    "error_after_2_m": "position error after 2 revolutions",
    "error_after_1_ratio": "ratio of the position errors after 1 revolution",
    "error_after_2_ratio": "ratio of the position errors after 2 revolutions",
    "landmark_rmse_m": "landmark RMSE",
    "settled_landmark_rmse_m": "landmark RMSE without new ones",
    "final_landmark_rmse_m": "landmark RMSE as seen last",
    "mean_position_nees": "mean NEES of the position (3 expected)",
    "landmarks": "landmarks in the data base",
    "facets": "facets of the data base",
    "centroid_offset_px": "offset of the brightness centroid",
    "centroid_du_px": "offset of the centroid along the columns",
    "extent_px": "extent of the body, longer side",
    "diameter_px": "extent of the body, disc of equal area",
    "pixel_scale_m": "a pixel on the surface",
    "pixel_rotation_deg": "rotation of the body by a pixel",
    "pixel_displacement_m": "displacement of the camera by a pixel",
    "outlier_rounds": "outlier rounds",
    "database_landmarks": "landmarks in the data base",
    "database_facets": "facets of the data base",
    "database_bytes": "size of the data base",
    "position_reduction_m": "reduction of the position error",
    "attitude_reduction_deg": "reduction of the attitude error",
    "seconds": "time",
}


@dataclass(frozen=True, slots=True)
class Grid:
    """A table of printed cells.

    Parameters
    ----------
    title, note
        Heading, and what a reader must know to read it.
    columns
        Headings of the columns.
    rows
        Cells, as many as columns.
    text
        Numbers of the columns that hold text; the others hold numbers and align right.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    text: frozenset[int] = frozenset({0})
    note: str = ""

    def keep(self, *columns: str) -> Grid:
        """Keep only the named columns."""
        chosen = [self.columns.index(name) for name in columns]
        rows = tuple(tuple(row[i] for i in chosen) for row in self.rows)
        text = frozenset(new for new, old in enumerate(chosen) if old in self.text)
        return Grid(self.title, columns, rows, text, self.note)

    def markdown(self) -> str:
        """Write as a Markdown table under its heading."""
        rule = [":--" if i in self.text else "--:" for i in range(len(self.columns))]
        cells = [self.columns, rule, *([_escape(cell) for cell in row] for row in self.rows)]
        table = "\n".join(f"| {' | '.join(row)} |" for row in cells)
        return "\n\n".join(part for part in (f"### {self.title}", self.note, table) if part) + "\n"


def _escape(cell: str) -> str:
    """Keep a text from ending its Markdown cell."""
    return cell.replace("\\", "\\\\").replace("|", "\\|").replace("\n", " ")


def number(value: float | None) -> str:
    """Print three significant digits (whole numbers from 100 on); ``-`` for no value."""
    if value is None:
        return NO_VALUE
    if value == 0 or abs(value) >= 100:
        return f"{value:.0f}"
    return f"{value:.{max(0, 2 - math.floor(math.log10(abs(value))))}f}"


def value_of(record: Record | None, interval: bool = False) -> str:
    """Print a record's value, on request with its interval; times with s or ms."""
    if record is None or record.value is None:
        return NO_VALUE
    if record.statistic == "count":
        return str(int(record.value))
    if record.statistic == "value":
        interval = False
    scale, unit = (1.0, "") if record.unit != "s" else (1.0, " s") if record.value >= 1 else (1e3, " ms")
    value = f"{number(scale * record.value)}{unit}"
    if not interval or record.low is None or record.high is None:
        return value
    return f"{value} [{number(scale * record.low)}, {number(scale * record.high)}]"


def counts(record: Record | None) -> str:
    """Print n_ok/n."""
    return NO_VALUE if record is None else f"{record.n_ok}/{record.n}"


def stage_label(stage: str, timed: bool = False) -> str:
    """Name a stage in plain words: as a state of the pose, or as a piece of work that takes time."""
    return (_TIMED if timed else _STAGES).get(stage, stage.replace("_", " "))


def measure_label(name: str) -> str:
    """Name a measure in plain words."""
    return _MEASURES.get(name, name.removesuffix(f"_{unit_of(name)}").replace("_", " "))


def pose_grids(records: Sequence[Record]) -> list[Grid]:
    """Tabulate pose errors after each stage, a grid for each scenario."""
    note = (
        "Median with its 95 % bootstrap interval, RMS and 95th percentile of the error; x, y, z: root-median-square "
        "along the camera axes (x right, y down, z along the boresight), in m. ok: trials behind the line, of all. "
        "Failures at prior: every trial, a failed one with the error of its prior."
    )
    heads = ("estimator", "stage", "ok", "position m", "RMS", "95th", "x", "y", "z", "attitude deg", "RMS", "95th")
    own = [r for r in records if r.measure == "position_error_m" and r.statistic == MEDIAN.name and r.reference == ""]
    grids = []
    for scenario in dict.fromkeys(r.scenario for r in own):
        lines = _pose_lines([r for r in own if r.scenario == scenario])
        rows = tuple((_who(line), stage_label(line.stage), *_pose_cells(records, line)) for line in lines)
        grids.append(Grid(f"Pose error, {scenario}", heads, rows, frozenset({0, 1}), note))
    return grids


def _pose_lines(own: Sequence[Record]) -> list[Record]:
    """Choose the lines of one scenario: the prior, which all share, once; failures at the prior where there are any."""
    priors = [r for r in own if r.stage == CONTROL]
    later = [r for r in own if r.stage != CONTROL]
    failed = {r.estimator for r in later if r.n_ok < r.n}
    return priors[:1] + [r for r in later if r.stage != FAILURES_AT_PRIOR or r.estimator in failed]


def _who(line: Record) -> str:
    return "" if line.stage == CONTROL else line.estimator


def _pose_cells(records: Sequence[Record], line: Record) -> tuple[str, ...]:
    """Cells of the columns from ``ok`` on."""

    def get(measure: str, statistic: str) -> Record | None:
        return find(
            records,
            scenario=line.scenario,
            estimator=line.estimator,
            stage=line.stage,
            reference=line.reference,
            measure=measure,
            statistic=statistic,
        )

    def magnitude(name: str) -> list[str]:
        return [
            value_of(get(name, MEDIAN.name), interval=True),
            value_of(get(name, RMS.name)),
            value_of(get(name, P95.name)),
        ]

    axes = [value_of(get(f"position_error_{axis}_m", ROOT_MEDIAN_SQUARE.name)) for axis in "xyz"]
    return (counts(line), *magnitude("position_error_m"), *axes, *magnitude("attitude_error_deg"))


def reference_grid(records: Sequence[Record], run: RunData) -> Grid | None:
    """Tabulate final pose errors against the truth and each further reference; None if there is only the truth."""
    medians = [r for r in records if r.measure == "position_error_m" and r.statistic == MEDIAN.name]
    ends = {(r.scenario, r.estimator, r.stage) for r in medians if r.reference}
    lines = [r for r in medians if (r.scenario, r.estimator, r.stage) in ends]
    heads = ("estimator", "against", "ok", "position m", "RMS", "95th", "x", "y", "z", "attitude deg", "RMS", "95th")
    note = "No reference pose is exact truth: each error contains the error of the pose that it is measured against."
    rows = tuple(
        (line.estimator, line.reference or run.truth_name(line.scenario), *_pose_cells(records, line)) for line in lines
    )
    return Grid("Scored against each reference pose", heads, rows, frozenset({0, 1}), note) if rows else None


def comparison_grid(compared: Sequence[ComparedValue]) -> Grid | None:
    """Tabulate published values beside ours; None if the campaign is compared with nothing."""
    if not compared:
        return None
    heads = (
        "quantity",
        "stage",
        "statistic",
        "paper",
        "ours [95 %]",
        "ok",
        "tolerance",
        "verdict",
        "place in the paper",
    )
    several = len({(c.scenario, c.estimator) for c in compared}) > 1
    rows = tuple(_compared_cells(c, several) for c in compared)
    return Grid("Beside the published values", heads, rows, frozenset({0, 1, 2, 7, 8}), VERDICT_RULE)


def verdict_grid(compared: Sequence[ComparedValue]) -> Grid | None:
    """Tabulate the same in few columns, without times; None if the campaign is compared with nothing."""
    several = len({(c.scenario, c.estimator) for c in compared}) > 1
    rows = []
    for item in compared:
        if item.published.measure != "seconds":
            quantity, stage, statistic, paper, ours, _, _, verdict, _ = _compared_cells(item, several)
            rows.append((f"{quantity}, {stage}, {statistic}", paper, ours, verdict))
    heads = ("quantity", "paper", "ours [95 %]", "verdict")
    return Grid("Beside the published values", heads, tuple(rows), frozenset({0, 3})) if rows else None


def claim_medians(ours: Sequence[Record | None]) -> str:
    """Print the medians in the order of a claim, with the relation that holds between neighbours; ``-`` for none."""
    parts: list[str] = []
    for before, record in zip((None, *ours), ours, strict=False):
        parts += [_relation(before, record)] if parts else []
        parts.append(f"{record.estimator} {value_of(record, interval=True)} {record.unit}" if record else NO_VALUE)
    return " ".join(parts) or NO_VALUE


def _relation(before: Record | None, after: Record | None) -> str:
    if before is None or after is None or before.value is None or after.value is None:
        return "?"
    return "<" if before.value < after.value else ">" if before.value > after.value else "="


def claim_grid(claims: Sequence[ComparedClaim]) -> Grid | None:
    """Tabulate orders that the paper states in words; None if it states none."""
    heads = ("the paper says", "ours: medians [95 %], in that order", "verdict", "place in the paper")
    rows = tuple(
        (
            item.claim.text,
            claim_medians(item.ours),
            item.verdict,
            item.claim.place,
        )
        for item in claims
    )
    return Grid("Beside what the paper says in words", heads, rows, frozenset({0, 1, 2, 3})) if rows else None


def _compared_cells(compared: ComparedValue, several: bool) -> tuple[str, ...]:
    published, ours = compared.published, compared.ours
    quantity = measure_label(published.measure)
    judged = compared.verdict != "context" and published.tolerance is not None
    return (
        f"{compared.scenario}, {compared.estimator}: {quantity}" if several else quantity,
        stage_label(published.stage, timed=published.measure == "seconds"),
        published.statistic,
        published.printed,
        value_of(ours, interval=True),
        counts(ours),
        f"± {published.tolerance:g}" if judged else NO_VALUE,
        compared.verdict,
        published.place,
    )


def detail_grid(records: Sequence[Record]) -> Grid | None:
    """Tabulate improvement trial by trial, landmarks and data base; None if nothing of it was measured."""
    names = [name for name in _MEASURES if not name.startswith(("position_error", "attitude_error", "seconds"))]
    chosen = [r for r in records if r.measure in names and r.stage != DIAGNOSTICS]
    heads = ("scenario", "estimator", "quantity", "statistic", "value [95 %]", "unit", "ok")

    def cells(r: Record) -> tuple[str, ...]:
        quantity = measure_label(r.measure) + (f" against {r.reference}" if r.reference else "")
        return (r.scenario, r.estimator, quantity, r.statistic, value_of(r, interval=True), r.unit, counts(r))

    rows = tuple(cells(r) for r in chosen)
    note = "A reduction is the prior's error minus the final error of the same trial: positive where the pose improved."
    return Grid("Improvement, landmarks and data base", heads, rows, frozenset({0, 1, 2, 3, 5}), note) if rows else None


def diagnostic_grid(records: Sequence[Record]) -> Grid | None:
    """Tabulate the numbers that estimators report beside the pose; None if there are none."""
    lines = [r for r in records if r.stage == DIAGNOSTICS and r.statistic == MEDIAN.name]
    heads = ("scenario", "estimator", "number", "median [95 %]", "mean", "RMS", "95th percentile", "unit", "trials")

    def other(line: Record, statistic: str) -> str:
        key = {"scenario": line.scenario, "estimator": line.estimator, "stage": DIAGNOSTICS, "measure": line.measure}
        return value_of(find(records, **key, statistic=statistic))

    rows = tuple(
        (
            line.scenario,
            line.estimator,
            line.measure,
            value_of(line, interval=True),
            *(other(line, statistic.name) for statistic in (MEAN, RMS, P95)),
            line.unit,
            counts(line),
        )
        for line in lines
    )
    return Grid("Diagnostics", heads, rows, frozenset({0, 1, 2, 7})) if rows else None


def paired_grid(records: Sequence[Record]) -> Grid | None:
    """Tabulate estimators beside the first one on the same trials; None where there is only one."""
    names = list(DIFFERENCES)
    lines = [r for r in records if r.stage == PAIRED and r.measure == names[0] and r.statistic == MEDIAN.name]
    heads = (
        "scenario", "estimator", "against", "both ok", "position m [95 %]", "better", "p", "attitude deg [95 %]",
        "better", "p", "failures", "of the other", "difference [95 %]",
    )  # fmt: skip

    def cells(line: Record) -> tuple[str, ...]:
        key = {"scenario": line.scenario, "estimator": line.estimator, "stage": PAIRED, "reference": line.reference}

        def get(measure: str, statistic: str, interval: bool = False) -> str:
            return value_of(find(records, **key, measure=measure, statistic=statistic), interval)

        def chance(measure: str) -> str:
            found = find(records, **key, measure=measure, statistic=SIGN_TEST)
            p = None if found is None else found.value
            return "< 0.001" if p is not None and p < 1e-3 else value_of(found)

        differences = [
            cell for name in names for cell in (get(name, MEDIAN.name, interval=True), get(name, BETTER), chance(name))
        ]
        rates = (get(FAILURE_RATE, OWN), get(FAILURE_RATE, THEIRS), get(FAILURE_RATE, DIFFERENCE, interval=True))
        return (line.scenario, line.estimator, line.reference, counts(line), *differences, *rates)

    note = (
        "On the same images and priors: median of the differences of the errors, trial by trial (negative is better),"
        " share of trials in which it is better, and p of the sign test. Failures: no estimate, or a position error"
        " above the prior's."
    )
    rows = tuple(cells(line) for line in lines)
    return Grid("Estimators on the same trials", heads, rows, frozenset({0, 1, 2}), note) if rows else None


def outlier_grid(records: Sequence[Record]) -> Grid | None:
    """Tabulate how well the numbers that estimators report tell their bad solutions; None where there are none."""
    lines = [r for r in records if r.measure.startswith(MEASURE) and r.statistic == AUC]
    heads = ("scenario", "estimator", "bad", "number", "of", "AUC [95 %]", TRUE_POSITIVES, "threshold", "flagged")

    def cells(line: Record) -> tuple[str, ...]:
        key = {"scenario": line.scenario, "estimator": line.estimator, "stage": line.stage, "measure": line.measure}
        true, threshold, bad = (find(records, **key, statistic=name) for name in (TRUE_POSITIVES, THRESHOLD, BAD))
        return (
            line.scenario,
            line.estimator,
            DEFINITIONS[line.stage],
            line.measure.removeprefix(MEASURE),
            f"{0 if bad is None else round(bad.value or 0)}/{line.n}",
            value_of(line, interval=True),
            value_of(true),
            value_of(threshold),
            "below" if (line.value or 0.0) < 0.5 else "above",
        )

    note = (
        "How well a number that the estimator reports tells its bad solutions: area under the receiver operating"
        " characteristic (0.5 is chance; below it, small values tell), and the share of bad solutions beyond the"
        " threshold that flags 5 % of the good ones."
    )
    rows = tuple(cells(line) for line in lines)
    return Grid("Bad solutions, and what tells them", heads, rows, frozenset({0, 1, 2, 3, 8}), note) if rows else None


def timing_grid(records: Sequence[Record]) -> Grid | None:
    """Tabulate wall time by stage; None if no times were stored."""
    lines = [r for r in records if r.measure == "seconds" and r.statistic == MEDIAN.name]
    heads = ("scenario", "estimator", "stage", "median [95 %]", "mean", "95th percentile", "trials")

    def other(line: Record, statistic: str) -> str:
        key = {"scenario": line.scenario, "estimator": line.estimator, "stage": line.stage}
        return value_of(find(records, **key, measure="seconds", statistic=statistic))

    rows = tuple(
        (
            line.scenario,
            line.estimator or NO_VALUE,
            stage_label(line.stage, timed=True),
            value_of(line, interval=True),
            other(line, MEAN.name),
            other(line, P95.name),
            str(line.n_ok),
        )
        for line in lines
    )
    return Grid("Time per stage of a trial", heads, rows, frozenset({0, 1, 2})) if rows else None


def failure_grid(run: RunData) -> Grid | None:
    """Tabulate failures by reason; None if every trial is ok.

    Of sequences, reasons that differ in their frame and numbers alone are one.
    """
    failed, note = run.rows[run.rows["status"] != "ok"], ""
    if not run.epochs.empty:
        alike = failed["reason"].str.replace(_FRAME, "", regex=True).str.replace(_NUMBER, "n", regex=True)
        failed, note = failed.assign(reason=alike), "n stands for numbers that differ from trial to trial."
    keys = ["scenario", "estimator", "status", "reason"]
    tally = failed.value_counts(keys, sort=False).sort_index().sort_values(ascending=False, kind="stable")
    table = tally.reset_index().astype(str)
    rows = tuple(table.itertuples(index=False, name=None))
    heads = ("scenario", "estimator", "status", "reason", "trials")
    return Grid("Failures by reason", heads, rows, frozenset({0, 1, 2, 3}), note) if rows else None

"""Report of crater detectors: rates with intervals over images, errors in pixels, scatter of detected rims."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import nnls

from boresight.reports.figures.craters import draw_confidence_curves, draw_rates
from boresight.reports.figures.named import NamedFigure, file_stem
from boresight.reports.kinds import Content, ReportKind, Tables
from boresight.reports.run.clusters import clusters_of
from boresight.reports.run.data import RunData
from boresight.reports.schema.grid import (
    NO_VALUE,
    SCENARIO,
    Grid,
    record_column,
    record_grid,
    row_grid,
    scenario_grids,
    text_column,
)
from boresight.reports.schema.records import Key, Record
from boresight.reports.schema.tables import measure_of
from boresight.reports.statistics.intervals import has_quantile
from boresight.reports.statistics.measured import MEDIAN, RMS, Measured, Sample, measure_share
from boresight.reports.tables import timing_grid
from boresight.reports.verdicts import comparison_grid
from boresight.scenarios.arrays import MAD_TO_SIGMA, BoolArray
from boresight.scenarios.craters.truth import LEAST_DIAMETER_PX

DETECTION = "detection"
"""Stage of what is counted over the detections that reach the detector's threshold."""

BEST = 12
"""So many of the most confident detections of an image are judged by themselves: as many as the paper finds in one."""

FALSE_SHARES = (0.01, 0.02, 0.05, 0.1, 0.2)
_NOTE = (
    "Over the detections that reach the detector's threshold (`confidence_min`), which was chosen on images of another"
    " world before this run; intervals are 95 %, with images, or worlds of craters where"
    " there are several, as the unit. A detection is matched with a crater whose centre lies within max(0.3 r, 1.5 px)"
    " and whose radius differs by less than 0.36 in its logarithm, one to one. False alarms lead with"
    " the same craters that recall is of: a detection of a listed crater that is not detectable counts neither way, as"
    " difficult objects do in Pascal VOC (Everingham et al. 2010, IJCV 88, 303); detectors of craters are mostly held"
    " against whole catalogues (as Silburt et al. 2019, Icarus 317, 27), which is the second rate, and the third counts"
    " such detections as false. Detectable: 12 px or more"
    " across, 90 % of the rim visible, 95 % in the frame, half of it lit, emission under 60 deg, incidence 20 to 75"
    " deg, degradation up to 0.6, at most 25 % cut. Clean: of these, a rim within 1 % of an ellipse of an axis ratio"
    " over 0.5."
)


@dataclass(frozen=True, slots=True, eq=False)
class DetectorResults:
    """Results of one detector: images, true craters with their matches, and detections.

    Craters and detections have the columns ``kept``: whether by the detector's own threshold; ``world``: within which
    a crater has one number; ``unit``: what is independent of all others, the world where there are several, else the
    image.
    """

    scenario: str
    estimator: str
    images: pd.DataFrame
    craters: pd.DataFrame
    detections: pd.DataFrame


def detector_results(run: RunData) -> Iterator[DetectorResults]:
    """Yield each detector's images, of the trials that it did not fail on for a fault of its own."""
    for scenario, estimator in run.pairs():
        rows = run.of(scenario, estimator)
        images = rows[["scenario", "trial"]].sort_values("trial")
        unit = clusters_of(run, images)
        images = images.assign(unit=unit, world=unit if run.databases > 1 else "")
        found = run.of(scenario, estimator, "detections").merge(images, on=["scenario", "trial"])
        here = run.table("craters").merge(images, on=["scenario", "trial"])
        matched = found.loc[found["crater"] >= 0, ["trial", "crater", "confidence", "kept"]]
        craters = here.merge(matched, on=["trial", "crater"], how="left")
        craters["kept"] = craters["kept"].eq(True)
        craters["diameter_px"] = 2.0 * np.sqrt(craters["major_px"] * craters["minor_px"])
        yield DetectorResults(scenario, estimator, images, craters, found)


def crater_records(run: RunData) -> list[Record]:
    """Measure every detector; images on which it failed count with what is there and nothing found."""
    ones = () if run.table("craters").empty else detector_results(run)
    return [record for one in ones for record in _records(one)]


def _records(one: DetectorResults) -> Iterator[Record]:
    craters, found = one.craters, one.detections[one.detections["kept"].to_numpy(dtype=bool)]
    false, counted, best = found["crater"].to_numpy() < 0, counted_detections(found), (found["rank"] < BEST).to_numpy()
    every, good = np.ones(len(found), dtype=bool), best & ~false
    error = found["centre_error_px"].to_numpy(dtype=np.float64)

    def share(name: str, table: pd.DataFrame, yes: BoolArray, of: BoolArray) -> Record:
        sample = Sample(one.scenario, one.estimator, DETECTION, int(of.sum()))
        return sample.record(name, "mean", ratio(yes[of], table["unit"].to_numpy()[of]))

    def errors(what: str, of: BoolArray) -> Iterator[Record]:
        unit = found["unit"].to_numpy()[of]
        axes = np.abs(found[["major_error_px", "minor_error_px"]].to_numpy(dtype=np.float64))[of].ravel()
        for name, values, units in (("centre", error[of], unit), ("axes", axes, np.repeat(unit, 2))):
            sample = Sample(one.scenario, one.estimator, DETECTION, len(values))
            yield from sample.records(f"{what}{name}_error_px", values, units, (MEDIAN, RMS))

    for prefix, which in (("", "detectable"), ("clean_", "clean")):
        of = craters[which].to_numpy(dtype=bool)
        yield share(f"{prefix}detection_share", craters, craters["kept"].to_numpy(dtype=bool), of)
    yield share("false_alarm_share", found, false, counted)
    yield share("listed_false_alarm_share", found, false, every)
    yield share("beyond_detectable_share", found, false | ~counted, every)
    yield share("duplicate_share", found, found["duplicate"].to_numpy(dtype=bool), every)
    sizes = found.groupby("trial").size().reindex(one.images["trial"], fill_value=0)
    of_images = Sample(one.scenario, one.estimator, DETECTION, len(sizes))
    yield from of_images.records("detections_per_image", sizes, one.images["unit"].to_numpy(), (MEDIAN,))
    yield share("best_false_alarm_share", found, false, best & counted)
    yield share("best_within_1px_share", found, error <= 1.0, good)
    yield from errors("best_", good)
    for prefix, which in (("", "detectable"), ("clean_", "clean")):
        yield from errors(prefix, found[which].to_numpy(dtype=bool) & ~false)


def counted_detections(found: pd.DataFrame) -> BoolArray:
    """Tell which detections (m,) count: false ones and those of detectable craters, not of other listed ones."""
    return np.asarray((found["crater"] < 0) | found["detectable"].astype(bool))


def ratio(yes: BoolArray, unit: NDArray[np.generic]) -> Measured:
    """Measure the share (%) of what is true, images or worlds being drawn as a whole; no value of nothing."""
    return measure_share(yes.astype(np.float64), np.ones(len(yes)), unit)


_DETECTOR = text_column("detector", lambda key: key.estimator)
_COLUMNS = (
    SCENARIO,
    _DETECTOR,
    text_column("quantity", lambda key: measure_of(key.measure).axis),
    text_column("statistic", lambda key: key.statistic),
    record_column("value [95 %]", interval=True),
    record_column("n", printed=lambda record: str(record.n) if record else NO_VALUE),
)
_BRIEF_COLUMNS = (
    _DETECTOR,
    record_column("found, %", "detection_share", "mean", interval=True),
    record_column("of clean, %", "clean_detection_share", "mean", interval=True),
    record_column("false, %", "false_alarm_share", "mean", interval=True),
    record_column("of all, %", "listed_false_alarm_share", "mean"),
    record_column("RMS px", "centre_error_px", RMS.name),
)


def _listed_lines(run: RunData) -> Iterator[str]:
    """Yield from which size on the truth lists craters, once for each size."""
    sizes: dict[str, list[str]] = {}
    for name, spec in (run.specs or {}).items():
        if spec.craters is not None and spec.m_per_px is not None:
            listed_m = spec.craters.listed_from_m
            line = f"{listed_m:.3g} m or more ({listed_m / spec.m_per_px:.3g} px at the range of the views)"
            line += f", {100.0 * spec.craters.share_from(listed_m):.0f} % of the population"
            left_out = spec.craters.unlisted_share(LEAST_DIAMETER_PX * spec.m_per_px)
            if left_out > 0.0:
                line += f"; it leaves out {100.0 * left_out:.0f} % of those of {LEAST_DIAMETER_PX:g} px or more"
            sizes.setdefault(line, []).append(name)
    for line, names in sizes.items():
        yield f"The truth{'' if len(sizes) == 1 else ' of ' + ', '.join(names)} lists craters of {line}."


def crater_brief(records: Sequence[Record]) -> list[Grid]:
    """Tabulate what fits a terminal: the rates of each detector, and how far the centres are off; a grid a scenario."""
    lines = dict.fromkeys(Key(r.scenario, r.estimator, DETECTION) for r in records if r.stage == DETECTION)
    return list(scenario_grids("Detection of craters", _BRIEF_COLUMNS, records, lines))


def confidence_curve(one: DetectorResults) -> pd.DataFrame:
    """Tabulate a detector's operating points as the threshold on the confidence falls, a row for each detection.

    Columns: ``false_share``, false alarms among the detections that count (`counted_detections`),
    ``listed_false_share``, among all; ``detectable`` and ``clean``, shares of such craters that are found;
    ``confidence`` and ``kept`` of the detection.
    """
    found = one.detections.sort_values("confidence", ascending=False, kind="stable")
    false = np.cumsum(found["crater"].to_numpy() < 0)
    matched = found["crater"].to_numpy() >= 0
    return found[["confidence", "kept"]].assign(
        false_share=false / np.maximum(np.cumsum(counted_detections(found)), 1),
        listed_false_share=false / np.arange(1, len(found) + 1),
        **{
            name: np.cumsum(found[name].to_numpy(dtype=bool) & matched) / max(int(one.craters[name].sum()), 1)
            for name in ("detectable", "clean")
        },
    )


_CURVE_CELLS = ("of all, %", "confidence", "detectable found, %", "clean found, %", "n")
_CURVE_NOTE = (
    "Had the threshold on the confidence let at most so many false alarms through, over all images together, among"
    " false detections and those of detectable craters; of all: among all detections, of which those of other"
    " listed craters count as right; n: detections kept."
)


def _curve_grid(ones: Sequence[DetectorResults]) -> Grid:
    """List what is found where the threshold lets so many false alarms through at most."""
    rows = []
    for one in ones:
        curve = confidence_curve(one)
        for wanted in FALSE_SHARES:
            allowed = curve[curve["false_share"] <= wanted]
            cells = dict.fromkeys(_CURVE_CELLS, NO_VALUE)
            if len(allowed):
                threshold = float(allowed["confidence"].iloc[-1])
                above = one.craters["confidence"].to_numpy(dtype=np.float64) >= threshold
                unit = one.craters["unit"].to_numpy()
                chosen = [one.craters[name].to_numpy(dtype=bool) for name in ("detectable", "clean")]
                shares = [_cell(ratio(above[of], unit[of])) for of in chosen]
                kept = int((one.detections["confidence"] >= threshold).sum())
                listed = f"{100 * allowed['listed_false_share'].iloc[-1]:.1f}"
                cells = dict(zip(_CURVE_CELLS, (listed, f"{threshold:.3g}", *shares, str(kept)), strict=True))
            whose = {"scenario": one.scenario, "detector": one.estimator}
            rows.append(whose | {"false alarms, % at most": f"{100 * wanted:g}"} | cells)
    return row_grid("Detection of craters by confidence", rows, ("scenario", "detector"), _CURVE_NOTE)


BINNINGS = (
    ("diameter, px", "diameter_px", (12.0, 16.0, 24.0, 36.0, 60.0, np.inf)),
    ("degradation", "degradation", (0.0, 0.15, 0.3, 0.45, 0.6)),
    ("incidence, deg", "incidence_deg", (20.0, 35.0, 45.0, 55.0, 65.0, 75.0)),
)
"""Quantities by which rates are binned: name, column, and edges of the bins."""


def binned_rates(
    one: DetectorResults, column: str, edges: Sequence[float]
) -> Mapping[tuple[float, float], tuple[Measured, int]]:
    """Rates of detectable craters found, with intervals, and their numbers, between edges of something of theirs."""
    craters = one.craters[one.craters["detectable"].astype(bool)]
    of, unit = craters[column].to_numpy(dtype=np.float64), craters["unit"].to_numpy()
    was_found = craters["kept"].to_numpy(dtype=bool)
    rates = {}
    for low, high in pairwise(edges):
        within = (of >= low) & ((of < high) | ((of == high) & (high == edges[-1])))
        rates[low, high] = ratio(was_found[within], unit[within]), int(within.sum())
    return rates


def _binned_grid(ones: Sequence[DetectorResults], what: str, column: str, edges: Sequence[float]) -> Grid:
    rows = []
    for one in ones:
        for (low, high), (rate, n) in binned_rates(one, column, edges).items():
            span = f"{low:g} to {high:g}" if np.isfinite(high) else f"from {low:g}"
            cells = {what: span, "detectable found, %": _cell(rate), "n": str(n)}
            rows.append({"scenario": one.scenario, "detector": one.estimator} | cells)
    return row_grid(f"Detection of craters by {what.split(',')[0]}", rows, ("scenario", "detector", what))


def _cell(rate: Measured) -> str:
    if rate.value is None:
        return NO_VALUE
    ends = "" if rate.low is None or rate.high is None else f" [{rate.low:.1f}, {rate.high:.1f}]"
    return f"{rate.value:.1f}{ends}"


def _image_grid(run: RunData) -> Grid:
    """Tell what the images are like."""
    rows, labels = [], {
        "phase_deg": "phase, deg", "n_craters": "listed craters in sight", "n_detectable": "detectable craters",
        "n_clean": "clean craters",
    }  # fmt: skip
    for scenario, images in run.table("crater_images").groupby("scenario", sort=False):
        for name, label in labels.items():
            values = images[name].to_numpy(dtype=np.float64)
            low, middle, high = (f"{end:.3g}" for end in np.percentile(values, [5.0, 50.0, 95.0]))
            if not has_quantile(len(values), 0.05):
                low = high = NO_VALUE
            rows.append((str(scenario), label, low, middle, high, str(len(values))))
    heads = ("scenario", "of an image", "5 %", "median", "95 %", "images")
    return Grid("Images", heads, tuple(rows), frozenset({0, 1}))


_SIZES = 10
_LEAST = 5 * _SIZES
_EMISSION_DEG, _INCIDENCE_DEG, _IN_FRAME = 65.0, 80.0, 0.95
_HEADS = ("centre_sigma_px", "centre_sigma_radii", "size_sigma", "axes_sigma", "redetected")
_RIM_NOTE = (
    "Deviations under the names that `association` has for them, of detections that reach the detector's threshold and"
    " are matched. A coordinate of the centre has the variance centre_sigma_px^2 + (centre_sigma_radii r)^2, fitted to"
    " tenths of the detections by their radius r; each tenth's is the median absolute deviation times"
    f" {MAD_TO_SIGMA}, as those who use it leave out what is far off. Size and axes are logarithms of the ratios of"
    " radii and of ratios of axes, weighed by a normal law: standard deviations. redetected: of craters that two other"
    f" images show detected, the share detected where they are in the frame, emission under {_EMISSION_DEG:g} deg and"
    f" incidence under {_INCIDENCE_DEG:g} deg. A campaign whose methods are given these must show other craters."
)


def rim_scatter(one: DetectorResults) -> dict[str, float] | None:
    """Measure the scatter of detected rims about true ones, as the note of `rim_grid` says; None with too few matches.

    The keys are `_HEADS`.
    """
    found = one.detections
    found = found[found["kept"].to_numpy(dtype=bool) & (found["crater"].to_numpy() >= 0)]
    if len(found) < _LEAST:
        return None
    axes = found[["major_px", "minor_px"]].to_numpy(dtype=np.float64)
    true = axes - found[["major_error_px", "minor_error_px"]].to_numpy(dtype=np.float64)
    square, ratios = true.prod(axis=1), np.log(axes / true)
    # The variance of a coordinate of the centre is fitted to tenths of the radii, each counting by its relative error.
    centre = found[["centre_error_u_px", "centre_error_v_px"]].to_numpy(dtype=np.float64)
    tenths = np.array_split(np.argsort(np.sqrt(square), kind="stable"), _SIZES)
    spread = [np.median(np.abs(centre[rows] - np.median(centre[rows]))) for rows in tenths]
    variance = (MAD_TO_SIGMA * np.array(spread)) ** 2
    weight = 1.0 / np.maximum(variance, np.finfo(np.float64).tiny)
    squares = np.array([square[rows].mean() for rows in tenths])
    fitted, _ = nnls(np.column_stack([weight, weight * squares]), weight * variance)
    size, shape = 0.5 * ratios.sum(axis=1), ratios[:, 1] - ratios[:, 0]
    numbers = (*np.sqrt(fitted), size.std(), shape.std(), _redetected(one.craters))
    return dict(zip(_HEADS, map(float, numbers), strict=True))


def _redetected(craters: pd.DataFrame) -> float:
    """Share of the looks at known craters, those that two other images show detected, in which they are detected."""
    kept = craters["kept"].to_numpy(dtype=bool)
    elsewhere = craters.groupby(["world", "crater"])["kept"].transform("sum").to_numpy(dtype=np.int64) - kept
    looks = (
        (elsewhere >= 2)
        & (craters["in_frame"].to_numpy() >= _IN_FRAME)
        & (craters["emission_deg"].to_numpy() <= _EMISSION_DEG)
        & (craters["incidence_deg"].to_numpy() <= _INCIDENCE_DEG)
    )
    return float(kept[looks].mean()) if looks.any() else 0.0


def rim_grid(ones: Sequence[DetectorResults]) -> Grid:
    """Tabulate the scatter of each detector."""
    rows = []
    for one in ones:
        scatter = rim_scatter(one) or {}
        cells = {head: f"{scatter[head]:.3g}" if head in scatter else NO_VALUE for head in _HEADS}
        rows.append({"scenario": one.scenario, "detector": one.estimator} | cells)
    return row_grid("Scatter of detected rims", rows, ("scenario", "detector"), _RIM_NOTE)


def crater_figures(run: RunData) -> Iterator[NamedFigure]:
    """Draw, for each scenario, the curves over confidence and the rates by what craters are like."""
    of_scenario: dict[str, list[DetectorResults]] = {}
    for one in detector_results(run):
        if len(one.detections):
            of_scenario.setdefault(one.scenario, []).append(one)
    for scenario, ones in of_scenario.items():
        title = f"Craters found over false alarms, {scenario}"
        yield NamedFigure(
            file_stem("crater_curves", scenario),
            draw_confidence_curves({one.estimator: confidence_curve(one) for one in ones}, title),
            f"{title}: as the threshold on the confidence falls. Detections of listed craters that are not"
            " detectable count neither way. Circles: at the detector's own threshold."
            " Star: what the paper claims, without a definition.",
            "Curves that rise from the left: the share of craters found against the share of false alarms.",
        )
        panels = {
            what: {
                one.estimator: [
                    (f"{low:g}-{high:g}" if np.isfinite(high) else f"{low:g}+", rate.bar)
                    for (low, high), (rate, _) in binned_rates(one, column, edges).items()
                    if rate.value is not None
                ]
                for one in ones
            }
            for what, column, edges in BINNINGS
        }
        title = f"Detectable craters found, {scenario}"
        yield NamedFigure(
            file_stem("crater_rates", scenario),
            draw_rates(panels, title),
            f"{title}: by diameter, degradation and incidence, at each detector's threshold; bars: 95 %, by images.",
            "Rates with error bars in bins of diameter, degradation and incidence.",
        )


def tables(content: Content) -> Tables:
    """List rates and errors, the curve over confidence, rates by what craters are like, the images, and the scatter."""
    run, ones = content.run, list(detector_results(content.run))
    lines = [r for r in content.records if r.stage == DETECTION]
    note = " ".join((*_listed_lines(run), _NOTE))
    rates = record_grid("Detection of craters", _COLUMNS, content.records, lines, note)
    binned = (_binned_grid(ones, *binning) for binning in BINNINGS)
    return (
        *([rates, _curve_grid(ones), *binned, _image_grid(run)] if rates else ()),
        rim_grid(ones),
        comparison_grid(content.compared),
        timing_grid(content.records),
    )


REPORT = ReportKind(
    records=lambda run, comparison: crater_records(run),
    tables=tables,
    brief=lambda content: crater_brief(content.records),
    figures=lambda content: () if content.run.table("craters").empty else crater_figures(content.run),
)

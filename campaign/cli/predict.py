"""``predict``: print the covariance that a campaign will give, without images."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from rich.table import Table

from boresight.campaign.cli.terminal import console, writing
from boresight.campaign.runs.check import check_campaign
from boresight.campaign.runs.predict import PredictedError, predict_errors, summarise, tabulate, with_predictors
from boresight.campaign.runs.resolve import resolve
from boresight.campaign.store import find_run
from boresight.renderers.mitsuba3 import choose_variant
from boresight.reports.run.data import read_run
from boresight.reports.schema.grid import NO_VALUE
from boresight.reports.schema.records import count_of
from boresight.scenarios.atomic import write_text
from boresight.scenarios.errors import BoresightError, display

_TRIALS = 20
_FORMATS = (".csv", ".json")
_MOST_LINES, _EXTREMES = 40, 3
"""Lines up to which all are printed; of more, so many of the best and of the worst of each estimator and error."""
_NAMES = {
    "position_m": "position, m",
    "attitude_deg": "attitude, deg",
    "sight_urad": "line of sight, urad",
    "range_m": "range, m",
}


def predict_command(arguments: argparse.Namespace) -> int:
    """Predict the errors of a campaign's estimators, and print them next to those of a run."""
    out, folder = console(), None if arguments.run is None else find_run(arguments.run)
    if arguments.out is not None and arguments.out.suffix not in _FORMATS:
        raise BoresightError(f"--out {display(arguments.out)}: ends neither in {' nor in '.join(_FORMATS)}")
    run = None if folder is None else read_run(folder.path)
    variant = choose_variant(None).name if run is None else str(run.manifest.machine["variant"])
    campaign = resolve(arguments.name, arguments.overrides, arguments.seed, variant, embedded=arguments.embedded)
    chosen, others = with_predictors(campaign, [] if arguments.estimator is None else [arguments.estimator])
    if folder is not None and (folder.read_manifest() or {}).get("digest") != campaign.digest:
        raise BoresightError(
            f"--run {display(folder.path)}: is not a run of this campaign with these scenarios, options, seed and"
            " versions, or is a draft of it: give its own --set and --seed, or run it again"
        )
    stored = None if run is None else int(run.rows["trial"].max()) + 1
    trials = arguments.trials or stored or _TRIALS
    bodies = check_campaign(chosen, trials)
    with tempfile.TemporaryDirectory(prefix="boresight-predict-") as place:
        predicted = predict_errors(chosen, trials, Path(place), out.print)
    del bodies  # held until here: scenarios that share one read it once
    found = list(summarise(predicted, run))
    if arguments.out is not None:
        table = tabulate(found, chosen, run is not None)
        csv = arguments.out.suffix == ".csv"
        text = (
            table.to_csv(index=False, lineterminator="\n") if csv else table.to_json(orient="records", indent=1) + "\n"
        )
        with writing(arguments.out):
            write_text(arguments.out, text)
    shown = found if len(found) <= _MOST_LINES else _extremes(found)
    out.print(_table(shown, run is not None))
    if shown is not found:
        scenarios, rest = count_of(len(chosen.scenarios), "scenario"), "give --out FILE.csv for all"
        rest = f"all {len(found):,} lines are in {display(arguments.out)}" if arguments.out is not None else rest
        out.print(
            f"of {scenarios} the {_EXTREMES} best and {_EXTREMES} worst of each estimator and error (a view without a"
            f" prediction is worse than any); {rest}"
        )
    missing = [one for one in found if not one.n]
    for one in missing[:_EXTREMES]:
        why = "geometry or options allow none, or its tracks are of images or of a file"
        out.print(f"{one.scenario}, {one.estimator}: no prediction: {why}")
    if missing[_EXTREMES:]:
        out.print(f"and {len(missing) - _EXTREMES:,} more without a prediction")
    out.print(f"linear, at the views of {trials} trials, seed {campaign.seed}; no image was made")
    if others:
        out.print(f"no predictor: {', '.join(others)}")
    return 0


def _extremes(found: list[PredictedError]) -> list[PredictedError]:
    """Choose the best and the worst predictions of each estimator and error: a view without one is worse than any."""
    groups: dict[tuple[str, str], list[PredictedError]] = {}
    for one in found:
        if one.n:
            groups.setdefault((one.estimator, one.measure), []).append(one)
    chosen = []
    for group in groups.values():
        ordered = sorted(group, key=lambda one: (one.trials - one.n, one.predicted))
        few = min(_EXTREMES, len(ordered) // 2)
        chosen += ordered[:few] + ordered[len(ordered) - few :]
    return chosen


def _table(found: list[PredictedError], compared: bool) -> Table:
    heads = ["scenario", "estimator", "error", "predicted", "n", "CPU ms"]
    heads += ["RMS error", "stated", "n ok", "RMS / predicted"] if compared else []
    table = Table(*heads, box=None, pad_edge=False)
    for one in found:
        cells = [one.scenario, one.estimator, _NAMES[one.measure], _number(one.predicted if one.n else None)]
        cells += [f"{one.n} / {one.trials}", f"{1e3 * one.seconds:.2f}"]
        if compared:
            low, high = one.interval
            between = "" if low is None else f" [{low:.3g}, {high:.3g}]"
            ratio = NO_VALUE if one.ratio is None else f"{one.ratio:.3g}{between}"
            cells += [_number(one.error), _number(one.stated), str(one.n_ok), ratio]
        table.add_row(*cells)
    return table


def _number(value: float | None) -> str:
    return NO_VALUE if value is None else f"{value:.4g}"

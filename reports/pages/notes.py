"""What a reader must know of a run before trusting its numbers."""

from __future__ import annotations

from collections.abc import Iterator

from reports.published import Comparison
from reports.run.clusters import image_set
from reports.run.conditional import database_line
from reports.run.data import RunData
from reports.run.known import known_lines
from reports.schema.labels import count_of


def notes(run: RunData, comparison: Comparison | None) -> Iterator[str]:
    """Yield the notes in the order of the report: what the run is, how its numbers are made, what is not there."""
    yield from filter(None, (run.manifest.description, *_scenario_lines(run)))
    yield from known_lines(run)
    done, total = run.progress()
    if done < total:
        yield f"The run is not finished: {done} of {total} trials."
    yield (
        "Intervals are of 95 %: of medians and percentiles between order statistics, of means by the studentised"
        " bootstrap (2,000 resamples of whole trials or, for real images, of whole images, because the noise"
        " realisations of one image are not independent), of fewer than ten by Student's t. Of an RMS of few trials"
        " with some far worse than the others they hold less than they say. Percentiles beyond which less than one"
        " trial is to be expected are left out."
    )
    yield from filter(None, [database_line(run)])
    yield from _set_lines(run)
    posed = bool(run.posed_pairs())
    if posed:
        yield (
            "Position error is the difference of camera positions in the body frame, its components turned into the"
            " true camera's axes. Failed trials have no error: statistics after a stage are over the trials that"
            " reached it, beside their number, and the line 'failures at prior' counts every trial."
        )
    elif not run.epochs.empty:
        yield (
            "Position error is that of the camera about the body, in inertial axes. A trial that failed has no error"
            " from the frame on at which it ended: statistics after a revolution are over the trials that came so far,"
            " beside their number."
        )
    if (run.rows["image"] != "").any():
        yield (
            "These are real images. The pose that they are scored against is itself an estimate, and so is every"
            " further reference pose: neither is exact truth, and each error below contains the reference's own error."
        )
    if comparison is not None:
        yield f"Published values: {comparison.source}. {comparison.conditions}"
        yield f"Bounds of the verdicts: {comparison.bounds}"
    absent = [name for name in ("stages", "landmarks", "timings") if getattr(run, name).empty]
    if posed and absent:
        yield f"Not stored in this run, so left out: {', '.join(absent)}."
    yield from run.manifest.notes


def _set_lines(run: RunData) -> Iterator[str]:
    """Say on how many sets of images the sequences of a run begin, where they see images."""
    scenarios = [name for name in dict.fromkeys(run.rows["scenario"]) if image_set(run.manifest.scenarios[name])]
    if scenarios:
        seen = run.rows[run.rows["scenario"].isin(scenarios)]
        starts = len(seen[["scenario", "trial"]].drop_duplicates())
        sets = len({image_set(run.manifest.scenarios[name]) for name in scenarios})
        yield (
            f"{count_of(sets, 'set')} of images (one for each body and texture), {count_of(starts, 'start')}."
            " The starts on one set share the errors of its features: intervals and sign tests take the set for what"
            " is independent, and one set by itself has no interval."
        )


def _scenario_lines(run: RunData) -> Iterator[str]:
    """Say what each scenario is, in the words of its file."""
    scenarios = run.manifest.scenarios
    if isinstance(scenarios, dict) and run.manifest.grid is None:
        for name, spec in scenarios.items():
            if isinstance(spec, dict) and spec.get("description"):
                yield f"Scenario {name}: {spec['description']}"

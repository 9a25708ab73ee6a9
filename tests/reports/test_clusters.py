"""What is independent in a run, by closed forms and scipy: data bases, real images, and sets of rendered images."""

import numpy as np
import pytest
from scipy.stats import binomtest, bootstrap, t
from stored_runs import find
from terminal_text import terminal_lines

from boresight.reports.figures.followed import revolution_figure, revolution_series
from boresight.reports.kinds.design_data import DesignData, Outcome
from boresight.reports.kinds.sequence import ratio_records, sequence_measures, vision_records
from boresight.reports.pages.build import write_report
from boresight.reports.run.clusters import image_set, pools
from boresight.reports.run.data import read_run
from boresight.reports.schema.kinds import SEQUENCE_COLUMNS
from boresight.reports.schema.records import RATIO, SEQUENCE
from boresight.reports.statistics.measured import MEAN, measure, measure_deviation, measure_run
from boresight.reports.statistics.paired import BETTER, SIGN_TEST, paired_records

STARTS = 6
POOL = "sphere, {} sets of images"
OURS, OTHER = "landmark-harris", "other"


def student_mean(values):
    """The mean of (n,) independent numbers with Student's interval, of its logarithm."""
    values = np.asarray(values, dtype=float)
    mean, n = values.mean(), len(values)
    half = t.ppf(0.975, n - 1) * values.std(ddof=1) / np.sqrt(n) / mean
    return pytest.approx((mean, mean * np.exp(-half), mean * np.exp(half)), rel=1e-6)


def add_trial(builder, trial, landmarks, *, estimator=OURS, error_m=1.0, **columns):
    """Add a trial of a number of landmarks, with further columns of its row."""
    builder.trial(trial, ([9, 0, 0], 1), ([error_m, 0, 0], 1), estimator=estimator, n_landmarks=landmarks)
    builder.tables["rows"][-1].update(columns)


def landmarks_of(run, estimator=OURS, scenario="itokawa"):
    """Mean number of landmarks with its interval, and of how many trials."""
    found = find(
        measure_run(run),
        scenario=scenario,
        estimator=estimator,
        stage="final",
        measure="n_landmarks",
        statistic="mean",
    )
    return (found.value, found.low, found.high), (found.n_ok, found.n)


@pytest.mark.parametrize("levels", [(40, 44, 50, 52, 64), (49, 51)])
def test_trials_of_several_data_bases_are_as_many_numbers_as_these(builder, levels):
    """Thirty trials of which those of one data base are equal: the interval is that of five, or two, numbers."""
    for trial in range(30):
        number = trial % len(levels)
        add_trial(builder, trial, levels[number], database=number)
    measured, counts = landmarks_of(read_run(builder.write()))
    assert (measured, counts) == (student_mean(levels), (30, 30))


def test_trials_of_one_data_base_are_independent(builder):
    landmarks = (40, 44, 50, 52, 64, 66)
    for trial, number in enumerate(landmarks):
        add_trial(builder, trial, number, database=0)
    assert landmarks_of(read_run(builder.write()))[0] == student_mean(landmarks)


def test_an_estimator_without_a_data_base_has_independent_trials(builder):
    landmarks = (40, 44, 50, 52, 64, 66)
    for trial, number in enumerate(landmarks):
        add_trial(builder, trial, (49, 51)[trial % 2], database=trial % 2)
        add_trial(builder, trial, number, estimator=OTHER)
    run = read_run(builder.write())
    assert landmarks_of(run)[0] == student_mean((49, 51))
    assert landmarks_of(run, OTHER)[0] == student_mean(landmarks)


def test_a_pair_of_estimators_of_which_one_has_data_bases_is_compared_by_these(builder):
    """Of 18 trials with six data bases, five data bases are better: 6 signs decide, not 18."""
    for trial in range(18):
        add_trial(builder, trial, 50, estimator="first")
        add_trial(builder, trial, 50, error_m=0.5 if trial % 6 else 2.0, database=trial % 6)
    records = paired_records(read_run(builder.write(estimators=["first", OURS])))
    share = find(records, estimator=OURS, reference="first", measure="position_difference_m", statistic=BETTER)
    assert (share.value, share.n_ok, share.n) == (5 / 6, 6, 18)


def test_realisations_of_real_images_are_as_many_numbers_as_images(builder):
    """Four images with three realisations each; a rendered scenario beside them has independent trials."""
    images, rendered = (40, 44, 50, 66), (40, 44, 50, 52, 64, 66)
    for trial in range(12):
        add_trial(builder, trial, images[trial // 3], image=f"{trial // 3}.png")
    for trial, number in enumerate(rendered):
        add_trial(builder, trial, number, scenario="rendered")
    run = read_run(builder.write(scenarios={name: {"name": name} for name in ("itokawa", "rendered")}))
    assert landmarks_of(run) == (student_mean(images), (12, 12))
    assert landmarks_of(run, scenario="rendered") == (student_mean(rendered), (6, 6))


def spec(seed, **keys):
    """A scenario as a manifest holds it, as far as a report reads it."""
    return {
        "name": f"sphere-{seed}",
        "body": {"shape": "sphere", "detail": {"seed": seed}},
        "sequence": {"images": {"starts": STARTS}, "orbit": {"revolutions": 2.0}},
    } | keys


def written(builder, errors, **manifest):
    """Write a run; ``errors``: by estimator, (sets, starts) errors after one revolution."""
    sets = len(next(iter(errors.values())))
    for estimator, table in errors.items():
        for seed, row in enumerate(table):
            for trial, error in enumerate(row):
                key = {"trial": trial, "scenario": f"sphere-{seed}", "estimator": estimator}
                ends = dict.fromkeys(SEQUENCE_COLUMNS) | {
                    "error_after_1_m": error, "error_after_2_m": None if error is None else 2.0 * error
                }  # fmt: skip
                pose = {
                    f"{prefix}{name}": np.nan
                    for prefix in ("", "prior_")
                    for name in (
                        "position_error_m", "attitude_error_deg", *(f"position_error_{axis}_m" for axis in "xyz")
                    )
                }  # fmt: skip
                status = "failed" if error is None else "ok"
                builder.add("rows", **key, status=status, reason="", image="", **pose, **ends)
                builder.add("timings", **key, stage="estimation", seconds=0.1)
                for frame in range(0 if error is None else 3):
                    place = {"frame": frame, "anomaly_deg": 180.0 * frame, "position_error_m": 0.5 * frame * error}
                    marks = {"landmark_rmse_m": 1.0, "settled_landmark_rmse_m": 1.0}
                    builder.add("epochs", **key, **place, **marks)
    cells = [{"name": f"sphere-{i}", "base": "sphere", "levels": {"texture": str(i)}} for i in range(sets)]
    axis = {"name": "texture", "label": "texture", "levels": [str(i) for i in range(sets)]}
    own = {
        "scenarios": {f"sphere-{i}": spec(i) for i in range(sets)},
        "grid": {"design": "full", "axes": [axis], "scenarios": cells},
        "estimators": list(errors),
    }
    return read_run(builder.write(**(own | manifest)))


def pooled(run, statistic, name="error_after_1_m"):
    (pool,) = pools(run)
    return find(sequence_measures(run), scenario=pool, stage=SEQUENCE, measure=name, statistic=statistic)


def test_two_sets_of_equal_starts_are_two_numbers(builder):
    """A mean has Student's interval of two, of its logarithm; a median of two that are apart has none."""
    run = written(builder, {"one": np.repeat([[4.0], [5.0]], STARTS, axis=1)})
    mean, median = pooled(run, "mean"), pooled(run, "median")
    half = t.ppf(0.975, 1) * 0.5 / 4.5  # standard error over mean
    assert (mean.value, mean.n_ok, mean.n) == (4.5, 12, 12)
    assert (mean.low, mean.high) == pytest.approx(4.5 * np.exp([-half, half]), rel=1e-6)
    assert (median.value, median.low, median.high) == (4.5, None, None)
    assert pooled(run, "95th percentile").value is None


def test_a_scenario_without_images_beside_those_with_sets_has_independent_trials(builder):
    """Two bodies that images show, and a third whose tracks are simulated."""
    simulated = (4.0, 5.0, 6.0, 8.0, 9.0, 10.0)
    scenarios = {f"sphere-{i}": spec(i) for i in range(2)} | {"sphere-2": spec(2, sequence={"images": None})}
    run = written(builder, {"one": [[4.0] * 6, [5.0] * 6, simulated]}, scenarios=scenarios)
    found = find(sequence_measures(run), scenario="sphere-2", measure="error_after_1_m", statistic="mean")
    assert (found.value, found.low, found.high) == student_mean(simulated)
    assert (pooled(run, "mean").value, pooled(run, "mean").n) == (4.5, 12)


def test_an_estimator_that_never_ends_is_none_of_n(builder):
    run = written(builder, {"one": [[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]], "lost": [[None] * 6]})
    record = find(sequence_measures(run), estimator="lost", measure="error_after_1_m", statistic="mean")
    assert (record.value, record.n_ok, record.n) == (None, 0, 6)


def test_equal_starts_give_the_interval_of_the_sets(builder):
    values = np.random.default_rng(2).gamma(3.0, 2.0, 10)
    record = pooled(written(builder, {"one": np.repeat(values[:, None], STARTS, axis=1)}), "mean")
    alone = measure(values, np.arange(10), (MEAN,))[0]
    assert (record.value, record.low, record.high) == pytest.approx((alone.value, alone.low, alone.high), rel=0.05)
    percentiles = bootstrap((values,), np.mean, n_resamples=2000, method="percentile", rng=3).confidence_interval
    assert record.high > percentiles.high, "which is narrow"


def test_the_deviation_is_resampled_by_sets(builder):
    """Of twenty sets, its interval is that of twenty numbers, not of 120; of ten there is none."""
    values = np.random.default_rng(3).gamma(3.0, 2.0, 20)
    record = pooled(written(builder, {"one": np.repeat(values[:, None], STARTS, axis=1)}), "deviation")
    assert record.value == pytest.approx(np.std(np.repeat(values, STARTS), ddof=1))
    assert record.high - record.low > 0.5 * record.value
    assert measure_deviation(np.repeat(values[:10], STARTS), np.repeat(np.arange(10), STARTS)).low is None


def test_one_set_has_a_value_and_no_interval(builder):
    run = written(builder, {"one": [[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]], "two": [[2.0] * 6]})
    assert pools(run) == {}
    wanted = {"scenario": "sphere-0", "estimator": "one", "measure": "error_after_1_m", "statistic": "mean"}
    record = find(sequence_measures(run), **wanted)
    assert (record.value, record.low, record.high, record.n_ok) == (3.5, None, None, 6)
    ratio = next(iter(ratio_records(run)))
    assert (ratio.value, ratio.low) == (1.75, None)
    share = find(ratio_records_of(run), estimator="one", reference="two", statistic=BETTER)
    assert share.n_ok == 1


def ratio_records_of(run):
    return [r for r in ratio_records(run) if r.measure == "error_after_1_ratio"]


def test_ratio_and_sign_test_take_the_set_as_one(builder):
    rng = np.random.default_rng(4)
    two = rng.uniform(5.0, 9.0, (7, STARTS))
    one = two - 1.0
    one[5:, 2:] += 2.0  # worse from most starts of two sets
    run = written(builder, {"one": one, "two": two})
    records = ratio_records_of(run)
    assert {r.scenario for r in records} == {POOL.format(7)}
    ratio, share, chance = (
        find(records, estimator="one", reference="two", stage=RATIO, statistic=name)
        for name in ("mean", BETTER, SIGN_TEST)
    )
    assert (ratio.value, ratio.n_ok) == (pytest.approx(one.mean() / two.mean()), 42)
    assert (share.value, share.n_ok) == (5 / 7, 7)
    assert chance.value == pytest.approx(binomtest(5, 7).pvalue)

    def ratio_of(a, b):
        return a.mean() / b.mean()

    sets = one.mean(axis=1), two.mean(axis=1)
    error = bootstrap(sets, ratio_of, paired=True, vectorized=False, n_resamples=5000, rng=1).standard_error
    half = t.ppf(0.975, 6) * error * np.sqrt(7 / 6)  # the bootstrap divides by 7
    assert (ratio.low, ratio.high) == pytest.approx((ratio.value - half, ratio.value + half), abs=0.1 * half)


def test_scenarios_that_differ_in_more_than_the_body_are_no_pool(builder):
    errors = {"one": np.ones((3, STARTS))}
    wide = spec(2, camera={"fov_deg": 40.0})
    simulated = spec(1, sequence={"images": None})
    assert image_set(simulated) == ""
    scenarios = {"sphere-0": spec(0), "sphere-1": spec(1), "sphere-2": wide}
    found = pools(written(builder, errors, scenarios=scenarios))
    assert found == {POOL.format(2): ("sphere-0", "sphere-1")}
    assert pools(written(builder, errors, scenarios={**scenarios, "sphere-1": simulated})) == {}


def test_a_scenario_without_rows_yet_is_in_no_pool(builder):
    run = written(builder, {"one": np.ones((1, STARTS))}, scenarios={f"sphere-{i}": spec(i) for i in range(2)})
    assert pools(run) == {}


def test_other_conditions_on_the_same_images_are_the_same_set(builder):
    scenarios = {f"sphere-{i}": spec(0, camera={"fov_deg": 30.0 + i}) for i in range(3)}
    run = written(builder, {"one": np.ones((3, STARTS)) + np.arange(STARTS)}, scenarios=scenarios)
    assert pools(run) == {}
    data = DesignData(run, run.manifest.grid)
    change = data.change("sphere-1", "sphere-0", Outcome("one", SEQUENCE, "error_after_1_m"))
    assert (change.value, change.low) == (pytest.approx(1.0), None)


@pytest.mark.usefixtures("undrawn")
def test_the_report_states_sets_and_starts(builder):
    rng = np.random.default_rng(6)
    errors = {name: rng.uniform(2.0, 9.0, (4, STARTS)) for name in ("one", "two")}
    run = written(builder, errors)
    files = write_report(run.folder)
    text = files.markdown.read_text()
    assert "4 sets of images (one for each body and texture), 24 starts." in text
    assert f"| {POOL.format(4)} | one | position error after 1 revolution |" in text
    assert f"## Sign tests, {POOL.format(4)}" in text
    assert "mean error of / over" in text
    assert "Position error after 1 revolution, sphere-0" not in text
    assert terminal_lines(files.content)


def test_bars_of_one_set_are_not_drawn(builder):
    run = written(builder, {"one": np.ones((2, STARTS)) + np.arange(STARTS)})
    figure = revolution_figure(run, revolution_series(run)).figure
    widths = {float(w) for c in figure.axes[0].collections for w in np.atleast_1d(c.get_linewidth())}
    assert widths == {0.8}


def test_vision_is_told_of_pools(builder):
    errors = {"one": np.ones((2, STARTS))}
    for seed, features, kept_right in ((0, 1800, 0.9), (1, 2200, 0.45)):
        for trial in range(STARTS):
            numbers = dict.fromkeys(("n_tracks", "n_wrong", "error_px", "sigma_px"), 1.0)
            numbers |= {"n_matches": 100, "right_share": 0.9, "n_kept": 80, "kept_right_share": kept_right}
            key = {"trial": trial, "scenario": f"sphere-{seed}", "estimator": "one", "frame": 0}
            builder.add("vision", **key, n_features=features, repeatability=0.9, **numbers)
    records = vision_records(written(builder, errors))
    lost = find(records, scenario=POOL.format(2), measure="lost_right_share", statistic="mean")
    assert lost.value == pytest.approx(40.0), "of 90 right matches 72 are kept, and 36 on the other body"
    pool = find(records, scenario=POOL.format(2), measure="features_per_image", statistic="mean")
    half = t.ppf(0.975, 1) * 200.0 / 2000.0
    assert (pool.value, pool.n_ok) == (2000.0, 12)
    assert (pool.low, pool.high) == pytest.approx(2000.0 * np.exp([-half, half]), rel=1e-6)
    alone = find(records, scenario="sphere-1", measure="features_per_image", statistic="mean")
    assert (alone.value, alone.low) == (2200.0, None)


def test_the_terminal_shows_the_errors_of_sequences(builder):
    run = written(builder, {"one": np.full((1, STARTS), 4.0), "two": np.full((1, STARTS), 7.0)}, grid=None)
    lines = terminal_lines(run.folder)
    assert lines[0].rstrip() == "Median errors, sphere-0"
    assert lines[1].split() == ["estimator", "trials", "1", "revolution", "m", "2", "revolutions", "m"]
    cells = {line.split()[0]: line.split()[1:] for line in lines[3:5]}
    assert cells["one"][:2] == [f"{STARTS}/{STARTS}", "4.00"]
    assert cells["two"][0] == f"{STARTS}/{STARTS}"
    assert "14.0" in cells["two"]


def test_the_terminal_shows_where_sequences_of_less_than_a_revolution_end(builder):
    errors = {"one": 4.0, "two": 7.0}
    written(builder, {name: np.full((1, STARTS), error) for name, error in errors.items()}, grid=None)
    short = {"error_after_1_m": np.nan, "error_after_2_m": np.nan}
    for row in builder.tables["rows"]:
        row |= short | {"position_error_m": errors[row["estimator"]]}
    lines = terminal_lines(builder.write(scenarios={"sphere-0": spec(0)}, estimators=list(errors), grid=None))
    assert lines[0].rstrip() == "Position error, sphere-0"
    assert [line.split()[:4] for line in lines[3:5]] == [
        ["one", "solved", f"{STARTS}/{STARTS}", "4.00"], ["two", "solved", f"{STARTS}/{STARTS}", "7.00"],
    ]  # fmt: skip


def test_the_terminal_tells_the_solved_sequences_from_all_with_failures_counted(builder):
    written(builder, {"one": np.full((1, STARTS), 4.0)}, grid=None)
    for row in builder.tables["rows"]:
        failed = row["trial"] == 0
        row |= {"error_after_1_m": np.nan, "error_after_2_m": np.nan, "position_error_m": np.nan if failed else 4.0}
    folder = builder.write(scenarios={"sphere-0": spec(0)}, estimators=["one"], grid=None)
    lines = [line.split() for line in terminal_lines(folder) if line.startswith("one")][:2]
    assert [line[:3] for line in lines] == [
        ["one", "solved", f"{STARTS - 1}/{STARTS}"], ["one", "failures", "worst"],
    ]  # fmt: skip
    assert lines[1][3] == f"{STARTS}/{STARTS}"

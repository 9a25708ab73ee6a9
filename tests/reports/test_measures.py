import numpy as np
import pandas as pd
import pytest
from stored_runs import find, seal

from boresight.reports.run.data import read_run
from boresight.reports.schema.records import FAILURES_AT_PRIOR
from boresight.reports.statistics.measured import clusters_of, measure_run
from boresight.scenarios.errors import BoresightError

ITOKAWA = {"scenario": "itokawa", "estimator": "landmark-harris"}


def _three_trials(builder):
    builder.trial(0, ([30, 40, 0], 1.0), ([3, 4, 0], 0.1), centroid=([6, 8, 0], 1.0), n_landmarks=50)
    builder.trial(1, ([0, 0, 10], 2.0), ([0, 0, 7], 0.3), centroid=([0, 5, 12], 2.0), n_landmarks=60)
    builder.trial(2, ([60, 80, 0], 1.5), None, centroid=([9, 12, 0], 1.5), n_landmarks=3, reason="too few")


def test_each_stage_is_measured_over_the_trials_that_reached_it(builder):
    _three_trials(builder)
    records = measure_run(read_run(builder.write()))

    def median(stage):
        return find(records, **ITOKAWA, stage=stage, measure="position_error_m", statistic="median")

    assert (median("prior").value, median("prior").n_ok, median("prior").n) == (50.0, 3, 3)
    assert (median("centroid").value, median("centroid").n_ok, median("centroid").n) == (13.0, 3, 3)
    assert (median("recognition").value, median("recognition").n_ok, median("recognition").n) == (6.0, 2, 3)
    counted = median(FAILURES_AT_PRIOR)
    assert (counted.value, counted.n_ok, counted.n) == (7.0, 3, 3)  # 5, 7 and the prior's 100


def test_what_somebody_adds_to_the_lines_of_an_estimator_stays_theirs(builder):
    _three_trials(builder)
    run = read_run(builder.write())
    lines = run.of(*ITOKAWA.values())
    lines["trial"], lines["mine"] = -1, 0.0
    again = run.of(*ITOKAWA.values())
    assert again["trial"].tolist() == [0, 1, 2]
    assert "mine" not in again


def test_components_are_root_median_squares_with_sign_dropped(builder):
    builder.trial(0, ([-3, 0, 0], 1), ([1, 0, 0], 1))
    builder.trial(1, ([4, 0, 0], 1), ([1, 0, 0], 1))
    builder.trial(2, ([-9, 0, 0], 1), ([1, 0, 0], 1))
    records = measure_run(read_run(builder.write()))
    wanted = {"stage": "prior", "measure": "position_error_x_m", "statistic": "root-median-square"}
    assert find(records, **ITOKAWA, **wanted).value == 4.0


def test_improvement_is_paired(builder):
    _three_trials(builder)
    records = measure_run(read_run(builder.write()))
    found = find(records, **ITOKAWA, measure="position_reduction_m", statistic="median")
    assert (found.value, found.n_ok, found.n) == (24.0, 2, 3)  # 50 - 5 and 10 - 7


def test_landmarks_are_counted_over_trials_with_an_estimate(builder):
    _three_trials(builder)
    records = measure_run(read_run(builder.write()))
    found = find(records, **ITOKAWA, measure="n_landmarks", statistic="mean")
    assert (found.value, found.n_ok) == (55.0, 2)


def test_a_run_in_which_everything_failed_has_counts_but_no_values(builder):
    builder.trial(0, ([1, 0, 0], 1), None, reason="black image")
    records = measure_run(read_run(builder.write()))
    found = find(records, **ITOKAWA, stage="final", measure="position_error_m", statistic="median")
    assert (found.value, found.low, found.n_ok, found.n) == (None, None, 0, 1)


def test_realisations_of_one_real_image_are_one_cluster(builder):
    for trial in range(6):
        builder.trial(trial, ([1, 0, 0], 1), ([trial, 0, 0], 1), image=f"image{trial // 3}.png")
    run = read_run(builder.write())
    np.testing.assert_array_equal(clusters_of(run, run.rows), ["image0.png"] * 3 + ["image1.png"] * 3)


def test_landmarks_of_one_trial_are_resampled_together(builder):
    """Twenty equal landmark errors in each of 30 trials: the interval must be that of 30 values, not of 600."""
    rng = np.random.default_rng(0)
    for trial, error in enumerate(rng.normal(10, 1, size=30)):
        builder.trial(trial, ([1, 0, 0], 1), ([1, 0, 0], 1))
        for landmark in range(20):
            key = {"trial": trial, **ITOKAWA, "landmark": landmark}
            builder.add("landmarks", **key, error_m=error, chi_square=error)
    records = measure_run(read_run(builder.write()))
    found = find(records, **ITOKAWA, measure="chi_square", statistic="mean")
    half_width = (found.high - found.low) / 2
    assert half_width == pytest.approx(1.96 / np.sqrt(30), rel=0.3)
    assert (found.n_ok, found.n) == (600, 600)


def test_references_are_measured_apart_from_the_truth(builder):
    builder.trial(0, ([1, 0, 0], 1), ([3, 4, 0], 1))
    key = {"trial": 0, **ITOKAWA, "reference": "label"}
    axes = {"position_error_x_m": 6.0, "position_error_y_m": 8.0, "position_error_z_m": 0.0}
    builder.add("references", **key, position_error_m=10.0, attitude_error_deg=2.0, **axes)
    records = measure_run(read_run(builder.write()))
    wanted = {**ITOKAWA, "stage": "final", "measure": "position_error_m", "statistic": "median"}
    assert find(records, **wanted).value == 5.0
    assert find(records, **wanted, reference="label").value == 10.0


def test_the_gain_over_the_prior_is_told_for_each_reference(builder):
    """Errors of 10 m and 4 deg fall to 7 m and 1 deg in every trial against the label, to 5 m against the truth."""
    zero = dict.fromkeys(("position_error_x_m", "position_error_y_m", "position_error_z_m"), 0.0)
    for trial in range(3):
        builder.trial(trial, ([6, 8, 0], 4), ([3, 4, 0], 1))
        for estimator, position, attitude in (("prior", 10.0, 4.0), (ITOKAWA["estimator"], 7.0, 1.0)):
            key = {"trial": trial, "scenario": ITOKAWA["scenario"], "estimator": estimator, "reference": "label"}
            builder.add("references", **key, position_error_m=position + trial, attitude_error_deg=attitude, **zero)
    records = measure_run(read_run(builder.write()))
    wanted = {**ITOKAWA, "measure": "position_reduction_m", "statistic": "median"}
    assert find(records, **wanted).value == 5.0
    assert find(records, **wanted, reference="label").value == 3.0
    wanted["measure"] = "attitude_reduction_deg"
    assert find(records, **wanted, reference="label").value == 3.0


def test_times_of_a_stage_that_ran_twice_in_a_trial_are_added(builder):
    builder.trial(0, ([1, 0, 0], 1), ([1, 0, 0], 1))
    for _ in range(2):
        builder.add("timings", trial=0, **ITOKAWA, stage="centroid", seconds=0.25)
    records = measure_run(read_run(builder.write()))
    assert find(records, measure="seconds", stage="centroid", statistic="median").value == 0.5


def test_order_of_the_stored_parts_does_not_matter(full_run):
    folder = full_run()
    before = measure_run(read_run(folder))
    part = folder / "rows" / "block-0.parquet"
    _split_reversed(part)
    seal(folder)
    assert measure_run(read_run(folder)) == before


def _split_reversed(part):
    rows = pd.read_parquet(part)
    rows.iloc[100:].to_parquet(part.with_name("a.parquet"))
    rows.iloc[:100].to_parquet(part.with_name("b.parquet"))
    part.unlink()


@pytest.mark.parametrize(
    ("manifest", "message"),
    [
        (None, "manifest.json: not found"),
        ("{", "manifest.json: not readable as a manifest"),
        ('{"name": "x", "format": 3}', "seed: Field required"),
    ],
)
def test_a_manifest_that_cannot_be_read_is_one_clear_line(builder, manifest, message):
    """Commands read it first, and refuse it themselves."""
    _three_trials(builder)
    file = builder.write() / "manifest.json"
    file.unlink() if manifest is None else file.write_text(manifest)
    with pytest.raises(BoresightError, match=message) as caught:
        read_run(file.parent)
    assert "\n" not in str(caught.value)

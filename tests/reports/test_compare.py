"""Comparisons of stored runs: hand-made failures, scipy's tests and bootstrap, and what may not be compared."""

import re

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom, binomtest, bootstrap, mannwhitneyu, t
from stored_runs import SCENARIO, RunBuilder, pose_error
from terminal_text import printed_lines

from boresight.reports.compare import compare_runs
from boresight.reports.compare.subjects import holm, independent_contrast
from boresight.reports.compare.tables import contrast_tables, limits, subject_tables
from boresight.reports.compare.trials import trial_numbers
from boresight.reports.pages.comparison import facts, write_comparison
from boresight.reports.run.data import read_run
from boresight.reports.statistics.measured import MEDIAN, P75, P99, RMS
from boresight.scenarios.errors import BoresightError

PRIOR = ((40.0, 0.0, 0.0), 1.0)


def posed(vector, attitude_deg=0.5):
    return (tuple(float(x) for x in np.broadcast_to(vector, 3) * (1.0, 0.0, 0.0)), attitude_deg)


def store(folder, errors, **manifest):
    """Store a run of estimators by the lengths of their position errors, None for a failure."""
    builder = RunBuilder(folder)
    for label, lengths in errors.items():
        for trial, length in enumerate(lengths):
            builder.trial(trial, PRIOR, None if length is None else posed(length), estimator=label)
    builder.add("diagnostics", scenario=SCENARIO, estimator=label, trial=0, name="chi2", value=1.0)
    return builder.write(**{"estimators": list(errors)} | manifest)


def only(found, name):
    return next(subject for subject in found.subjects if subject.estimator == name)


def statistic(subject, which, counted=False):
    statistics = (MEDIAN, RMS, P75)
    return (subject.counted if counted else subject.solved)[statistics.index(which)]


def test_failures_count_with_the_error_of_their_prior(tmp_path):
    found = compare_runs([store(tmp_path / "run", {"one": [10, 20, None, 30], "other": [5, 5, 5, 50]})])
    one = only(found, "one")
    assert (one.n_ok, one.n, one.at_prior) == (3, 4, True)
    assert statistic(one, MEDIAN).value == 20.0
    assert statistic(one, MEDIAN, counted=True).value == 25.0  # of 10, 20, 30 and the prior's 40
    assert statistic(one, RMS, counted=True).value == pytest.approx(np.sqrt(np.mean(np.square([10, 20, 30, 40]))))
    assert one.success.value == 0.75
    assert only(found, "other").success.value == 0.75, "an error above the prior's is no success"


def test_intervals_are_those_of_scipy_s_bootstrap(tmp_path):
    lengths = np.random.default_rng(5).gamma(2.0, 6.0, 300)
    subject = only(compare_runs([store(tmp_path / "run", {"one": lengths})]), "one")
    theirs = bootstrap((lengths,), lambda x, axis: np.sqrt(np.mean(x**2, axis=axis)), method="percentile", rng=1)
    ours = statistic(subject, RMS)
    assert ours.value == pytest.approx(np.sqrt(np.mean(lengths**2)))
    assert (ours.low, ours.high) == pytest.approx(tuple(theirs.confidence_interval), rel=0.02)
    assert subject.solved[-1].value == pytest.approx(np.quantile(lengths, 0.99)), P99.name


def test_differences_are_paired_and_a_failure_loses(tmp_path):
    one, other = [10, 20, 30, 12, None, 18], [11, 25, None, 10, None, 30]
    (contrast,) = compare_runs([store(tmp_path / "run", {"other": other, "one": one})]).contrasts
    assert (contrast.first[0], contrast.second[0]) == ("one", "other")
    assert (contrast.n_both, contrast.n) == (4, 6)
    assert contrast.median.value == -3.0  # of -1, -5, 2 and -12
    assert contrast.better.value == 0.75
    assert contrast.p == pytest.approx(binomtest(3, 4).pvalue)
    assert contrast.better_of_all.value == 0.8, "the other's failure alone is won, the common one decides nothing"
    assert contrast.failures.value == pytest.approx(-1 / 6)
    assert contrast.failures.low < 0.0 < contrast.failures.high


def test_holm_s_correction_is_that_of_his_procedure():
    """By hand: 0.005 x 4, 0.01 x 3, 0.03 x 2, and 0.04 x 1, which is below the one before."""
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.9, 0.8]) == [1.0, 1.0]


def test_under_the_null_holm_finds_something_in_at_most_five_per_cent():
    chances = np.random.default_rng(8).random((4000, 10))
    found = np.mean([min(holm(row)) < 0.05 for row in chances])
    assert found == pytest.approx(0.05, abs=0.012)
    assert np.mean(chances.min(axis=1) < 0.05) > 0.35, "uncorrected"


def spec(**changes):
    whole = {"name": SCENARIO, "viewpoint": {"range_m": 2000}, "brdf": {"kind": "lambert"}, "lighting": {}}
    return whole | changes


def test_runs_of_other_reflectances_are_pairs_by_it(tmp_path):
    runs = [
        store(tmp_path / kind, {"one": lengths}, scenarios={SCENARIO: spec(brdf={"kind": kind, "w": 1})})
        for kind, lengths in {"lambert": [10, 20, 30], "hapke": [12, 24, 36]}.items()
    ]
    found = compare_runs(runs, factors=["brdf"])
    assert [subject.names for subject in found.subjects] == [("lambert",), ("hapke",)]
    (contrast,) = found.contrasts
    assert (contrast.first, contrast.paired, contrast.median.value) == (("hapke",), True, 4.0)
    assert compare_runs(runs).factors[0] == "run", "the same estimator and scenario twice"


def test_the_prior_is_no_estimator_where_estimators_are_pooled(tmp_path):
    runs = [
        store(tmp_path / kind, {"prior": [0, 0, 0], "one": lengths}, scenarios={SCENARIO: spec(brdf={"kind": kind})})
        for kind, lengths in {"lambert": [10, 20, 30], "hapke": [12, 24, 36]}.items()
    ]
    found = compare_runs(runs, factors=["brdf"])
    assert [(subject.n, subject.solved[0].value) for subject in found.subjects] == [(3, 20.0), (3, 24.0)]
    assert sum("the prior, which is no estimator" in note for _, note in facts(found)) == 1
    assert [one.names for one in compare_runs(runs[:1]).subjects] == [("prior", SCENARIO), ("one", SCENARIO)]
    alone = store(tmp_path / "alone", {"prior": [5, 6, 7]}, scenarios={SCENARIO: spec(brdf={"kind": "lambert"})})
    (subject,) = compare_runs([alone], factors=["brdf"]).subjects
    assert subject.n == 3
    assert not any("no estimator" in note for _, note in facts(compare_runs([alone], factors=["brdf"])))


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"seed": 8}, "their seeds are 7 and 8"),
        ({"scenarios": {SCENARIO: spec(viewpoint={"range_m": 3000})}}, "viewpoint.range_m is 2000 and 3000"),
    ],
)
def test_trials_that_are_not_the_same_are_no_pairs(tmp_path, changes, why):
    rng = np.random.default_rng(6)
    samples = rng.gamma(2, 9, 60), rng.gamma(2, 5, 60)
    one = store(tmp_path / "one", {"one": samples[0]}, scenarios={SCENARIO: spec()})
    other = store(tmp_path / "other", {"other": samples[1]}, **{"scenarios": {SCENARIO: spec()}} | changes)
    with pytest.raises(BoresightError, match=why):
        compare_runs([one, other])
    (contrast,) = compare_runs([one, other], unpaired=True).contrasts
    assert not contrast.paired
    assert contrast.p == pytest.approx(mannwhitneyu(samples[1], samples[0]).pvalue)
    assert contrast.median.value == pytest.approx(np.median(samples[1]) - np.median(samples[0]))
    assert contrast.median.low < contrast.median.value < contrast.median.high
    assert contrast.better.value == pytest.approx(np.mean(samples[1][:, None] < samples[0]))


def test_subjects_that_differ_in_two_things_are_no_pair(tmp_path):
    runs = [
        store(tmp_path / kind, {"one": [1, 2, 3], "two": [2, 3, 4]}, scenarios={SCENARIO: spec(brdf={"kind": kind})})
        for kind in ("lambert", "hapke")
    ]
    contrasts = compare_runs(runs, factors=["estimator", "brdf"]).contrasts
    assert sorted((*one.first, *one.second) for one in contrasts) == [
        ("one", "hapke", "one", "lambert"), ("two", "hapke", "one", "hapke"),
        ("two", "hapke", "two", "lambert"), ("two", "lambert", "one", "lambert"),
    ]  # fmt: skip


def test_two_runs_of_one_campaign_are_two_lines_with_their_difference(tmp_path):
    first = store(tmp_path / "a" / "run", {"one": [10, 20, 30]})
    again = store(tmp_path / "b" / "run", {"one": [11, 22, 33]})
    (contrast,) = compare_runs([first, again]).contrasts
    assert (contrast.first, contrast.paired) == ((str(again), "one", SCENARIO), True), (
        "of the same name: by their paths"
    )
    assert (contrast.n_both, contrast.median.value) == (3, 2.0)
    other = store(tmp_path / "c" / "other", {"one": [15, 25, 35, None]}, seed=8)
    found = compare_runs([first, other], unpaired=True)
    assert [(one.names[0], one.n_ok, one.n) for one in found.subjects] == [("run", 3, 3), ("other", 3, 4)]
    (contrast,) = found.contrasts
    assert (contrast.paired, contrast.n_both, contrast.n, contrast.median.value) == (False, 3, 3, 5.0)
    pooled = compare_runs([first, other], factors=["estimator", "scenario"], unpaired=True)
    assert [one.n for one in pooled.subjects] == [7], "as asked for"
    labelled = store(tmp_path / "d" / "labelled", {"two": [1, 2, 3]}, seed=8)
    assert compare_runs([first, labelled], unpaired=True).factors == ("estimator", "scenario"), "these tell them apart"


def store_scenarios(folder, specs):
    """Store a run of the estimator ``one`` in several scenarios, three trials each."""
    builder = RunBuilder(folder)
    for name in specs:
        for trial, length in enumerate((10, 20, 30)):
            builder.trial(trial, PRIOR, posed(length), estimator="one")
            builder.tables["rows"][-1]["scenario"] = name
    return builder.write(estimators=["one"], scenarios=specs)


def test_lines_without_a_difference_say_why(tmp_path):
    """Of four scenarios, two pairs of one range have a difference, and four pairs none."""
    specs = {
        f"{kind}-{range_m}": spec(brdf={"kind": kind}, viewpoint={"range_m": range_m})
        for kind in ("lambert", "hapke") for range_m in (2000, 3000)
    }  # fmt: skip
    found = compare_runs([store_scenarios(tmp_path / "run", specs)])
    assert len(found.contrasts) == 2
    views = "viewpoint.range_m differs, so that views, priors or tracks are not the same"
    advice = "--unpaired compares them as independent samples"
    assert dict(limits(found)) == {"Not paired": f"4 of 6 pairs of lines: {views}. {advice}"}
    unpaired = compare_runs([tmp_path / "run"], unpaired=True)
    assert (len(unpaired.contrasts), dict(limits(unpaired))) == (6, {})
    by_range = compare_runs([tmp_path / "run"], factors=["viewpoint.range_m"])
    assert dict(limits(by_range))["Not paired"].startswith(f"1 of 1 pair of lines: {views}")


def test_runs_that_differ_in_a_key_beside_the_factors_say_which(tmp_path):
    changes = {
        "a": {"brdf": {"kind": "lambert", "albedo": 0.3}, "camera": {"fov_deg": 5}},
        "b": {"brdf": {"kind": "hapke", "albedo": None}, "camera": {"fov_deg": 10}},
    }
    runs = [
        store(tmp_path / name, {"one": [1, 2, 3]}, scenarios={SCENARIO: spec(**own)}) for name, own in changes.items()
    ]
    differing = 'brdf.kind is "lambert" and "hapke"; camera.fov_deg is 5 and 10'
    assert dict(limits(compare_runs(runs))) == {"Scenarios differ": differing}
    found = compare_runs(runs, factors=["brdf"])
    assert found.contrasts == ()
    assert "camera.fov_deg differs and is not in --by" in dict(limits(found))["Not paired"]
    assert dict(facts(found))["Scenarios differ"] == differing


def test_scenarios_that_one_run_alone_has_are_named(tmp_path):
    one = store_scenarios(tmp_path / "one", {"s": spec(), "t": spec(camera={"fov_deg": 5})})
    two = store_scenarios(tmp_path / "two", {"s": spec(), "t": spec(camera={"fov_deg": 6}), "u": spec()})
    said = dict(limits(compare_runs([one, two])))["Scenarios differ"]
    assert said == "camera.fov_deg is 5 and 6; not in all runs: u"


def test_lines_that_differ_in_two_factors_are_told_to_choose_one(tmp_path):
    runs = [
        store(tmp_path / label, {label: [1, 2, 3]}, scenarios={SCENARIO: spec(brdf={"kind": kind})})
        for label, kind in {"one": "lambert", "two": "hapke"}.items()
    ]
    found = compare_runs(runs, factors=["estimator", "brdf"])
    assert dict(limits(found))["Not paired"] == (
        "all lines differ in two or more of estimator, brdf: give --by with one of them"
    )


def test_equal_pairs_tests_and_pools_are_counted(tmp_path):
    errors = {"one": [10, 20, 30, 12, None, 18], "two": [11, 20, 31, 14, 16, 30]}
    run = store(tmp_path / "run", errors, scenarios={SCENARIO: spec()})
    found = compare_runs([run])
    (contrast,) = found.contrasts
    assert (contrast.equal, contrast.n_both, contrast.better.value) == (1, 5, 0.0)
    note = contrast_tables(found)[0].note
    assert "Equal pairs, which better % and p leave out: two against one 1 of 5." in note
    assert "Holm: p corrected for 2 tests, 1 of the trials that both solved (p) and 1 of all trials" in note
    p, p_of_all = binomtest(0, 4).pvalue, binomtest(1, 5).pvalue
    assert (contrast.p_holm, contrast.p_of_all_holm) == pytest.approx((2 * p, p_of_all))
    assert "pool" not in subject_tables(found)[0].note
    pooled = compare_runs([run], factors=["brdf"])
    assert subject_tables(pooled)[0].note.endswith("Lines pool the trials of several estimators (one, two).")


def failures(k, n, clusters=None):
    """Trials of a subject of which the first k of n failed; each by itself unless clusters are given."""
    failed = np.arange(n) < k
    values = np.where(failed, np.nan, 1.0)
    return pd.DataFrame({"value": values, "failed": failed, "cluster": np.arange(n) if clusters is None else clusters})


@pytest.mark.parametrize(
    ("one", "other", "low", "high"),
    [
        ((56, 70), (48, 80), 0.0524, 0.3339),
        ((9, 10), (3, 10), 0.1705, 0.8090),
        ((6, 7), (2, 7), 0.0582, 0.8062),
        ((5, 56), (0, 29), -0.0381, 0.1926),
        ((0, 10), (0, 20), -0.1611, 0.2775),
        ((0, 10), (0, 10), -0.2775, 0.2775),
        ((10, 10), (0, 20), 0.6791, 1.0),
        ((10, 10), (0, 10), 0.6075, 1.0),
    ],
)
def test_failure_rates_of_independent_samples_differ_as_newcombe_has_it(one, other, low, high):
    """Method 10 of table II of R. Newcombe, Statistics in Medicine 17, 1998, p. 873."""
    rates = independent_contrast((("a",), ("b",)), failures(*one), failures(*other)).failures
    assert rates.value == pytest.approx(one[0] / one[1] - other[0] / other[1])
    assert (rates.low, rates.high) == pytest.approx((low, high), abs=5e-5)


def test_the_difference_of_failure_rates_holds_the_truth():
    """At 2 % and 5 % of 40 trials, over all outcomes; intervals of means held it in 84.8 % of cases."""
    ends = {
        (i, j): independent_contrast((("a",), ("b",)), failures(i, 40), failures(j, 40)).failures
        for i in range(7) for j in range(11)
    }  # fmt: skip
    weights = {(i, j): binom.pmf(i, 40, 0.02) * binom.pmf(j, 40, 0.05) for i, j in ends}
    held = sum(weights[key] for key, one in ends.items() if one.low <= 0.02 - 0.05 <= one.high)
    assert sum(weights.values()) > 0.9999
    assert held == pytest.approx(0.987, abs=0.002)


def test_failures_of_few_data_bases_differ_by_the_intervals_of_these():
    """Ten trials with each of five data bases, of which one fails throughout; the other sample never fails."""
    clusters = np.repeat([f"data base {number}" for number in range(5)], 10)
    rates = independent_contrast((("a",), ("b",)), failures(10, 50, clusters), failures(0, 50, clusters)).failures
    alone = independent_contrast((("a",), ("b",)), failures(10, 50), failures(0, 50)).failures
    half = t.ppf(0.975, 4) * np.std([1, 0, 0, 0, 0], ddof=1) / np.sqrt(5)  # 0.555, and the share is 0.2
    most_of_none = 1.96**2 / (50 + 1.96**2)  # Wilson's end of 0 of 50
    assert rates.value == alone.value == 0.2
    assert rates.low == pytest.approx(0.2 - np.hypot(0.2, most_of_none), abs=1e-5)
    assert rates.high == pytest.approx(0.2 + half)
    assert rates.low < alone.low < alone.high < rates.high


def test_an_unknown_metric_or_factor_is_told_with_what_there_is(tmp_path):
    run = store(tmp_path / "run", {"one": [1, 2]}, scenarios={SCENARIO: spec()})
    with pytest.raises(BoresightError, match=r"--metric velocity: .* choose one of position_error_m.*chi2"):
        compare_runs([run], metric="velocity")
    with pytest.raises(BoresightError, match=r"--by brdf\.w: .* no such key: .*viewpoint, brdf, lighting"):
        compare_runs([run], factors=["brdf.w"])


def test_components_are_across_and_along_the_boresight(tmp_path):
    builder = RunBuilder(tmp_path / "run")
    builder.trial(0, ((3.0, 4.0, 12.0), 1.0), ((-3.0, 4.0, -2.0), 0.1), estimator="one")
    run = builder.write(estimators=["one"])
    for metric, value in (("lateral_error_m", 5.0), ("boresight_error_m", 2.0)):
        assert statistic(only(compare_runs([run], metric), "one"), MEDIAN).value == pytest.approx(value)


def test_the_error_of_the_line_of_sight_is_that_of_the_direction_to_the_body_in_camera_axes(tmp_path):
    """A body 30 m aside at 10 km is missed by 30 m, whatever the estimate's range and attitude are."""
    builder = RunBuilder(tmp_path / "run")
    poses = [(0.0, 30.0, 10_000.0), (45.0, 0.0, 15_000.0), (0.0, 0.0, 9000.0)]
    for trial, found in enumerate(poses):
        builder.trial(trial, ((3.0, 4.0, 12.0), 1.0), ((500.0, 0.0, -2.0), 3.0), estimator="one")
        row = builder.tables["rows"][-1]
        row |= dict(zip(("tx_m", "ty_m", "tz_m"), found, strict=True))
        row |= {"true_tx_m": 0.0, "true_ty_m": 0.0, "true_tz_m": 10_000.0}
    values = trial_numbers(read_run(builder.write(estimators=["one"])))["sight_error_m"]
    np.testing.assert_allclose(values[-3:], [30.0, 30.0, 0.0], rtol=1e-5)


def test_a_comparison_of_the_line_of_sight_counts_as_failures_what_is_worse_there(tmp_path):
    """Position errors of 60 m are above the prior's 40 m, by the attitude that the method keeps."""
    builder = RunBuilder(tmp_path / "run")
    for label, off_m in (("prior", (30.0, 30.0)), ("one", (3.0, 31.0))):
        for trial, aside_m in enumerate(off_m):
            builder.trial(trial, PRIOR, PRIOR if label == "prior" else posed(60), estimator=label)
            pose = {"tx_m": aside_m, "ty_m": 0.0, "tz_m": 1e4, "true_tx_m": 0.0, "true_ty_m": 0.0, "true_tz_m": 1e4}
            builder.tables["rows"][-1] |= pose
    run = builder.write(estimators=["prior", "one"])
    assert only(compare_runs([run]), "one").success.value == 0.0
    found = only(compare_runs([run], "sight_error_m"), "one")
    assert (found.success.value, found.prior) == (0.5, pytest.approx(30.0, rel=1e-4))


def store_orbits(folder, ends):
    """Store sequences of two revolutions by their position errors at 0, 360 and 720 degrees; shorter ones failed."""
    builder = RunBuilder(folder)
    nothing = {f"{prefix}{name}": np.nan for prefix in ("", "prior_") for name in pose_error(np.zeros(3), 0)}
    for label, trials in ends.items():
        for trial, errors in enumerate(trials):
            key = {"trial": trial, "scenario": SCENARIO, "estimator": label}
            status = "ok" if len(errors) == 3 else "failed"
            builder.add("rows", **key, **nothing, status=status, reason="", image="", n_landmarks=9)
            for k, error in enumerate(errors):
                builder.add(
                    "epochs", **key, frame=k, anomaly_deg=360.0 * k, position_error_m=float(error),
                    landmark_rmse_m=1.0, settled_landmark_rmse_m=1.0,
                )  # fmt: skip
    return builder.write(estimators=list(ends), scenarios={SCENARIO: {"sequence": {"seed": 1}}})


def test_sequences_are_compared_after_whole_revolutions(tmp_path):
    ends = {"ekf": [(0, 3, 9), (0, 5, 7), (0, 4)], "ba": [(0, 2, 4), (0, 2, 5), (0, 2, 6)]}
    run = store_orbits(tmp_path / "run", ends)
    found = compare_runs([run])
    assert found.metric.name == "error_after_2_m"
    ekf = only(found, "ekf")
    assert (ekf.n_ok, ekf.n, ekf.at_prior) == (2, 3, False)
    assert statistic(ekf, MEDIAN).value == 8.0
    assert statistic(ekf, MEDIAN, counted=True).value == 9.0, "the third of three, one of which is worse than any"
    assert statistic(ekf, P75, counted=True).value is None, "of three trials less than one is expected beyond it"
    assert statistic(ekf, RMS, counted=True).value is None
    after_one = compare_runs([run], "error_after_1_m")
    assert statistic(only(after_one, "ekf"), MEDIAN).value == 4.0


def test_the_files_hold_every_number(tmp_path):
    run = store(tmp_path / "run", {"one": [10, 20, None, 30], "other": [5, 6, 7, 8]})
    page, _ = write_comparison(compare_runs([run]), tmp_path / "out", "boresight compare run")
    text = page.with_suffix(".md").read_text()
    assert "failures at prior" in text
    captions = re.findall(r"^!\[.*\]\(.*\)\n\n(.*)$", text, re.M)
    assert len(captions) > 1
    assert all(caption.endswith("Solved trials: one 3/4; other 4/4.") for caption in captions)
    assert "boresight compare run" in text
    subjects = (tmp_path / "out" / "subjects.csv").read_text().splitlines()
    assert len(subjects) == 1 + (1 + 5 + 5) + (1 + 5)
    first = {path.name: path.read_bytes() for path in page.parent.iterdir()}
    tables, pages = {"subjects.csv", "differences.csv", "consistency.csv"}, {"compare.md", "compare.png", "compare.pdf"}
    assert tables | pages < first.keys()
    assert all(len(content) > 1000 for name, content in first.items() if name.endswith((".png", ".pdf")))
    again, _ = write_comparison(compare_runs([run]), tmp_path / "again", "boresight compare run")
    assert {path.name: path.read_bytes() for path in again.parent.iterdir()} == first


def test_in_80_columns_names_stay_whole_and_no_column_is_lost(tmp_path):
    errors = {"landmark-registration": [10, 20, None, 30], "landmark-ransac": [5, 6, 7, 8]}
    found = compare_runs([store(tmp_path / "run", errors)])
    grids = [tabulate(found)[0] for tabulate in (subject_tables, contrast_tables)]
    lines = printed_lines(grids)
    assert max(map(len, lines)) <= 80
    narrow = " ".join(" ".join(lines).split())
    for grid in grids:
        for column, *cells in zip(grid.columns, *grid.rows, strict=True):
            assert column in narrow
            assert [cell for cell in cells if cell in errors and cell not in narrow] == []
    rows = [line.split()[0] for line in lines if line.startswith("landmark-")]
    assert set(rows) == set(errors)
    assert len(rows) > sum(len(grid.rows) for grid in grids), "each part of a wide table begins with the names"


@pytest.mark.parametrize(("several", "pairs"), [(8, 28), (12, 11)])
def test_many_estimators_are_each_compared_with_the_first_alone(tmp_path, monkeypatch, several, pairs):
    monkeypatch.setattr("boresight.reports.compare.subjects.MOST_PAIRS", 28)
    errors = {"prior": [40, 40, 40], **{f"m{k}": [10 + k, 20 - k, 30] for k in range(several)}}
    found = compare_runs([store(tmp_path / "run", errors)])
    assert len(found.contrasts) == pairs
    said = "of lines that differ in one factor each is compared with the first alone."
    grid, numbers = contrast_tables(found)
    if several > 8:
        assert {one.second for one in found.contrasts} == {("m0", SCENARIO)}
        assert len(numbers) == pairs
    assert (said in grid.note) == (several > 8)

"""Reports of orbit determination: statistics by hand, failures counted, figures drawn."""

import numpy as np
import pytest
from scipy.stats import chi2
from stored_runs import SCENARIO, RunBuilder, find, pose_error
from terminal_text import terminal_lines

from boresight.reports.kinds import report_grids
from boresight.reports.kinds.orbit_determination import ORBIT
from boresight.reports.pages.build import write_report
from boresight.reports.pages.content import read_content
from boresight.reports.schema.grid import of_ended
from boresight.reports.statistics.consistency import AT_EPOCH, BAND, CONSISTENCY, INSIDE
from boresight.reports.statistics.measured import RMS, measure

ERRORS = (1.0, 2.0, 3.0, 10.0)


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    return write_report(_stored(tmp_path_factory.mktemp("run")))


def _stored(folder, *, draws=None, errors=ERRORS, trials=5):
    """Store a run; ``draws``: of the craters, trial by trial in turn."""
    run = RunBuilder(folder)
    nothing = dict.fromkeys(pose_error(np.zeros(3), 0.0), np.nan)
    for trial in range(trials):
        key = {"trial": trial, "scenario": SCENARIO, "estimator": "batch-filter"}
        good = trial < len(errors)
        prior = {f"prior_{name}": value for name, value in nothing.items()}
        status, reason = ("ok", "") if good else ("failed", "rejected: too large")
        run.add("rows", **key, status=status, reason=reason, image="", n_landmarks=9, **prior, **nothing,
                database=np.nan if draws is None else trial % draws)  # fmt: skip
        if not good:
            continue
        error = errors[trial]
        names = ("epoch_error_m", "arc_median_m", "arc_rms_m", "predicted_error_m")
        shares = ("residual_rms_px", "wrong_left_share", "right_edited_share", "gm_error", "solar_pressure_error")
        numbers = dict.fromkeys(names, error) | dict.fromkeys(("epoch_nees", "arc_nees"), 1.0)
        run.add("orbits", **key, **numbers, **dict.fromkeys(shares, 0.01))
        for day in range(4):
            at = {"time_days": float(day), "predicted": day == 3}
            run.add("orbit_errors", **key, **at, position_error_m=error, position_sigma_m=2.0)
        run.add("residuals", **key, time_days=0.5, u_px=0.1, v_px=-0.2, used=True)
    scenario = {"name": SCENARIO, "orbit": {"sightings": {"craters": 1600}, "knowledge": {"shape_degree": 34}}}
    return run.write(name="orbits", scenarios={SCENARIO: scenario})


@pytest.mark.parametrize("draws", [None, 5])
def test_intervals_are_over_the_draws_of_the_craters_and_tables_say_what_there_is_one_of(tmp_path, draws):
    """Trials of one draw that agree exactly count once: the interval is that of one trial for each draw."""
    errors = np.array([1.0, 2.0, 3.0, 5.0, 8.0] * 3)
    content = read_content(_stored(tmp_path, draws=draws, errors=errors, trials=15))
    key = {"scenario": SCENARIO, "estimator": "batch-filter", "stage": ORBIT}
    found = find(content.records, **key, measure="arc_rms_m", statistic=RMS.name)
    of_draws, of_trials = (measure(errors[:n], np.arange(n).astype(str), (RMS,))[0] for n in (5, 15))
    assert (of_draws.high - of_draws.low) / (of_trials.high - of_trials.low) > 1.5
    wanted = of_trials if draws is None else of_draws
    assert (found.value, found.low, found.high) == pytest.approx((wanted.value, wanted.low, wanted.high))
    once = "one a priori shape" if draws else "one world of craters and one a priori shape"
    assert any(grid.title == f"Orbit determination, of {once}" for grid in report_grids(content))
    assert any("were drawn 5 times" in note for note in content.notes) is (draws == 5)


def test_medians_and_percentiles_are_over_the_trials_that_converged(report):
    def value(measure, statistic):
        key = {"scenario": SCENARIO, "estimator": "batch-filter", "stage": ORBIT}
        return find(report.content.records, **key, measure=measure, statistic=statistic)

    assert value("arc_rms_m", "median").value == pytest.approx(2.5)
    assert value("arc_rms_m", "RMS").value == pytest.approx(np.sqrt(np.mean(np.square(ERRORS))))
    assert value("arc_rms_m", "90th percentile").value is None, "there is none of four"
    assert value("epoch_nees", "mean").value == pytest.approx(1.0)
    assert (value("arc_rms_m", "median").n_ok, value("arc_rms_m", "median").n) == (4, 5)


def test_the_covariance_is_held_against_the_errors_at_the_epoch(report):
    """Four weighed squares of 6, all of them the expected mean of chi-square with 6 degrees of freedom."""
    key = {"scenario": SCENARIO, "estimator": "batch-filter", "stage": CONSISTENCY, "measure": AT_EPOCH}
    mean, band, inside = (find(report.content.records, **key, statistic=name) for name in ("mean", BAND, INSIDE))
    assert (mean.value, mean.n_ok, mean.n) == (6.0, 4, 5)
    ends = chi2.ppf((0.025, 0.975), 4 * 6) / 4
    assert (band.value, band.low, band.high) == pytest.approx((6.0, *ends), rel=1e-6)
    assert inside.value == 1.0
    assert "NEES of the orbit at its epoch" in report.markdown.read_text()


def test_the_terminal_counts_what_converged_and_shows_the_error_over_the_arc(report):
    (line,) = (line for line in terminal_lines(report.content) if "batch-filter" in line)
    assert line.split()[:3] == ["batch-filter", "4/5", "2.50"]


def test_the_page_counts_what_did_not_converge_and_shows_the_figures(report):
    text = report.markdown.read_text()
    assert "| 4/5 |" in text
    assert "rejected: too large" in text
    stems = {path.stem for path in report.figures}
    assert any(stem.startswith("residuals_") for stem in stems)
    assert any(stem.startswith("orbit_errors_") for stem in stems)


def test_errors_say_in_their_cell_that_they_are_of_the_runs_that_ended(report):
    """Four of five converged: in the page, in Markdown and in a terminal, at every error."""
    cell = "of the 4 that ended"
    (line,) = [line for line in report.markdown.read_text().splitlines() if line.startswith(f"| {SCENARIO} | batch")][
        :1
    ]
    cells = [one.strip() for one in line.split("|")]
    errors = [one for one in cells[4:-1] if one != "-"]
    assert errors
    assert all(one.endswith(cell) for one in errors)
    assert cell in report.html.read_text()
    assert cell in " ".join(" ".join(terminal_lines(report.content)).split())


def test_errors_of_runs_that_all_ended_say_nothing_of_it():
    assert of_ended("4.27 [3.97, 5.06]", 20, 20) == "4.27 [3.97, 5.06]"
    assert of_ended("-", 0, 20) == "-"
    assert of_ended("4.27", 18, 20) == "4.27 of the 18 that ended"

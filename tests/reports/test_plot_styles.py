"""One estimator looks the same in every figure, and two never look alike in one."""

from __future__ import annotations

import itertools
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.campaign.runs.read import CATALOG
from boresight.estimators.registry import (
    crater_detector_names,
    crater_matcher_names,
    estimator_names,
    orbit_estimator_names,
    sequence_estimator_names,
)
from boresight.reports.figures.style import (
    GREY,
    SERIES_COLOURS,
    add_footer,
    mark_decades,
    new_figure,
    plot_styles,
    report_styles,
    scale_ordinate,
)
from boresight.scenarios.load import load_campaign

REGISTERED = sorted(
    {
        *estimator_names(),
        *sequence_estimator_names(),
        *orbit_estimator_names(),
        *crater_detector_names(),
        *crater_matcher_names(),
    }
)


def _assert_distinct(labels, found):
    """Fail if two labels have one colour before the palette is used up, or one colour and line style at all."""
    assert list(found) == list(labels)
    pairs = Counter((style.colour, style.line) for style in found.values())
    assert max(pairs.values()) == 1, pairs
    assert len({style.colour for style in found.values()}) >= min(len(found), len(SERIES_COLOURS))
    assert len({style.marker for style in found.values()}) == len(found)


def test_the_methods_of_a_comparison_differ():
    labels = [entry.label for entry in load_campaign("compare-mismatched", CATALOG).spec.estimators]
    assert len(labels) == 8
    _assert_distinct(labels, plot_styles(labels))


@given(st.lists(st.sampled_from(REGISTERED), min_size=1, max_size=12, unique=True))
def test_any_twelve_methods_differ(labels):
    _assert_distinct(labels, plot_styles(labels))


@pytest.mark.parametrize(
    "labels",
    [
        ["ba-slam", "ba-slam-3", "ba-slam-5", "ba-slam-10"],
        [f"method {i}" for i in range(12)],
        ["prior", "landmark-harris", "mine", "yours", "landmark-harris-10"],
    ],
)
def test_variants_and_methods_of_others_differ(labels):
    _assert_distinct(labels, plot_styles(labels))


def test_a_method_has_one_style_in_all_figures_of_a_report():
    every = ["dead-reckoning", "ba-slam-3", "ba-slam-5", "mine", "ekf-slam", "yours"]
    with report_styles(every):
        whole = plot_styles(every)
        for kept in itertools.combinations(every, 3):
            assert plot_styles(kept) == {label: whole[label] for label in kept}
    assert plot_styles(["ba-slam-5"])["ba-slam-5"].colour == plot_styles(["ba-slam"])["ba-slam"].colour


@pytest.mark.parametrize(
    ("label", "method"),
    [("ba-slam-5", "ba-slam"), ("fixed-lag-noisy", "fixed-lag"), ("batch-filter-tight", "batch-filter")],
)
def test_a_variant_alone_has_the_colour_of_its_method(label, method):
    assert plot_styles([label])[label].colour == plot_styles([method])[method].colour


def test_controls_are_grey_and_nothing_else_is():
    for name in REGISTERED:
        assert (plot_styles([name])[name].colour == GREY) == (name in ("prior", "dead-reckoning"))


def test_a_footer_tells_the_run_and_moves_nothing_else():
    figure, (axes,) = new_figure(1)
    axes.plot([0.0, 1.0], [0.0, 1.0], label="a line")
    figure.legend(loc="outside lower center")
    figure.draw_without_rendering()
    (before, height) = (axes.get_position().bounds, figure.get_figheight())
    add_footer(figure, ["boresight x, seed 7", "boresight y, seed 8, p_q"])
    grown = figure.get_figheight()
    assert grown > height
    left, bottom, width, tall = axes.get_position().bounds
    assert (left, width) == pytest.approx((before[0], before[2]))
    assert (grown * tall, grown * (1.0 - bottom)) == pytest.approx((height * before[3], height * (1.0 - before[1])))
    figure.draw_without_rendering()
    footer = next(text for text in figure.texts if "seed 7" in text.get_text()).get_window_extent()
    assert footer.y0 > 0, "descenders are not cut off"
    assert not footer.overlaps(figure.legends[0].get_window_extent())
    assert not footer.overlaps(axes.get_tightbbox())


@pytest.mark.parametrize(("last", "scale", "said"), [(30.0, "linear", []), (1e17, "log", ["up to 1e+17"])])
def test_what_runs_away_leaves_the_frame_and_is_told(last, scale, said):
    _, (axes,) = new_figure(1)
    axes.plot([0, 1, 2], [1.0, 2.0, last])
    scale_ordinate(axes, [2.0])
    assert axes.get_yscale() == scale
    assert axes.get_ylim()[1] == pytest.approx(2000.0 if said else 31.5, rel=0.02)
    assert [text.get_text() for text in axes.texts] == said


@pytest.mark.parametrize(
    ("limits", "printed"),
    [((9.0, 400.0), ["10", "20", "50", "100", "200"]), ((0.5, 5e4), ["1", "10", "100", "1000", "10000"])],
)
def test_logarithmic_axes_have_plain_numbers(limits, printed):
    _, (axes,) = new_figure(1)
    axes.set(yscale="log", ylim=limits)
    mark_decades(axes.yaxis)
    ticks = [tick for tick in axes.get_yticks() if limits[0] <= tick <= limits[1]]
    assert [axes.yaxis.get_major_formatter()(tick) for tick in ticks] == printed
    assert {axes.yaxis.get_minor_formatter()(tick) for tick in axes.yaxis.get_minorticklocs()} <= {""}

"""One estimator looks the same in every figure, and two never look alike in one."""

from __future__ import annotations

import itertools

import pytest

from reports.figures.axes import mark_decades, scale_ordinate
from reports.figures.style import GREY, SERIES_COLOURS, add_footer, colour_of, new_figure, plot_styles


@pytest.mark.parametrize("others", [(), ("ekf-slam", "batch"), ("my-own", "fixed-lag", "prior")])
def test_the_colour_does_not_depend_on_what_else_is_shown(others):
    assert plot_styles([*others, "ba-slam"])["ba-slam"].colour == colour_of("ba-slam")


@pytest.mark.parametrize(("label", "method"), [("ba-slam-5", "ba-slam"), ("fixed-lag-noisy", "fixed-lag")])
def test_a_variant_has_the_colour_of_its_method(label, method):
    assert colour_of(label) == colour_of(method)


def test_the_longest_name_counts():
    assert colour_of("batch-filter-tight") == colour_of("batch-filter") != colour_of("batch")


@pytest.mark.parametrize("label", ["prior", "dead-reckoning"])
def test_controls_are_grey_and_nothing_else_is(label):
    assert colour_of(label) == GREY
    assert colour_of("somebody's method") in SERIES_COLOURS


def test_no_two_of_a_figure_look_alike():
    labels = ["prior", "ba-slam", "ba-slam-3", "ba-slam-5", "landmark-harris", "fixed-lag", "lmaps", "mine", "yours"]
    found = plot_styles(labels)
    assert list(found) == labels
    for one, other in itertools.combinations(found.values(), 2):
        assert one.colour != other.colour or one.line != other.line
        assert one.marker != other.marker


@pytest.mark.parametrize(
    "family",
    [
        ("prior", "landmark-harris", "whole-image", "landmark-ransac", "photometric", "lmaps", "landmark-sift"),
        ("dead-reckoning", "ba-slam", "ekf-slam", "fixed-lag", "batch", "consistent-ekf-slam", "iterated-ekf-slam"),
        ("correlation", "context", "invariants", "hybrid", "vote"),
        ("crater-classic", "crater-learned"),
    ],
)
def test_methods_that_stand_together_differ_in_colour(family):
    assert len({colour_of(name) for name in family}) == len(family)


def test_a_footer_tells_the_run_and_moves_nothing_else():
    figure, (axes,) = new_figure(1)
    axes.plot([0.0, 1.0], [0.0, 1.0], label="a line")
    figure.legend(loc="outside lower center")
    figure.draw_without_rendering()
    (before, height) = (axes.get_position().bounds, figure.get_figheight())
    add_footer(figure, ["boresight x, seed 7", "boresight y, seed 8"])
    grown = figure.get_figheight()
    assert grown > height
    left, bottom, width, tall = axes.get_position().bounds
    assert (left, width) == pytest.approx((before[0], before[2]))
    assert (grown * tall, grown * (1.0 - bottom)) == pytest.approx((height * before[3], height * (1.0 - before[1])))
    figure.draw_without_rendering()
    footer = next(text for text in figure.texts if "seed 7" in text.get_text()).get_window_extent()
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

import matplotlib
import numpy as np
import pandas as pd
import pytest
from matplotlib.collections import EllipseCollection, LineCollection
from PIL import Image
from scipy import stats

from boresight.reports.figures.pose import (
    ClusterView,
    SurfaceView,
    cluster_colours,
    draw_centroid_offsets,
    draw_clusters,
    draw_count_comparison,
    draw_cumulative_errors,
    draw_landmark_counts,
    draw_landmark_errors,
    draw_method_errors,
    draw_pose_errors,
    draw_triangulation,
    one_sigma_ellipse,
)
from boresight.reports.figures.recognition import (
    MATCH_SIGMAS,
    FitPanels,
    Overlay,
    PoseRendering,
    draw_fit_panels,
    draw_pose_renderings,
)
from boresight.reports.figures.style import render, save_figure, shared_edges

CREDIT = "ESA/Rosetta/NAVCAM, CC BY-SA IGO 3.0"


def _errors(scale, n=200, seed=0):
    rng = np.random.default_rng(seed)
    return pd.DataFrame(
        {"attitude_error_deg": rng.exponential(size=n), "position_error_m": scale * rng.exponential(size=n)}
    )


def _fit():
    rng = np.random.default_rng(3)
    points = rng.uniform(60, 180, size=(30, 2))
    edges = points[rng.integers(0, 30, size=(40, 2))]
    scales = rng.uniform(0.2, 1.0, size=(30, 2, 2))
    covariances = scales @ scales.transpose(0, 2, 1) + 0.1 * np.eye(2)
    image = np.zeros((200, 240), np.float32)
    image[50:150, 60:190] = np.linspace(0.2, 1.0, 130)
    return FitPanels(
        image=image,
        mesh_image=0.5 * image,
        before=Overlay(points, covariances, edges),
        after=Overlay(points + 3, None, edges + 3),
        observed_centroid_px=np.array([120.0, 100.0]),
        rendered_centroid_px=np.array([110.0, 95.0]),
        corners_px=points + 3.5,
        matched=np.arange(30) % 2 == 0,
    )


def _clusters():
    rng = np.random.default_rng(5)
    points, numbers = rng.uniform(20, 180, size=(60, 2)), np.arange(60) // 6
    image = np.zeros((200, 200))
    image[15:185, 15:185] = 0.5
    return ClusterView(points, numbers, points[:30], numbers[:30], image)


def _surface():
    corners = np.array([[10.0, 10.0], [90.0, 12.0], [50.0, 80.0], [95.0, 85.0]])
    facets = corners[[[0, 2, 1], [1, 2, 3]]]
    centres = facets.mean(axis=1)
    return SurfaceView(
        landmarks_px=corners,
        edges_px=corners[[[0, 1], [1, 2], [2, 0], [1, 3], [2, 3]]],
        facets_px=facets,
        shades=np.array([0.2, 0.9]),
        normals_px=np.stack([centres, centres + np.array([3.0, -4.0])], axis=1),
        n_tetrahedra=1,
        n_facets=4,
    )


FIGURES = {
    "pose": lambda: draw_pose_errors(
        {"prior": _errors(40), "after recognition": _errors(20, 150, 1)}, "T", {}, [CREDIT]
    ),
    "cumulative of many": lambda: draw_cumulative_errors(
        {f"a rather long label {i}": (_errors(i), 200) for i in range(20)}, "T", [CREDIT]
    ),
    "cumulative": lambda: draw_cumulative_errors({"prior": (_errors(40), 200), "a": (_errors(20), 250)}, "T", [CREDIT]),
    "methods": lambda: draw_method_errors(
        {"A": {"a": _errors(40), "b": _errors(20)}, "B": {"a": _errors(40)}}, "T", [CREDIT]
    ),
    "landmarks": lambda: draw_landmark_errors(np.arange(1.0, 99.0), np.arange(1.0, 99.0), "T", [CREDIT]),
    "counts": lambda: draw_landmark_counts(np.arange(30.0, 80.0), "T", 59.0, [CREDIT]),
    "clusters": lambda: draw_clusters(_clusters(), "T"),
    "triangulation": lambda: draw_triangulation(_surface(), "T"),
    "count comparison": lambda: draw_count_comparison(
        {"a": np.arange(30.0, 80.0), "b": np.arange(20.0, 60.0)}, {"a": 59.0}, "T", [CREDIT]
    ),
    "alignment": lambda: draw_fit_panels(_fit(), "T", [CREDIT], aligned=True),
    "fit": lambda: draw_fit_panels(_fit(), "T", [CREDIT]),
}


def some_long(*names):
    """Return the names of all figures, some marked as long."""
    return [pytest.param(name, marks=pytest.mark.long) if name in names else name for name in FIGURES]


@pytest.mark.parametrize("name", some_long("cumulative of many"))
def test_pictures_are_drawn_and_the_same_each_time(name, tmp_path):
    (png,) = save_figure(FIGURES[name](), tmp_path / "figure", ("png",))
    pixels = np.asarray(Image.open(png).convert("RGB"), dtype=np.int64)
    assert min(pixels.shape[:2]) > 250
    assert len(np.unique(pixels @ [65536, 256, 1])) > 50
    assert np.mean(np.any(pixels != 255, axis=2)) > 0.01
    assert render(FIGURES[name](), "png") == png.read_bytes()


@pytest.mark.parametrize("name", some_long(*FIGURES.keys() - {"pose", "clusters", "triangulation"}))
def test_vector_files_are_the_same_each_time(name, tmp_path):
    (pdf,) = save_figure(FIGURES[name](), tmp_path / "figure", ("pdf",))
    assert pdf.read_bytes().startswith(b"%PDF")
    assert render(FIGURES[name](), "pdf") == pdf.read_bytes()


# Figures of landmark data bases show renderings alone.
@pytest.mark.parametrize("name", [name for name in FIGURES if name not in ("clusters", "triangulation")])
def test_credit_line_is_printed(name):
    with_credit = FIGURES[name]()
    texts = [text.get_text() for text in with_credit.findobj(matplotlib.text.Text)]
    assert CREDIT in texts


def test_readers_own_settings_change_nothing():
    before = render(FIGURES["pose"](), "png")
    with matplotlib.rc_context({"font.size": 25, "axes.facecolor": "red", "lines.linewidth": 9}):
        assert render(FIGURES["pose"](), "png") == before
        assert matplotlib.rcParams["font.size"] == 25


def test_histograms_are_normalised_per_unit():
    figure = draw_pose_errors({"prior": _errors(40, n=5000), "after": _errors(20, n=5000, seed=2)}, "T")
    for axes in figure.axes:
        for patch in axes.patches:
            values, edges, _ = patch.get_data()
            assert 0.97 < np.sum(values * np.diff(edges)) <= 1.0 + 1e-12
    heights, edges, _ = figure.axes[1].patches[0].get_data()
    expected = np.diff(stats.expon(scale=40).cdf(edges)) / np.diff(edges)
    np.testing.assert_allclose(heights, expected, atol=4 * np.sqrt(expected.max() / 5000 / np.diff(edges)[0]))


def test_stage_that_leaves_the_attitude_alone_is_not_drawn_there():
    prior = _errors(40)
    centroid = prior.assign(position_error_m=prior["position_error_m"] / 2)
    figure = draw_pose_errors({"prior": prior, "centroiding": centroid, "recognition": _errors(10, seed=5)}, "T")
    attitude, position = figure.axes
    assert len(attitude.patches) == 2
    assert len(position.patches) == 3


def test_medians_and_published_values_are_marked_where_they_are():
    errors = {"prior": _errors(40), "after": _errors(20, seed=1)}
    figure = draw_pose_errors(errors, "T", {("after", "position_error_m"): 20.9})
    lines = [line for line in figure.axes[1].lines if line.get_linestyle() == ":"]
    medians = sorted(float(table["position_error_m"].median()) for table in errors.values())
    assert sorted(line.get_xdata()[0] for line in lines) == pytest.approx(medians)
    assert [line.get_xdata()[0] for line in figure.axes[1].lines if line.get_marker() == "^"] == [20.9]


def test_published_median_far_above_ours_is_still_on_the_axis():
    figure = draw_pose_errors({"prior": _errors(1), "after": _errors(1)}, "T", {("prior", "position_error_m"): 45.3})
    render(figure, "png")
    assert figure.axes[1].get_xlim()[1] > 45.3


def test_values_beyond_the_axis_are_told():
    errors = _errors(1)
    errors.loc[0, "position_error_m"] = 1e6
    figure = draw_pose_errors({"prior": errors, "after": _errors(1, seed=1)}, "T")
    limit = figure.axes[1].get_xlim()[1]
    assert limit < 100
    assert f"beyond {limit:g} m" in figure.axes[1].get_xlabel()


def test_a_stage_that_nobody_reached_is_named_with_no_values():
    empty = pd.DataFrame({"attitude_error_deg": [], "position_error_m": []}, dtype=float)
    figure = draw_pose_errors({"prior": _errors(40), "after": empty}, "T")
    labels = [text.get_text() for text in figure.axes[1].get_legend().get_texts()]
    assert "after (n = 0)" in labels


def test_cumulative_curve_ends_at_the_share_that_is_ok():
    figure = draw_cumulative_errors({"a": (_errors(1, n=100), 400)}, "T")
    for axes in figure.axes:
        y = axes.lines[0].get_ydata()
        assert np.all(np.diff(y) >= 0)
        assert np.all(np.diff(axes.lines[0].get_xdata()) >= 0)
        assert 0.24 <= y[-1] <= 0.25


def test_theory_curve_is_chi_square_with_3_degrees_of_freedom():
    figure = draw_landmark_errors(np.ones(5), stats.chi2(3).rvs(4000, random_state=1), "T")
    curve = next(line for line in figure.axes[1].lines if "degrees" in str(line.get_label()))
    x, y = (np.asarray(data) for data in curve.get_data())
    np.testing.assert_allclose(y, np.sqrt(x) * np.exp(-x / 2) / np.sqrt(2 * np.pi), atol=1e-12)
    heights, edges, _ = figure.axes[1].patches[0].get_data()
    expected = np.diff(stats.chi2(3).cdf(edges)) * 4000
    observed = heights * np.diff(edges) * 4000
    statistic = np.sum((observed - expected)[expected > 5] ** 2 / expected[expected > 5])
    assert statistic < stats.chi2((expected > 5).sum()).ppf(0.9999)


@pytest.mark.parametrize("top", [0.003, 0.97, 1.0, 7.3, 99.0, 1234.0])
def test_edges_hold_the_sample_and_end_on_a_round_number(top):
    edges = shared_edges([np.linspace(0, top, 1000)])
    assert edges[0] == 0
    assert 0.989 * top <= edges[-1] <= 2 * top
    assert float(f"{edges[-1]:.2g}") == pytest.approx(edges[-1])


def test_ellipses_are_the_6_sigma_contours_on_the_image():
    """Take the drawn outlines back from the canvas to pixels: each point lies at Mahalanobis distance 6."""
    fit = _fit()
    figure = draw_fit_panels(fit, "T")
    figure.canvas.draw()
    axes = figure.axes[0]
    (ellipses,) = (c for c in axes.collections if isinstance(c, EllipseCollection))
    shape = ellipses.get_paths()[0].vertices
    to_image = axes.transData.inverted()
    origin = ellipses.get_transform().transform([[0.0, 0.0]])
    for i, centre in enumerate(fit.before.landmarks_px):
        outline = matplotlib.transforms.Affine2D(ellipses.get_transforms()[i]).transform(shape)
        on_canvas = ellipses.get_transform().transform(outline) - origin + axes.transData.transform(centre)
        offset = to_image.transform(on_canvas) - centre
        squares = np.einsum("ni,ij,nj->n", offset, np.linalg.inv(fit.before.covariances_px2[i]), offset)
        on_curve = squares > 30  # the path's control points lie outside, its knots on the curve
        assert squares[on_curve].min() == pytest.approx(MATCH_SIGMAS**2, rel=1e-3)


def test_image_edges_and_marks_share_the_pixel_convention():
    """The centre of the first pixel is (0.5, 0.5), u to the right and v down, in all three panels."""
    fit = _fit()
    figure = draw_fit_panels(fit, "T")
    for axes in figure.axes:
        assert axes.images[0].get_extent() == [0, 240, 200, 0]
        assert axes.get_ylim()[0] > axes.get_ylim()[1]
    first, _, third = figure.axes
    (mesh,) = (c for c in first.collections if isinstance(c, LineCollection))
    np.testing.assert_array_equal(np.stack(mesh.get_segments()), fit.before.edges_px)
    free, matched = third.lines
    np.testing.assert_array_equal(np.column_stack(matched.get_data()), fit.corners_px[fit.matched])
    np.testing.assert_array_equal(np.column_stack(free.get_data()), fit.corners_px[~fit.matched])


def test_ellipses_hold_the_share_of_a_gaussian_within_one_sigma():
    """In two dimensions 1 - exp(-1/2) = 39.3 % of a Gaussian; 40,000 points know it to 0.25 % (1 sigma)."""
    rng = np.random.default_rng(12)
    sample = rng.multivariate_normal([1.0, -2.0], [[4.0, 1.5], [1.5, 1.0]], 40_000)
    inside = one_sigma_ellipse(sample).contains_points(sample, radius=0.0).mean()
    assert inside == pytest.approx(1.0 - np.exp(-0.5), abs=0.01)


def test_all_panels_of_centroid_offsets_share_their_axes():
    offsets = {"near": np.array([[0.5, 0.5], [-0.5, 0.1], [0.3, -0.2]]), "far": np.array([[7.2, 0.0], [0.0, 3.0]])}
    figure = draw_centroid_offsets(offsets, "T")
    limits = {(axes.get_xlim(), axes.get_ylim()) for axes in figure.axes}
    assert limits == {((-8.0, 8.0), (8.0, -8.0))}  # v grows downwards, as in the image


def test_panels_of_clusters_show_the_same_part_of_the_image():
    figure = draw_clusters(_clusters(), "T")
    limits = {(axes.get_xlim(), axes.get_ylim()) for axes in figure.axes}
    assert len(limits) == 1
    (left, right), (bottom, top) = limits.pop()
    assert left < 15 < 185 < right
    assert top < 15 < 185 < bottom
    assert [len(axes.collections[0].get_offsets()) for axes in figure.axes[:2]] == [60, 30]


def test_clusters_next_to_each_other_differ_in_colour():
    colours = cluster_colours(np.arange(200))
    assert colours.min() >= 0.0
    assert colours.max() <= 1.0
    np.testing.assert_array_equal(cluster_colours(np.array([3, 3])), colours[[3, 3]])
    assert np.abs(np.diff(colours, axis=0)).max(axis=1).min() > 0.2


def test_counts_of_several_sets_are_shares_and_medians_are_marked():
    figure = draw_count_comparison({"a": np.full(8, 12.0), "b": np.arange(10.0, 20.0)}, {"b": 15.0}, "T")
    (axes,) = figure.axes
    assert max(np.max(patch.get_data()[0]) for patch in axes.patches) == 1.0
    marks = [line.get_xdata()[0] for line in axes.lines if line.get_marker() == "^"]
    assert marks == [15.0]
    dotted = sorted(line.get_xdata()[0] for line in axes.lines if line.get_linestyle() == ":")
    assert dotted == [12.0, 14.5]


def test_a_residual_of_rounding_errors_is_none():
    image, body = np.full((20, 30), 0.4), np.ones((20, 30), dtype=bool)
    noise = 4.66e-17 * np.random.default_rng(1).standard_normal((20, 30))
    poses = [PoseRendering("truth", "truth", body, noise), PoseRendering("prior", "prior", body, noise + 0.01)]
    figure = draw_pose_renderings(image, poses, "T")
    titles = [axes.get_title() for axes in figure.axes if "RMS" in axes.get_title()]
    assert titles == [f"image less rendering: RMS {rms} on the body" for rms in ("0", "0.01")]


def test_images_of_a_small_body_are_stretched_to_what_is_shown():
    rng = np.random.default_rng(1)
    image, body = rng.standard_normal((200, 200)), np.zeros((200, 200), dtype=bool)
    body[90:94, 100:104] = True
    image[body] = 300.0
    residual = np.where(body, 40.0, rng.standard_normal(body.shape))
    figure = draw_pose_renderings(image, [PoseRendering("truth", "truth", body, residual)], "T")
    above, below = (axes.images[0] for axes in figure.axes[:2])
    assert above.get_clim() == (0.0, 300.0)
    assert below.get_clim() == (-40.0, 40.0)


def test_methods_keep_their_colours_and_axes_in_all_rows():
    groups = {"A": {"a": _errors(40), "b": _errors(20)}, "B": {"b": _errors(20), "a": _errors(40)}}
    figure = draw_method_errors(groups, "T")
    first, _, second, _ = figure.axes
    assert first.get_xlim() == second.get_xlim()
    assert first.get_ylim() == second.get_ylim()
    colours = [
        {
            text.get_text().split(":")[0]: line.get_color()
            for text, line in zip(axes.get_legend().get_texts(), axes.get_legend().get_lines(), strict=True)
        }
        for axes in (first, second)
    ]
    assert colours[0] == colours[1]


def test_a_method_that_fails_does_not_flatten_the_others():
    poor = _errors(40).assign(position_error_m=1e5)
    figure = draw_method_errors({"": {"good": _errors(10), "fair": _errors(20), "poor": poor}}, "T")
    position = figure.axes[1]
    assert position.get_xlim()[1] < 1000
    assert any("poor" in text.get_text() and "100 %" in text.get_text() for text in position.get_legend().get_texts())

"""What a pixel amounts to, against the paper's own figures and hand-computed ones."""

import pytest

from boresight.reports.kinds.single_image import derived_records
from boresight.reports.pages.content import read_content
from boresight.reports.run.data import read_run

SCENARIO = "itokawa"


def records(builder, camera, range_m, radius_m=200.0):
    for trial in range(3):
        builder.trial(trial, ((1.0, 0.0, 0.0), 1.0), ((0.5, 0.0, 0.0), 0.5))
        builder.tables["rows"][-1]["range_m"] = range_m + trial - 1
    run = read_run(builder.write(scenarios={SCENARIO: {"camera": camera}}))
    return {r.measure: r for r in derived_records(run, radius_m)}


@pytest.mark.parametrize(
    ("camera", "range_m", "printed"),
    [
        ({"fov_deg": 18.3}, 2000.0, (1.13, 0.324, 11.3)),
        ({"fov_deg": 5.83, "width_px": 1024, "height_px": 1024}, 8000.0, (0.78, 0.223, 31.0)),
    ],
)
def test_the_figures_of_the_paper_follow_from_camera_and_range(builder, camera, range_m, printed):
    """The paper rounds on the way: 1 % covers it."""
    found = records(builder, camera, range_m)
    names = ("pixel_scale_m", "pixel_rotation_deg", "pixel_displacement_m")
    assert [found[name].value for name in names] == pytest.approx(printed, rel=0.01)
    assert [found[name].unit for name in names] == ["m", "deg", "m"]


def test_a_scenario_without_a_camera_derives_nothing(builder):
    assert records(builder, {"fov_deg": -3}, 2000.0) == {}


def test_they_stand_beside_the_published_values(builder):
    records(builder, {"fov_deg": 18.3}, 2000.0)
    builder.write(report="rowell2015-simulated", scenarios={SCENARIO: {"camera": {"fov_deg": 18.3}}})
    compared = {c.published.measure: c for c in read_content(builder.folder).compared}
    assert compared["pixel_scale_m"].verdict == "reproduced"
    assert compared["pixel_displacement_m"].ours.value == pytest.approx(11.325, abs=0.01)

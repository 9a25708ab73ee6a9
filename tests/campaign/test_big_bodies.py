"""Bodies of many facets: how many there will be and their memory are told before they are made, and bounded."""

import pytest
import trimesh

from boresight.campaign.cli import main
from boresight.campaign.imaging.preview import memory_in_words, preview
from boresight.scenarios.bodies import expected_facets, load, load_body
from boresight.scenarios.bodies.readers import read_shape
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import load_scenario
from boresight.scenarios.spec.body import MOST_FACETS, BodySpec

SITE = {"direction": [0.2, 1.0, 0.3], "radius_m": 60.0, "edge_m": 4.0}


def test_what_is_made_is_bounded_and_not_what_is_asked_for():
    """A shape of 49,152 facets: 13 million would be 50 million; a sphere of 5,120 may have 20,971,520."""
    with pytest.raises(BoresightError) as refused:
        load_body(BodySpec(shape="itokawa-like", detail={"facets": 13_000_000}))
    assert str(refused.value) == (
        "detail.facets: 13,000,000 makes 50,331,648 facets of the 49,152 of the shape, each four of one, and 21,000,000"
        " are the most: give 12582912 or less"
    )
    assert expected_facets(BodySpec(shape="sphere", detail={"facets": 13_000_000})) == 20_971_520


def test_a_site_counts_with_the_body():
    """14 million facets of a site beside the 5.2 million of a sphere are few enough, beside 12.6 million too many."""
    fine = {"direction": [1.0, 0.0, 0.0], "radius_m": 100.0, "edge_m": 0.1}
    whole = BodySpec(shape="sphere", detail={"facets": 5_242_880, "site": fine})
    assert expected_facets(whole) == 5_242_880 + 14_000_000 < MOST_FACETS
    spec = BodySpec(shape="itokawa-like", detail={"facets": 7_000_000, "site": fine})
    said = "0.1 m makes about 14,000,000 facets beside the 12,582,912 of the body, .*: give 0.13 or more"
    with pytest.raises(BoresightError, match=f"detail.site.edge_m: {said}"):
        load_body(spec)


@pytest.mark.parametrize("edge_m", [3.0, 4.0])
def test_the_number_with_a_site_is_about_that_which_is_made(edge_m):
    spec = BodySpec(shape="sphere", detail={"facets": 5120, "site": {**SITE, "edge_m": edge_m}})
    added = len(load_body(spec).mesh.faces) - 5120
    assert expected_facets(spec) - 5120 == pytest.approx(added, rel=0.6)


def test_the_number_with_a_local_shape_is_about_that_which_is_made(tmp_path):
    cap = trimesh.creation.icosphere(subdivisions=5, radius=255.0)
    cap.update_faces(cap.triangles_center[:, 1] > 200.0)
    cap.export(tmp_path / "cap.ply")
    spec = BodySpec(shape="sphere", local=[{"shape": "cap.ply", "blend_m": 20.0, "edge_m": 4.0}])
    added = len(load_body(spec, (tmp_path,)).mesh.faces) - 5120
    assert expected_facets(spec, (tmp_path,)) - 5120 == pytest.approx(added, rel=0.6)


def test_large_bodies_are_told_with_their_memory_and_small_ones_are_not():
    """Measured: 1.06 GB for 5.2 million facets in 512 x 512 pixels, and 0.5 GB for a quarter of them."""
    one = load_scenario("quickstart", ("body={shape: sphere, detail: {facets: 5242880}}",))
    assert memory_in_words(one) == [
        "the body has about 5,242,880 facets: each process that makes images takes about 1.1 GB of memory"
    ]
    assert memory_in_words(load_scenario("quickstart", ("body={shape: sphere, detail: {facets: 1310720}}",))) == []
    both = load_scenario("quickstart", ("body={shape: sphere, detail: {facets: 5242880}}", "onboard.facets=1300000"))
    assert "those on board among them, have about 5,242,880 and 1,310,720 facets" in memory_in_words(both)[0]


def test_validate_tells_the_memory_before_it_refuses_a_body(capsys):
    assert main(["validate", "quickstart", "--set", "body={shape: itokawa-like, detail: {facets: 13000000}}"]) == 2
    said = capsys.readouterr()
    assert "the body has about 50,331,648 facets: each process" in " ".join(said.out.split())
    assert "detail.facets: 13,000,000 makes 50,331,648 facets" in said.err


def test_edges_of_the_body_and_of_its_site_are_told_apart():
    body = f"body={{shape: sphere, detail: {{facets: 5120, site: {SITE}}}}}".replace("'", "")
    with_site, without = (
        load_scenario("quickstart", (body,)),
        load_scenario("quickstart", ("body={shape: sphere, detail: {facets: 5120}}",)),
    )
    for detailed in (True, False):
        told = next(line for line in preview(with_site, detailed=detailed) if line.startswith("facets have edges"))
        edges = next(line for line in preview(without, detailed=detailed) if line.startswith("facets have edges"))
        assert told.split(",")[0] == edges.split(",")[0]
        assert ", at the site of 4 m at most, " in told


@pytest.mark.parametrize("detail", ["", ", detail: {facets: 5120}"])
def test_validate_reads_a_shape_once(detail, tmp_path, capsys, monkeypatch):
    """Memory, checks and preview each ask for it."""
    trimesh.creation.icosphere(subdivisions=3, radius=250.0).export(tmp_path / "ball.ply")
    scene = f"""\
body: {{shape: ball.ply, unit: m{detail}}}
camera: {{width_px: 64, height_px: 64, fov_deg: 18}}
viewpoint: {{range_m: 3000}}
lighting: {{phase_deg: 40}}
pose_error: {{position_cam_m: {{normal: [5, 5, 5]}}}}
"""
    (tmp_path / "scene.yaml").write_text(scene)
    (tmp_path / "campaign.yaml").write_text("scenarios: [scene.yaml]\nestimators: [limb]\ntrials: 1\nseed: 1\n")
    read = []

    def reading(path, *how, **more):
        read.append(path)
        return read_shape(path, *how, **more)

    monkeypatch.setattr(load, "read_shape", reading)
    assert main(["validate", str(tmp_path / "campaign.yaml")]) == 0
    assert read == [tmp_path / "ball.ply"]

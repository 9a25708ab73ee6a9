"""The reader of digital shape kernels on files that SPICE writes here, on those of others, and on damaged ones."""

import struct

import numpy as np
import pytest
import spiceypy
import trimesh
from mission_data import data_file, needs_data
from small_kernels import write_dsk

from boresight.campaign.cli import main
from boresight.scenarios.bodies import load_body
from boresight.scenarios.bodies.readers import read_shape
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.spec.body import BodySpec

RECORD = 1024
PHOBOS = "shapes/phobos_lores.bds"


@pytest.fixture
def ball():
    mesh = trimesh.creation.icosphere(subdivisions=3)
    return mesh.vertices * [3.0, 2.0, 1.0], mesh.faces


@pytest.mark.parametrize("options", [{}, {"file_format": "dsk"}])
def test_a_dsk_comes_back_bit_for_bit(tmp_path, ball, options):
    shape = read_shape(write_dsk(tmp_path / "named.otherwise", *ball), **options)
    np.testing.assert_array_equal(shape.vertices, ball[0])
    np.testing.assert_array_equal(shape.faces, ball[1])


@pytest.mark.parametrize("unit", ["m", "km"])
def test_a_body_of_a_dsk_is_in_metres_whatever_unit_is_given(tmp_path, ball, unit):
    write_dsk(tmp_path / "x.bds", *ball)
    mesh = load_body(BodySpec(shape="x.bds", unit=unit), [tmp_path]).mesh
    np.testing.assert_array_equal(mesh.vertices_m, 1e3 * ball[0])
    assert mesh.volume_m3 == pytest.approx(4e9 * np.pi * 2.0, rel=0.02)
    with pytest.raises(
        BoresightError, match=r"body\.unit km the body is 6000 x .* this format has no other unit: check"
    ):
        load_body(BodySpec(shape="x.bds", unit=unit, expected_diameter_m=(1.0, 5.0)), [tmp_path])


def test_a_dsk_in_metres_is_named_where_its_size_shows_it(tmp_path, ball):
    """The unit of the format is the km; the body is 6 km long, and 6,000 km by such a file."""
    write_dsk(tmp_path / "x.bds", 1e3 * ball[0], ball[1])
    with pytest.raises(BoresightError, match=r"6e\+06 x .* no other unit: is the file in m\? write it in km"):
        load_body(BodySpec(shape="x.bds"), [tmp_path])


def patched(content, at, form, value):
    size = struct.calcsize(form)
    return content[:at] + struct.pack(form, value) + content[at + size :]


def of_type_4(content):
    """Change the type in the descriptor of the segment, the first of its doubles."""
    at = content.index(struct.pack("<4d", 1.0, 401.0, 2.0, 2.0))
    return patched(content, at + 24, "<d", 4.0)


BROKEN = {
    "cut in its last record": (lambda c: c[:-1], "announces 100 records, the file has 99; is it cut"),
    "cut to its head": (lambda c: c[:RECORD], "leads to record 2, not in the file; is it cut"),
    "cut in its head": (lambda c: c[:100], "not a DSK file: it must start with DAS/DSK"),
    "empty": (lambda _: b"", "the shape file is empty"),
    "of another program": (lambda _: b"DAF/SPK " + bytes(4096), "not a DSK file: it must start with DAS/DSK"),
    "of an old machine": (lambda c: c.replace(b"LTL-IEEE", b"VAX-GFLT"), "name a byte order"),
    "of type 4": (of_type_4, "of type 4; only type 2, triangular plates, is read"),
    "with a loop of directories": (lambda c: patched(c, RECORD + 4, "<i", 2), "leads to record 2, not in the file"),
    "with a far directory": (lambda c: patched(c, RECORD + 4, "<i", 2**31 - 1), "leads to record 2147483647"),
    "with a cluster of no type": (lambda c: patched(c, RECORD + 32, "<i", 7), "a cluster of type 7"),
    "with fewer words than it needs": (lambda c: patched(c, RECORD + 20, "<i", 99), "leads to words 1 to .* of 99;"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_dsk_is_refused_with_one_clear_line(tmp_path, ball, case):
    damage, message = BROKEN[case]
    path = write_dsk(tmp_path / "x.bds", *ball)
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(BoresightError, match=message) as refused:
        read_shape(path)
    assert "\n" not in str(refused.value)
    assert str(refused.value).startswith(f"{path}: ")


def test_counts_beyond_the_segment_are_refused_before_memory_is_taken(tmp_path, ball):
    path = write_dsk(tmp_path / "x.bds", *ball)
    content = path.read_bytes()
    at = content.index(struct.pack("<2i", len(ball[0]), len(ball[1])))
    path.write_bytes(patched(content, at, "<i", 2**31 - 1))
    with pytest.raises(BoresightError, match="leads to words 35 to 6442450975 of"):
        read_shape(path)


def test_files_of_several_segments_or_none_are_refused(tmp_path, ball):
    path = write_dsk(tmp_path / "x.bds", *ball, segments=2)
    with pytest.raises(BoresightError, match=r"x\.bds: the DSK file has several segments; give a file with one"):
        read_shape(path)
    handle = spiceypy.dskopn(str(tmp_path / "none.bds"), "none", 0)
    spiceypy.dskcls(handle, False)
    with pytest.raises(BoresightError, match=r"none\.bds: the DSK file has no segment"):
        read_shape(tmp_path / "none.bds")


def test_a_scenario_with_a_dsk_is_valid_and_a_cut_one_ends_with_code_2(tmp_path, ball, capsys):
    path = write_dsk(tmp_path / "x.bds", *ball)
    (tmp_path / "scene.yaml").write_text(
        "extends: quickstart\nbody: {shape: x.bds, detail: null, expected_diameter_m: [5900, 6100]}\n"
        "viewpoint: {range_m: 30000}\n",
        encoding="utf-8",
    )
    assert main(["validate", str(tmp_path / "scene.yaml")]) == 0
    path.write_bytes(path.read_bytes()[:-RECORD])
    capsys.readouterr()
    assert main(["validate", str(tmp_path / "scene.yaml")]) == 2
    assert "x.bds: its directory announces" in " ".join(capsys.readouterr().err.split())


def by_spice(path, n_vertices, n_plates):
    """Read vertices, km, and plates, from 1, with SPICE."""
    handle = spiceypy.dasopr(str(path))
    try:
        segment = spiceypy.dlabfs(handle)
        return spiceypy.dskv02(handle, segment, 1, n_vertices), spiceypy.dskp02(handle, segment, 1, n_plates)
    finally:
        spiceypy.dascls(handle)


@needs_data(PHOBOS)
def test_phobos_has_the_plates_and_the_size_of_its_label():
    """840 plates; Phobos is 26.06 x 22.80 x 18.28 km (Willner et al. 2014) in other, finer models: within 6 %."""
    path = data_file(PHOBOS)
    mesh = load_body(BodySpec(shape=str(path), expected_diameter_m=(2e4, 3e4))).mesh
    assert (len(mesh.vertices_m), len(mesh.faces)) == (422, 840)
    np.testing.assert_allclose(np.ptp(mesh.vertices_m, axis=0), [26060.0, 22800.0, 18280.0], rtol=0.06)
    assert mesh.volume_m3 == pytest.approx(5.74e12, rel=0.02)
    vertices_km, plates = by_spice(path, 422, 840)
    np.testing.assert_array_equal(mesh.vertices_m, 1e3 * vertices_km)
    np.testing.assert_array_equal(mesh.faces, plates - 1)


def records_of(path):
    """The 32-bit words of the records: file record, directory, integers, doubles, and integers again."""
    words = np.frombuffer(path.read_bytes(), "<i4").reshape(-1, RECORD // 4).copy()
    assert words[1, 8] == 3
    assert (np.sign(words[1, 9:13]) == [1, -1, 1, 0]).all()
    return words, abs(words[1, 9:12])


def test_a_second_directory_and_comments_are_passed_over(tmp_path, ball):
    path = write_dsk(tmp_path / "x.bds", *ball)
    words, sizes = records_of(path)
    split = 2 + sizes[:2].sum()
    words[1, 1], words[1, 11] = split + 1, 0
    second = np.zeros((1, RECORD // 4), "<i4")
    second[0, 0], second[0, 6], second[0, 7], second[0, 8], second[0, 9] = 2, 257, words[1, 7], 3, sizes[2]
    words[1, 7] = 256
    path.write_bytes(np.vstack([words[:split], second, words[split:]]).tobytes())
    handle = spiceypy.dasopw(str(path))
    spiceypy.dasac(handle, ["a comment " * 30] * 9)
    spiceypy.dascls(handle)
    shape, (vertices_km, plates) = read_shape(path), by_spice(path, *map(len, ball))
    np.testing.assert_array_equal(shape.vertices, vertices_km)
    np.testing.assert_array_equal(shape.faces, plates - 1)
    np.testing.assert_array_equal(shape.vertices, ball[0])


def test_files_of_the_other_byte_order_are_read(tmp_path, ball):
    path = write_dsk(tmp_path / "x.bds", *ball)
    words, sizes = records_of(path)
    turned = words.byteswap()
    doubles = slice(2 + sizes[0], 2 + sizes[:2].sum())
    turned[doubles] = np.ascontiguousarray(words[doubles]).view("<f8").byteswap().view("<i4")
    content = turned.tobytes()
    head = words.tobytes()[:68] + content[68:84] + b"BIG-IEEE"
    path.write_bytes(head + words.tobytes()[92:RECORD] + content[RECORD:])
    shape = read_shape(path)
    np.testing.assert_array_equal(shape.vertices, ball[0])
    np.testing.assert_array_equal(shape.faces, ball[1])

"""Shape readers on small files written here, on trimesh's own exports, and on hostile input."""

import struct

import numpy as np
import pytest
import trimesh

from boresight.scenarios.bodies.readers import read_shape
from boresight.scenarios.bodies.readers.pds import cube_lattice
from boresight.scenarios.errors import BoresightError

TETRAHEDRON = "v 1 0 0\nv 0 1 0\nv 0 0 1\nv -1 -1 -1\n"
FACES = [[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]]
OBJ = TETRAHEDRON + "".join("f {} {} {}\n".format(*(i + 1 for i in face)) for face in FACES)
PLY = (
    "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 4\nproperty list uchar int vertex_indices\nend_header\n"
    + TETRAHEDRON.replace("v ", "")
    + "".join("3 {} {} {}\n".format(*face) for face in FACES)
)


def grid_text(radius=2.0, step=30, latitudes=None):
    latitudes = range(-90, 91, step) if latitudes is None else latitudes
    return "".join(f"{lat} {lon} {radius}\n" for lat in latitudes for lon in range(0, 361, step))


def icq_text(q=4, jitter=0.0):
    directions = cube_lattice(q) / (0.5 * q) - 1.0
    points = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    points = points + jitter * np.random.default_rng(0).standard_normal(points.shape)
    return f"{q}\n" + "".join("{:.9f} {:.9f} {:.9f}\n".format(*point) for point in points)


def counted_text(base=1):
    rows = [line[2:] for line in TETRAHEDRON.splitlines()]
    plates = [" ".join(str(i + base) for i in face) for face in FACES]
    return (
        "\n".join(["4", *(f"{n} {row}" for n, row in enumerate(rows, 1)), "4"])
        + "\n"
        + "\n".join(f"{n} {plate}" for n, plate in enumerate(plates, 1))
    )


def read(tmp_path, name, content, **options):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_shape(path, **options)


def as_trimesh(shape):
    return trimesh.Trimesh(shape.vertices, shape.faces, process=False)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.obj", OBJ),
        ("a.OBJ", OBJ.replace("\n", "\r\n")),
        ("a.obj", OBJ.replace("f 1 2 3", "f -4//1 -3//1 -2//1")),
        ("a.ply", PLY),
        ("named-like-an.obj", PLY),
        ("a.tab", OBJ),
        ("zero-based.tab", TETRAHEDRON + "".join("f {} {} {}\n".format(*face) for face in FACES)),
        ("counted.tab", counted_text()),
    ],
)
def test_the_same_tetrahedron_in_each_format(tmp_path, name, content):
    shape = read(tmp_path, name, content)
    expected = trimesh.Trimesh([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, -1, -1]], FACES, process=False)
    np.testing.assert_array_equal(shape.vertices, expected.vertices)
    np.testing.assert_array_equal(shape.faces, FACES)
    assert as_trimesh(shape).volume == pytest.approx(2.0 / 3.0)  # determinant of the edges, 4, over 6


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("corners", [3, 4])
def test_binary_ply_of_both_byte_orders(tmp_path, order, corners):
    box = trimesh.creation.box((1.0, 2.0, 3.0))
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    corner = np.array([[x, y, z] for x in (0, 1) for y in (0, 2) for z in (0, 3)], dtype=float)
    vertices, faces = (box.vertices, box.faces) if corners == 3 else (corner, quads)
    header = (
        f"ply\nformat binary_{'little' if order == '<' else 'big'}_endian 1.0\nelement vertex 8\n"
        "property double x\nproperty double y\nproperty double z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    ).encode()
    body = struct.pack(f"{order}24d", *np.ravel(vertices))
    body += b"".join(struct.pack(f"{order}B{corners}i", corners, *face) for face in faces.tolist())
    mesh = as_trimesh(read(tmp_path, "box.ply", header + body))
    assert mesh.is_watertight
    assert abs(mesh.volume) == pytest.approx(6.0)
    assert len(mesh.faces) == 12


@pytest.mark.parametrize("suffix", ["obj", "ply"])
def test_round_trip_through_the_writer_of_trimesh(tmp_path, suffix):
    ball = trimesh.creation.icosphere(subdivisions=3)
    ball.vertices *= [3.0, 2.0, 1.0]
    ball.export(tmp_path / f"ball.{suffix}")
    shape = read_shape(tmp_path / f"ball.{suffix}")
    np.testing.assert_allclose(shape.vertices, ball.vertices, atol=1e-6)
    np.testing.assert_array_equal(shape.faces, ball.faces)


def test_polygons_groups_and_line_continuations_of_an_obj(tmp_path):
    corners = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 2) for z in (0, 3))
    faces = "o lower\nf 1 2 4 3\nf 5 7 8 6\nusemtl other\nf 1 5 6 2\nf 3 4 8 7\no upper\nf 1 3 7 5\nf 2 6 \\\n8 4\n"
    shape = read(tmp_path, "box.obj", "mtllib missing.mtl\n# a box\nvn 0 0 1\n" + corners + faces)
    assert len(shape.faces) == 12
    assert trimesh.Trimesh(shape.vertices, shape.faces).volume == pytest.approx(6.0)


@pytest.mark.parametrize("west", [False, True])
def test_grid_of_an_ellipsoid(tmp_path, west):
    lat, lon = np.meshgrid(np.arange(-90, 91, 3), np.arange(0, 361, 3), indexing="ij")
    phi, lam = np.radians(lat), np.radians(-lon if west else lon)
    unit = np.stack([np.cos(phi) * np.cos(lam), np.cos(phi) * np.sin(lam), np.sin(phi)], axis=-1)
    radius = 1.0 / np.linalg.norm((unit - [0.05, 0.1, 0.0]) / [3.0, 2.0, 1.0], axis=-1)
    rows = np.stack([lat, lon, radius], axis=-1).reshape(-1, 3)
    shuffled = np.random.default_rng(1).permutation(rows)
    np.savetxt(tmp_path / "grid.tab", shuffled, fmt="%.9f")
    shape = read_shape(tmp_path / "grid.tab", west_longitudes=west)
    mesh = as_trimesh(shape)
    assert mesh.is_watertight
    assert mesh.volume > 0.0
    assert len(shape.vertices) == 59 * 120 + 2
    directions = shape.vertices / np.linalg.norm(shape.vertices, axis=1, keepdims=True)
    expected = 1.0 / np.linalg.norm((directions - [0.05, 0.1, 0.0]) / [3.0, 2.0, 1.0], axis=1)
    np.testing.assert_allclose(np.linalg.norm(shape.vertices, axis=1), expected, rtol=1e-6)


@pytest.mark.parametrize("q", [1, 4, 16])
def test_icq_closes_into_a_sphere(tmp_path, q):
    mesh = as_trimesh(read(tmp_path, "ball.icq", icq_text(q)))
    assert mesh.is_watertight
    assert len(mesh.vertices) == 6 * q * q + 2
    assert len(mesh.faces) == 12 * q * q
    assert mesh.volume > 0.0
    assert mesh.euler_number == 2


def test_icq_welds_seams_that_do_not_coincide(tmp_path):
    mesh = as_trimesh(read(tmp_path, "ball.tab", icq_text(8, jitter=0.01)))
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(4.0 / 3.0 * np.pi, rel=0.1)


def test_icq_quadrilaterals_are_cut_along_the_shorter_diagonal(tmp_path):
    shape = read(tmp_path, "ball.tab", icq_text(8, jitter=0.01))
    lengths = []
    for one, other in shape.faces.reshape(-1, 2, 3):
        cut, rest = np.intersect1d(one, other), np.setxor1d(one, other)
        lengths.append([np.linalg.norm(np.subtract(*shape.vertices[ends])) for ends in (cut, rest)])
    cut, rest = np.array(lengths).T
    assert (cut <= rest).all()


BROKEN = {
    "missing column": ("a.obj", OBJ.replace("v 0 1 0", "v 0 1"), r"a\.obj:2: 'v 0 1' is not a vertex"),
    "word": ("a.obj", OBJ.replace("v 0 1 0", "v 0 x 0"), r"a\.obj:2: "),
    "nan": ("a.obj", OBJ.replace("v 0 1 0", "v 0 nan 0"), r"a\.obj:2: "),
    "overflow": ("a.obj", OBJ.replace("v 0 1 0", "v 0 1e999 0"), r"vertex 2 is not finite"),
    "cut face": ("a.obj", OBJ[:-3], r"a\.obj:8: 'f 3 4' is not .* a face"),
    "index 0": ("a.obj", OBJ.replace("f 1 2 3", "f 0 2 3"), r"a\.obj:5: "),
    "index beyond": ("a.obj", OBJ.replace("f 1 2 3", "f 1 2 9"), r"does a face name a vertex that does not exist"),
    "no faces": ("a.obj", TETRAHEDRON, r"0 faces; a shape needs both"),
    "empty": ("a.obj", "", r"a\.obj: the shape file is empty"),
    "blank": ("a.tab", "\n \n", r"the shape file is empty"),
    "words": ("a.tab", "hello world\n", r"cannot tell the format .* set body\.format"),
    "binary": ("a.obj", b"v 1 2 3\n\0\1\2", r"the file is binary"),
    "latin": ("a.tab", b"v 1 2 3\nv \xff 2 3", r"a\.tab:2: .* not text"),
    "plate nan": ("a.tab", OBJ.replace("v 0 1 0", "v 0 nan 0"), r"a\.tab:2: 'nan' is not a finite number"),
    "plate short": ("a.tab", OBJ.replace("v 0 1 0", "v 0 1"), r"a\.tab:2: expected 4 columns, found 3"),
    "plate index": ("a.tab", OBJ.replace("f 1 2 3", "f 1 2 9"), r"face 1 of 4 names a vertex that does not exist"),
    "plate fraction": ("a.tab", OBJ.replace("f 1 2 3", "f 1 2 2.5"), r"face 1 of 4 names a vertex"),
    "plate tag": ("a.tab", OBJ + "q 1 2 3\n", r"a\.tab:9: .* starts with v or f, not 'q'"),
    "counts": ("a.tab", counted_text() + "\n1 2 3 4", r"4 vertices and 4 plates need 10 lines, found 11"),
    "counted cut": ("a.tab", "\n".join(counted_text().splitlines()[:5]), r"ends after 5 lines, before its count"),
    "ply cut": ("a.ply", PLY[:-8], r"promises at least 8 lines of data, the file holds 7: it is cut"),
    "ply index": ("a.ply", PLY.replace("3 0 1 2", "3 0 1 7"), r"face 1 of 4 names a vertex that does not exist"),
    "ply negative": ("a.ply", PLY.replace("3 0 1 2", "3 0 1 -2"), r"face 1 of 4 names a vertex"),
    "ply nan": ("a.ply", PLY.replace("0 1 0", "0 nan 0"), r"vertex 2 is not finite"),
    "ply giant": ("a.ply", PLY.replace("vertex 4", "vertex 1000000000000"), r"promises at least 1000000000004 lines"),
    "ply no header": ("a.ply", "ply\n", r"it must start with ply and have an end_header line"),
    "grid cut": ("a.tab", grid_text().rsplit("\n", 14)[0], r"needs rows at both poles"),
    "grid hole": ("a.tab", grid_text().replace("0 30 2.0\n", "0 60 2.0\n", 1), r"is the file cut\?|has no row at"),
    "grid radius": ("a.tab", grid_text(radius=-1.0), r"is not a latitude, a longitude .* and a radius above 0"),
    "icq cut": ("a.icq", icq_text().rsplit("\n", 3)[0], r"Q = 4 needs 150 vertex lines, found 148"),
    "icq giant": ("a.icq", "9999\n1 2 3\n", r"Q = 9999 needs 600000000 vertex lines, found 1"),
    "icq no size": ("a.icq", "1 2 3\n1 2 3\n", r"a\.icq:1: an ICQ file starts with its grid size Q"),
    "icq layout": ("a.icq", "4\n" + "\n".join(icq_text().splitlines()[:0:-1]), r"not the layout of an ICQ file"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_file_is_refused_with_one_clear_line(tmp_path, case):
    name, content, message = BROKEN[case]
    with pytest.raises(BoresightError, match=message) as refused:
        read(tmp_path, name, content)
    assert "\n" not in str(refused.value)
    assert str(tmp_path / name) in str(refused.value)


def test_a_giant_binary_header_is_refused_before_memory_is_taken(tmp_path):
    header = PLY.split("end_header")[0].replace("ascii", "binary_little_endian").replace("vertex 4", "vertex 900000000")
    with pytest.raises(BoresightError, match="promises at least 108000000"):
        read(tmp_path, "a.ply", header.encode() + b"end_header\n" + bytes(40))


def test_missing_files_folders_and_meaningless_options_are_refused(tmp_path):
    with pytest.raises(BoresightError, match=r"nowhere\.obj: cannot be read: No such file"):
        read_shape(tmp_path / "nowhere.obj")
    with pytest.raises(BoresightError, match="cannot be read: Is a directory"):
        read_shape(tmp_path)
    with pytest.raises(BoresightError, match=r"body\.longitude: west has no meaning for a file of format obj"):
        read(tmp_path, "a.obj", OBJ, west_longitudes=True)

"""Every reader of files that a user may hand in: how it is called, its seeds, and words that hurt it.

The seeds of a reader are in ``seeds/NAME``: small valid files, and what once broke it (``found-...``).
"""

from __future__ import annotations

import struct
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from colmap_models import write_model, write_text_model
from fuzz import recipes, run_folders
from spc_folders import write_spc
from track_tables import make_world

from boresight.campaign.cli.bench import read_ratios
from boresight.campaign.data.crater_pictures import read_labels
from boresight.campaign.data.named_craters import GAZETTEER, read_gazetteer
from boresight.campaign.imaging.image_store import read_chunk
from boresight.campaign.imaging.real_images import open_tracks
from boresight.campaign.runs.read import CATALOG
from boresight.estimators.craters.database.files import read_detections, read_landmarks, read_matches, read_pictures
from boresight.estimators.craters.learned.detector import read_network
from boresight.estimators.craters.learned.network import SHAPES
from boresight.estimators.craters.planning import read_plan
from boresight.estimators.descriptors.database import FILE as DESCRIPTORS
from boresight.estimators.descriptors.database import DescriptorDatabase
from boresight.estimators.landmark.database import LandmarkDatabase
from boresight.estimators.landmark.robust.estimator import ConsensusOptions
from boresight.estimators.maplets.database import FILE as MAPLETS
from boresight.estimators.maplets.database import MapletDatabase
from boresight.estimators.options import parse_options
from boresight.estimators.slam.options import BundleOptions
from boresight.renderers.images import open_product
from boresight.renderers.images.colmap import read_colmap
from boresight.renderers.images.pixels import read_image
from boresight.renderers.images.posed_set import read_table
from boresight.renderers.spice import INSTRUMENTS
from boresight.reports.published import parse as parse_published
from boresight.reports.statistics.requirements import judge, read_requirement
from boresight.scenarios.bodies import load_body
from boresight.scenarios.data.datasets import read_registry
from boresight.scenarios.load import canonical_json, digest, file_kind, load_campaign, load_scenario
from boresight.scenarios.load.yaml_text import parse_yaml
from boresight.scenarios.spc import read_lmk, read_sum_landmarks, read_sumfile
from boresight.scenarios.spec.body import BodySpec
from boresight.scenarios.spec.campaign import grid_cells
from boresight.scenarios.spice import loaded_kernels
from boresight.scenarios.stars import read_hipparcos, read_stars

SEEDS = Path(__file__).with_name("seeds")
Read = Callable[[bytes, Path], object]


@dataclass(frozen=True)
class Reader:
    """One reader.

    Parameters
    ----------
    read
        Takes the content of a file and a folder to write it in; what is returned is used a little, as the next step
        of a run would.
    words
        What is inserted besides the common words of `mutations`.
    folders
        Other readers whose valid files are seeds as well.
    written
        Writes further valid files: those that depend on the columns of a run, or are large.
    cost
        By how much fewer inputs the fast tests give it than others, as each takes long.
    """

    read: Read
    words: tuple[bytes, ...] = ()
    folders: tuple[str, ...] = ()
    written: Callable[[], tuple[bytes, ...]] = tuple
    cost: int = 1


def valid(name: str) -> tuple[bytes, ...]:
    """Return the valid files of a reader."""
    folders = [SEEDS / folder for folder in (name, *READERS[name].folders)]
    return (*(p.read_bytes() for f in folders for p in sorted(f.glob("valid-*"))), *READERS[name].written())


def found(name: str) -> tuple[bytes, ...]:
    """Return what once broke a reader."""
    return tuple(path.read_bytes() for path in sorted((SEEDS / name).glob("found-*")))


YAML = (
    b"&a ", b"*a", b"*x", b"!!python/object/apply:os.system [id]", b"!!binary aGk=", b"!!set {a}", b"<<: *a", b"? ",
    b": ", b"- ", b"|\n", b">\n", b"---\n", b"...\n", b"%YAML 1.1\n", b"%TAG ! tag:x,2000:\n", b".nan", b".inf",
    b"0o777", b"&a [*a, *a]", b"a: &a [x, x]\nb: &b [*a, *a, *a, *a]\nc: &c [*b, *b, *b, *b]\n", b'"\\U00110000"',
    b'"\\ud800"', b"- " * 2000, b"{a: " * 2000, b"? " * 2000, b"2005-10-01", b"1:30:00", b"[]", b"{}", b"[[]]",
    b"[1, 2, 3]", b"~", b"yes", b'"\\e[31m"', b'"\\0"', b'"\\N"', b"\n  ", b"'", b"x: 1\nx: 2\n", b"\xe2\x80\xae",
)  # fmt: skip
XML = (
    b"<!DOCTYPE x [<!ENTITY a 'aaaa'><!ENTITY b '&a;&a;&a;'>]>", b"&a;", b"<a>" * 5000, b"<![CDATA[", b"xmlns:x=''",
    b'<?xml version="1.0" encoding="utf-7"?>', b'<!ENTITY x SYSTEM "file:///etc/passwd">', b"&x;", b"&#0;", b"/>",
)  # fmt: skip
KEYS = (
    b"extends: x.yaml\n", b"extends: /dev/zero\n", b"extends: ../../../../etc/passwd\n", b"extends: [x, x]\n",
    b"extends: .\n", b"name: ../x\n", b"description: null\n", b"images: {folder: /etc}\n", b"kind: hapke", b"kind: x",
    b"uniform", b"normal", b"camera", b"body", b"viewpoint", b"orbit", b"sequence", b"onboard", b"sensors", b"craters",
    b"second_body", b"detail", b"values", b"levels", b"design: two-level", b"extends: quickstart\n", b"body: null\n",
    b"requirements: [solved in 1e-300 % at 90 %]\n", b"position_error_m < 1e400 in 95 % at 90 %",
    b"error_after_99_m < 3 in 95 % at 90 %", b"extends: apophis-sphere-sequence\n",
    b"distortion: {k1: 1e300}", b"set: {a.b.c: 1}\n", b'extends: "a\\0b"\n',
)  # fmt: skip
OBJ = (
    b"f 1/2/3 2//1 -1", b"\\\n", b"mtllib ../../../../etc/passwd", b"usemtl x", b"v 1 2 3 4 5 6", b"f 1 2 3 4 5 6 7",
    b"vt 1 2", b"vn 1 2 3", b"g x", b"o x", b"l 1 2", b"f -1 -2 -3", b"vp 1", b"f 1 2 3 #", b"f " + b"1 " * 5000,
)  # fmt: skip
PLY = (
    b"format binary_little_endian 1.0", b"format binary_big_endian 1.0", b"format ascii 1.0", b"element vertex",
    b"element face", b"element edge 3", b"property float x", b"property list uchar int vertex_indices", b"uint64",
    b"property list double double x", b"comment", b"end_header", b"int8", b"property list uint8 float32 vertex_indices",
    b"comment TextureFile ../../../../etc/passwd", b"property uchar red", b"element vertex 0",
)  # fmt: skip
PNG = (b"IHDR", b"PLTE\0\0\0", b"tRNS", b"IDAT", b"acTL", b"\0\0\x80\0\0\0\x80\0", b"\0\0\xff\xff\0\0\xff\xff")
CARDS = (
    b"NAXIS   =                    3", b"NAXIS1  =           1000000000", b"NAXIS2  =                   -1", b"END",
    b"XTENSION= 'BINTABLE'", b"XTENSION= 'IMAGE   '", b"ZIMAGE  =                    T", b"ZCMPTYPE= 'RICE_1'",
    b"BITPIX  =                   64", b"BITPIX  =                    7", b"BSCALE  = 'x'", b"BSCALE  = 1e400",
    b"BZERO   = 32768", b"BLANK   = 0", b"CONTINUE  'x'", b"HIERARCH x y = 1", b"GROUPS  = T", b"PCOUNT  = 999999999",
    b"GCOUNT  = 0", b"GCOUNT  = 100000", b"TFORM1  = '1PB(9)'", b"NAXIS   = 999", b"SIMPLE  = F", b"INHERIT = T",
    b"CHECKSUM= '0'", b"DATE-OBS= '2005-13-41'", b"EXPTIME = -1", b"BUNIT   = 5", b"EXTEND  = T", b"ZNAXIS1 = 99999999",
    b"ZTILE1  = 0", b"ZVAL1   = 0", b"TFIELDS = 999", b"ZBITPIX = 3", b"ZQUANTIZ= 'x'", b"\ndata\n", b"\nunit\n",
)  # fmt: skip
PDS = (
    b"END\r\n", b"OBJECT = IMAGE", b"END_OBJECT", b"GROUP = FILE", b"/*", b"*/", b"<SECOND>", b"<BYTES>", b"2#11#",
    b"16#FFFFFFFFFFFFFFFFFFFF#", b"2005-10-01T03:04:05.25Z", b"2005-10-01T25:00:00", b"2005-365", b"MSB_INTEGER",
    b"IEEE_REAL", b"VAX_REAL", b"SAMPLE_BITS = 64", b"LINES = 1000000000", b"LINE_PREFIX_BYTES = 1000000000000",
    b"MISSING_CONSTANT = 16#FF7FFFFB#", b"MISSING_CONSTANT = 3", b"SCALING_FACTOR = 1e400", b"OFFSET = 1E-999999999",
    b'("A.IMG", 99999999999 <BYTES>)', b'"../../etc/passwd"', b"(((((((((", b"{1, {2, {3}}}", b"RECORD_BYTES = 0",
    b"SCALING_FACTOR = 1E999999999", b"EXPOSURE_DURATION = 1E999999999 <S>", b"1.5 <", b"12:34:60", b"0001-01-01T00:00",
    b"LINES = 5 <m>", b"LINES = {5}", b"^IMAGE = 1.5", b"BANDS = 0", b"EXPOSURE_DURATION = -1", b"NaN", b"sNaN",
    b"START_TIME = 0001-01-01T00:00:00+23:59", b"1E99999999999999999999",
)  # fmt: skip
BINARY_MODEL = (b"\0" * 8, b"\xff" * 8, b"\x01" + b"\0" * 7, b"\0\0\xf0\x7f")
TEXT_MODEL = (
    b"SIMPLE_PINHOLE", b"SIMPLE_RADIAL 9 9 9 9 1e300", b"RADIAL", b"OPENCV", b"FULL_OPENCV", b"OPENCV_FISHEYE", b"#",
    b"1 OPENCV 9 9 9 9 4 4 1 1 1 1\n", b"1 0 0 0 0 0 9 7 b.png\n\n", b" a.png", b" 1 2 3", b"1_0", b"-1", b"\r\n",
)  # fmt: skip
ARRAYS = (
    b"<f8", b"<f4", b">i2", b"|u1", b"|O", b"<U3", b"<c16", b"<M8[s]", b"|V8", b"<i8", b"|S5", b"1000000000,1000000000",
    b"1073741824", b"-1,3", b"0", b"3", b"head", b"heights", b"counts", b"1,1,1,1,1", b"'x'", b"1000000000000",
)  # fmt: skip
RECORDS = (b"picture", b"sighting", b"landmark", b"match", b"pair", b"image", b"crater", b"# boresight", b"-")
JSON = (
    b"{}", b"[]", b"null", b"NaN", b"Infinity", b"-Infinity", b'"\\ud800"', b'"\\u001b[31m"', b'{"a": 1}', b"[[1]]",
    b'"x"', b"1.5", b"true",
)  # fmt: skip
KINDS = (
    b"int64", b"int32", b"binary", b"list<float>", b"list<double>", b"string", b"float", b"null", b"8192", b"67108864",
    b"index", b"view", b"height_px", b"width_px", b"lit", b"values", b"0.5|0.25|nan", b"1|", b"|",
)  # fmt: skip
MATLAB = (
    b"Tracks", b"viewIds", b"meas", b"cam_rots", b"\x0f\0\0\0", b"\x0e\0\0\0", b"\xff\xff\xff\x7f", b"\x01\0\0\0",
    b"\0\0\0\0", b"IM", b"MI", b"\0\x02",
)  # fmt: skip
SPICE = (
    b"\\begindata", b"\\begintext", b"KPL/LSK", b"DAF/SPK ", b"DAF/CK  ", b"DAS/DSK ", b"+=", b"( 1, 2 )", b"'x'",
    b"@2005", b"PATH_VALUES", b"KERNELS_TO_LOAD = ( '/etc/passwd' )", b"KPL/MK", b"'" + b"x" * 200,
    b"( " + b"1.0 " * 3000 + b")",
)  # fmt: skip
OEM = (
    b"META_START", b"META_STOP", b"COVARIANCE_START", b"COMMENT", b"REF_FRAME = ICRF", b"TIME_SYSTEM = UTC",
    b"2027-02-30T00:00:00", b"2027-366T00:00:00", b"0000-01-01T00:00:00", b"2027-01-01T23:59:60.5", b"T", b":", b"Z",
    b"9999-12-31T23:59:59.999", b"1e400", b"nan",
)  # fmt: skip
COLUMNS = (
    b"int64", b"double", b"string", b"bool", b"binary", b"timestamp[s]", b"null", b"uint8", b"list<double>", b"date32",
    b"float", b"trial", b"scenario", b"status", b"ok", b"failed", b"error", b"large_string", b"image", b"reason",
    b"nees",
)  # fmt: skip
SUMFILES = (
    b"MMFL, CTR", b"SCOBJ", b"CX", b"SZ", b"K-MATRIX", b"DISTORTION", b"LANDMARKS", b".1D+99", b"1e400", b"nan", b"-0",
    b"1e-320", b"1_0", b"2019 FEB 29 00:00:00", b"9999 DEC 31 23:59:60.5",
)  # fmt: skip
SUMS = (b"/dev/zero", b"../manifest.json", b"rows/../x", b"rows//dev/zero", b"rows/", b"  ", b" *", b"0" * 64)


def in_file(name: str, read: Callable[[Path], object], packed: Callable[[bytes], bytes] = bytes) -> Read:
    """Return a reader of a file by that name, which is packed from a recipe."""

    def written(content: bytes, folder: Path) -> object:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(packed(content))
        return read(folder / name)

    return written


def text(content: bytes) -> str:
    return content.decode("utf-8", errors="replace")


def scenario(path: Path) -> object:
    file_kind(path)
    spec = load_scenario(str(path)).spec
    return canonical_json(spec), digest(spec), spec.camera.camera().matrix


def campaign(path: Path) -> object:
    spec = load_campaign(str(path), CATALOG).spec
    grid = None if spec.grid is None else grid_cells(spec.grid)
    return canonical_json(spec), digest(spec), grid, [judged(one.that, spec.experiment) for one in spec.requirements]


def judged(written: str, experiment: str) -> object:
    asked = read_requirement(written, experiment)
    return asked.in_words(), judge(asked, np.array([0.5, 2.0, np.inf])), judge(asked, np.zeros(40), looked=True)


def data_sets(path: Path) -> object:
    home = (path.parent / "data").resolve()
    entries = read_registry(path).values()
    for one in entries:
        for file in (*one.files, *(file.raw for file in one.files if file.raw)):
            assert (home / one.folder / file.name).resolve().is_relative_to(home), file
            assert "\n" not in one.url(file)
    return [one.provides("shapes/b.bin") for one in entries]


def options(content: bytes, _folder: Path) -> object:
    plain = parse_yaml(text(content), "x.yaml").plain()
    given = plain if isinstance(plain, dict) else {"views": plain}
    return parse_options(BundleOptions if "views" in given else ConsensusOptions, given, "x")


def shape(name: str, file_format: str) -> Read:
    spec = BodySpec.model_validate({"shape": name, "format": file_format, "expected_diameter_m": (0.1, 1e9)})
    return in_file(name, lambda path: load_body(spec, [path.parent]).mesh.normals)


def product(path: Path) -> object:
    opened = open_product(path)
    return opened.metadata(), opened.size_px, opened.pixels()


def sumfile(path: Path) -> object:
    read = read_sumfile(path)
    return read.camera.project(read.T_cam_body.transform(np.eye(3)))


def spc(name: str) -> Callable[[Path], object]:
    """Read a SUM or LMK file alone, then as one of a folder with the tracks of a trial."""

    def read(path: Path) -> object:
        (read_lmk if path.suffix == ".LMK" else read_sum_landmarks)(path)
        scene = write_spc(make_world(4, 12), path.with_name("spc"))
        path.rename(path.with_name("spc") / name)
        return open_tracks(load_scenario(str(scene)))

    return read


def colmap(name: str) -> Reader:
    """Return the reader of one file of a model, next to the other one as it should be."""
    write, words = (write_model, BINARY_MODEL) if name.endswith(".bin") else (write_text_model, TEXT_MODEL)

    def read(path: Path) -> object:
        content = path.read_bytes()
        write(path.parent, {"a.png": (1, 0, 0, 0, 0, 0, 9)})
        path.write_bytes(content)
        model = read_colmap(path.with_name(f"images{path.suffix}"), 1.0)
        return [camera.project(pose.transform(np.eye(3))) for camera, pose in model.values()]

    def written() -> tuple[bytes, ...]:
        with tempfile.TemporaryDirectory() as folder:
            write(Path(folder), {"a.png": (1, 0, 0, 0, 0, 0, 9), "b.png": (0, 1, 0, 0, 0, 0, 9)})
            return ((Path(folder) / name).read_bytes(),)

    return Reader(in_file(name, read), words, written=written)


def label(content: bytes, folder: Path) -> object:
    (folder / "a.img").write_bytes(struct.pack(">35h", *range(35)))
    return in_file("a.lbl", product)(content, folder)


def pds4(content: bytes, folder: Path) -> object:
    (folder / "image.dat").write_bytes(struct.pack(">35h", *range(35)))
    return in_file("a.xml", product)(content, folder)


def landmarks(name: str) -> Reader:
    """One of the three files is fuzzed, the others are sound."""

    def read(content: bytes, folder: Path) -> object:
        for other in LANDMARKS:
            (folder / other).write_bytes(content if other == name else valid(f"landmarks-{other}")[0])
        return LandmarkDatabase.load(folder).mesh().volume_m3

    return Reader(read)


LANDMARKS = ("landmarks.csv", "facets.csv", "database.json")


def weights() -> tuple[bytes, ...]:
    return (b"\n".join(recipes.array_line(n, np.full(shape, 0.5, np.float32)) for n, shape in SHAPES.items()),)


def chunk(path: Path) -> object:
    return [kept.image.sum() for kept in read_chunk(path).values()]


def kernel(path: Path) -> object:
    instrument = INSTRUMENTS["hayabusa-amica"]
    with loaded_kernels([path]):
        return instrument.camera(instrument.constants())


def states(name: str, ranges: str = "time_s") -> Callable[[Path], object]:
    """Read a table as the states of a trajectory, and one of its columns as ranges."""

    def read(path: Path) -> object:
        scene = path.with_name("scene.yaml")
        for viewpoint in (
            f"trajectory: {{table: {name}}}",
            f"range_m: {{choice: {{table: {name}, columns: {ranges}}}}}",
        ):
            scene.write_text(f"extends: quickstart\nviewpoint: {{{viewpoint}}}\n")
            digest(load_scenario(str(scene)).spec)
        return None

    return read


def tracks(key: str) -> Callable[[Path], object]:
    """Read a table as the sightings, or as the poses, of real tracks."""

    def read(path: Path) -> object:
        scene = make_world(4, 12).write(path.parent)
        return open_tracks(load_scenario(str(scene), [f"sequence.tracks.{key}={path.name}"]))

    return read


def matlab(name: str) -> Callable[[], tuple[bytes, ...]]:
    """Return a writer of the tracks or poses of a small world as a MATLAB file."""

    def written() -> tuple[bytes, ...]:
        with tempfile.TemporaryDirectory() as folder:
            make_world(4, 12).write_matlab(Path(folder))
            return ((Path(folder) / name).read_bytes(),)

    return written


READERS = {
    "yaml": Reader(lambda content, _: parse_yaml(text(content), "x.yaml").plain(), YAML, ("scenario", "campaign")),
    "scenario": Reader(in_file("x.yaml", scenario), (*YAML, *KEYS)),
    "campaign": Reader(in_file("x.yaml", campaign), (*YAML, *KEYS)),
    "data-set": Reader(in_file("x.yaml", data_sets), YAML),
    "override": Reader(lambda content, _: canonical_json(load_scenario("quickstart", [text(content)]).spec), YAML),
    "options": Reader(options, YAML),
    "published": Reader(lambda content, _: parse_published(text(content), "x.yaml"), YAML),
    "obj": Reader(shape("x.obj", "auto"), OBJ),
    "ply": Reader(shape("x.ply", "auto"), PLY),
    "pds-plates": Reader(shape("x.tab", "pds-plates")),
    "pds-grid": Reader(shape("x.tab", "pds-grid")),
    "icq": Reader(shape("x.icq", "icq"), (b"16384", b"9999")),
    "dsk": Reader(shape("x.bds", "dsk"), (b"DAS/DSK ", b"BIG-IEEE", b"\xff" * 4, b"\0" * 4)),
    "shape": Reader(shape("x.tab", "auto"), (), ("obj", "pds-plates", "pds-grid", "icq", "ply", "dsk")),
    "png": Reader(in_file("x.png", read_image, recipes.png), PNG),
    "tiff": Reader(in_file("x.tif", read_image)),
    "fits": Reader(in_file("x.fits", product, recipes.fits_file), CARDS),
    "fits-bytes": Reader(in_file("x.fit", product), CARDS),
    "pds-label": Reader(label, PDS, cost=2),
    "pds4-label": Reader(pds4, XML),
    "pds-image": Reader(in_file("x.img", product), PDS),
    "pose-table": Reader(
        in_file("poses.csv", lambda path: read_table(path, ("ref",))), (b"a.png", b"C:\\x", b"..\\x", b"\r\n")
    ),
    "star-table": Reader(in_file("x.csv", read_stars), (b"1e400", b"nan", b"ra_deg", b"-90.1", b'"', b"#", b"\r\n")),
    "hipparcos": Reader(
        in_file("hip2.dat", lambda path: read_hipparcos(path, 2000.0)), (b"\n", b"nan", b"1e400", b"\0")
    ),
    "sumfile": Reader(in_file("x.SUM", sumfile), SUMFILES),
    "sum-landmarks": Reader(
        in_file("W48230000400.SUM", spc("SUMFILES/W48230000400.SUM")), (*SUMFILES, b"LIMB FITS", b" -\n", b"FA0001")
    ),
    "lmk": Reader(in_file("FA0001.LMK", spc("LMKFILES/FA0001.LMK")), (*SUMFILES, b"VLM", b"END FILE")),
    "colmap-cameras": colmap("cameras.bin"),
    "colmap-images": colmap("images.bin"),
    "colmap-text-cameras": colmap("cameras.txt"),
    "colmap-text-images": colmap("images.txt"),
    "states": Reader(in_file("x.csv", states("x.csv")), (b"1e400", b"nan", b"x_km", b"time_s", b'"', b"#"), cost=2),
    "states-oem": Reader(in_file("x.oem", states("x.oem", "x_km")), OEM, cost=2),
    "states-tum": Reader(in_file("x.tum", states("x.tum", "x_m")), (b"1e400", b"nan", b"#", b"0 " * 9), cost=2),
    "states-recipe": Reader(in_file("x.parquet", states("x.parquet"), recipes.parquet), KINDS, cost=2),
    "tracks": Reader(in_file("x.csv", tracks("table")), (b"1e400", b"nan", b"u_px", b"-1", b'"', b"#")),
    "tracks-matlab": Reader(in_file("x.mat", tracks("table")), MATLAB, written=matlab("tracks.mat")),
    "poses-matlab": Reader(in_file("x.mat", tracks("poses")), MATLAB, written=matlab("poses.mat")),
    **{f"landmarks-{name}": landmarks(name) for name in LANDMARKS},
    "maplets": Reader(in_file(MAPLETS, lambda path: MapletDatabase.load(path.parent), recipes.npz), ARRAYS),
    "maplets-bytes": Reader(in_file(MAPLETS, lambda path: MapletDatabase.load(path.parent))),
    "descriptors": Reader(in_file(DESCRIPTORS, lambda path: DescriptorDatabase.load(path.parent), recipes.npz), ARRAYS),
    "crater-pictures": Reader(in_file("pictures.txt", read_pictures), RECORDS),
    "crater-landmarks": Reader(in_file("landmarks.txt", read_landmarks), RECORDS),
    "crater-detections": Reader(in_file("1.txt", read_detections), RECORDS),
    "crater-matches": Reader(in_file("1.txt", read_matches), RECORDS),
    "image-plan": Reader(in_file("plan.txt", read_plan), RECORDS),
    "weights": Reader(in_file("weights.npz", read_network, recipes.npz), ARRAYS, written=weights),
    "crater-labels": Reader(
        in_file("labels.csv", read_labels),
        (b"nan", b"1e400", b"diameter", b"angle_deg", b"-1", b'"', b"#", b";", b"\t"),
    ),
    "gazetteer": Reader(in_file(GAZETTEER, lambda path: read_gazetteer([path.parents[1]]))),
    "image-chunk": Reader(in_file("images.parquet", chunk, recipes.parquet), KINDS),
    "image-chunk-bytes": Reader(in_file("images.parquet", chunk)),
    "bench": Reader(in_file("before.json", read_ratios), JSON),
    "kernel": Reader(in_file("x.ti", kernel), SPICE),
    "manifest": Reader(run_folders.manifest, JSON, written=lambda: (run_folders.stored()["manifest.json"],), cost=2),
    "rows": Reader(run_folders.rows_recipe, COLUMNS, written=run_folders.rows_seeds, cost=4),
    "rows-bytes": Reader(run_folders.rows, written=lambda: (run_folders.stored()[run_folders.ROWS],)),
    "report-record": Reader(run_folders.report_record, (*JSON, *SUMS), written=run_folders.record_seeds),
    "checksums": Reader(run_folders.checksums, SUMS, written=lambda: (run_folders.stored()[run_folders.SUMS],)),
}

"""Inputs that once broke a reader, as small as they go, by its name; the tests try each of them first."""

from __future__ import annotations

_LABEL = b"PDS_VERSION_ID = PDS3\n%s\nEND\n"
_IMAGE = (
    b'^IMAGE = ("A.IMG", 1 <BYTES>)\nOBJECT = IMAGE\nLINES = 5\nLINE_SAMPLES = 7\nSAMPLE_TYPE = MSB_INTEGER\n'
    b"SAMPLE_BITS = 16\n%s\nEND_OBJECT = IMAGE"
)
_POSES = (
    b"file,time_s,ref_qw,ref_qx,ref_qy,ref_qz,ref_tx_m,ref_ty_m,ref_tz_m,sun_body_x,sun_body_y,sun_body_z\n"
    b"a.png,0,%s,0,0,0,0,0,2000,%s,0,0\n"
)
_FITS = b"SIMPLE  = T\nBITPIX  = %s\nNAXIS   = %s\ndata\n"
_PACKED = b"""SIMPLE  =                    T
BITPIX  =                    8
NAXIS   =                    0
EXTEND  =                    T
data

unit
XTENSION= 'BINTABLE'
BITPIX  =                    8
NAXIS   =                    2
NAXIS1  =                    8
NAXIS2  =                    1
PCOUNT  =                    4
GCOUNT  =                    1
TFIELDS =                    1
TTYPE1  = 'COMPRESSED_DATA'
TFORM1  = '1PB(4)  '
ZIMAGE  =                    T
ZCMPTYPE= 'RICE_1  '
ZBITPIX =                   16
ZNAXIS  =                    2
ZNAXIS1 = %s
ZNAXIS2 = %s
ZTILE1  = %s
ZTILE2  =                    1
ZNAME1  = 'BLOCKSIZE'
ZVAL1   =                   32
ZNAME2  = 'BYTEPIX '
ZVAL2   =                    2
data
0000000400000000ffffffff"""
_MANIFEST = (
    b'{"format": 2, "digest": "a", "name": "%s", "seed": 1, "trials": 2, "scenarios": {"orbit": %s},'
    b' "command": "%s", "estimators": [], "versions": {}, "machine": {}, "credits": []}'
)
_KEYS = b"trial int64 0\nscenario string %s\nestimator string e\nstatus string ok\n"
_MAPLETS = b"head |u1 2 {}\ncentres_m <f8 %s 1.0"

_RECORD = (
    b'{"source": "' + b"0" * 64 + b'", "files": %b, "grids": [{"title": "%b", "columns": ["a", "b"], "rows": [%b],'
    b' "text": [0], "note": "", "known": "y"}], "lines": ["%b"]}'
)

FOUND: dict[str, tuple[bytes, ...]] = {
    # Errors of the parser that have no mark.
    "yaml": (
        b"%YAML 9.9\n--- a",
        b"%YAML 1.9\n--- a",
        b"%TAG ! tag:x,2000:\n--- !y z",
        b"&a &b c",
        b'"\\U00110000"',
        b'"\\UFFFFFFFF"',
    ),
    # A pipe or a device has no size, and no end.
    "scenario": (b"extends: /dev/zero\n", b"extends: /dev/stdin\n"),
    # JSON has no infinities: the digest raised ValueError.
    "campaign": (b"scenarios: [a]\nestimators: [prior: {b: .inf}]\ntrials: 1\nseed: 1\nset: {a: {b: [.nan]}}\n",),
    # A name of the folder above; entries that are no sections.
    "data-set": (
        b"a: {title: a, folder: a, credit: a, licence: a, repository: a/b, commit: '%s', files: [{name: .., bytes: 1,"
        b" sha256: '%s'}]}\n" % (b"0" * 40, b"0" * 64),
        b"a: 1\nb: [a]\n",
    ),
    # What is asked for came back with what steers a terminal.
    "override": (
        b"\x1b[31m",
        b"a\nb",
        # Overflow: a focal length that no number holds.
        b"camera.fov_deg=1e-320",
    ),
    # The name of a key of several lines.
    "options": (b'"a\\n\\nb": 1\n',),
    # Complaints of several lines; RecursionError.
    "published": (b"source: a\nsource: a\n", b"source: " + b"{a: " * 2000),
    # A warning of NumPy's: corners with and without a place on a texture.
    "obj": (b"v 0 0 372\nf 1/2/3 2/1 -1/1 -1",),
    # Overflow in the edges of seams.
    "icq": (b"1\n" + b"1e308 0 0\n-1e308 0 0\n" * 12,),
    "pds-plates": (b"v 1e308 0 0\nv -1e308 0 0\nv 0 1e308 0\nf 1 2 3\n",),
    # OpenCV took the 4 GiB that a chunk said it holds.
    "png": (
        b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\0\x06\0\0\0\x05\x08\0\0\0\0C3\xc2:\xff\xff\xff\xffIDAT\x08\xff\x7f\0\0\0\0\0\0",
    ),
    # astropy: OverflowError, AttributeError, a loop over a thousand million axes, cfitsio's exception, a bomb; a name
    # that is taken for a pattern.
    "fits": (
        _FITS % (b"-9223372036854775808", b"0"),
        _FITS % (b"8", b"0") + b"\nunit\nNAME    = 'x'",
        _FITS % (b"8", b"1000000000"),
        _PACKED % (b"30", b"1", b"30"),
        _PACKED.replace(b"TFIELDS =                    1", b"TFIELDS =            999999999") % (b"1", b"1", b"1"),
        _PACKED % (b"60000", b"60000", b"60000"),
        _FITS % (b"8", b"2\nNAXIS1  = 2\nNAXIS2  = 1\n(*      = 1") + b"0102",
    ),
    # pvl mends a keyword with two values for ever; RecursionError; numbers beyond those of an array, or of any.
    "pds-label": (
        _LABEL % b"OBJECT = IMAGE\nA = 1 = 2\nEND_OBJECT = IMAGE",
        _LABEL % (b"A = " + b"(" * 3000),
        _LABEL % (_IMAGE % b"MISSING_CONSTANT = 99999999999999999999"),
        _LABEL % (_IMAGE % b"SCALING_FACTOR = 1E999999999"),
        _LABEL % (_IMAGE % b"OFFSET = NaN"),
        _LABEL % b"EXPOSURE_DURATION = sNaN",
        _LABEL % b"START_TIME = 0001-01-01T00:00:00+23:59",
    ),
    # Norms of quaternions and directions overflowed.
    "pose-table": (_POSES % (b"1e200", b"1"), _POSES % (b"1", b"1e200"), b"\0_qw\n"),
    "landmarks-facets.csv": (b"i,j,k\n0,1,2\n0,3,1,5\n",),
    # NumPy: MemoryError, OverflowError, TokenError; bytes in the place of an array.
    "maplets": (_MAPLETS % b"2147483648,3", _MAPLETS % b"99999999999999999999", _MAPLETS % b"),3", b"head |S5 1 a"),
    "descriptors": (_MAPLETS % b"2147483648,3", _MAPLETS % b"),3"),
    # More digits than 64 bits, or than Python turns into a number.
    "crater-matches": (
        b"# boresight crater matches 1\npair 1 2 -\nmatch 1 2 99999999999999999999 0 1\n",
        b"# boresight crater matches 1\npair %s 2 -\n" % (b"9" * 5000),
    ),
    "crater-landmarks": (b"# boresight landmarks of craters 1\nlandmark 99999999999999999999" + b" 0" * 14 + b"\n",),
    "crater-detections": (b"# boresight crater detections 1\nimage %s 0 -\n" % (b"9" * 5000),),
    # UnicodeDecodeError, _csv.Error.
    "gazetteer": (b"\xff", b'name,lat_deg,lon_east_deg,diam_km\n"a', b"name,lat_deg,lon_east_deg,diam_km\na,nan,1,1\n"),
    # Entries that are missing; words that style a line, steer a terminal or end no quotation; a section that is none.
    # Rows of too few cells; what steers a terminal; files elsewhere.
    "report-record": (
        _RECORD % (b"{}", b"x", b'["c"]', b"z"),
        _RECORD % (b"{}", b"\\u001b[31m", b'["\\u001b[31m", "d"]', b"\\u001b[31m"),
        _RECORD % (b'{"/dev/zero": "x", "../manifest.json": "x"}', b"x", b'["c", "d"]', b"z"),
    ),
    "manifest": (
        b'{"digest": "a"}',
        b"[" * 3000,
        _MANIFEST % (b"[/x]", b"{}", b""),
        _MANIFEST % (b"\\u001b[31m", b"{}", b"boresight run"),
        _MANIFEST % (b"a", b"{}", b"boresight 'run"),
        _MANIFEST % (b"a", b'{"images": 1, "sequence": [1]}', b""),
    ),
    # Texts where numbers belong; columns that are missing; a scenario that the manifest does not name; gaps in keys.
    "rows": (
        _KEYS % b"orbit" + b"n_landmarks string many",
        b"scenario string s",
        _KEYS % b"moon",
        _KEYS % b"null",
        _KEYS % b"orbit" + b"reason list<float> 1|2",
    ),
    "rows-bytes": (b"", b"PAR1"),
    # A name that no file system takes.
    "checksums": (b"%s  rows/%s\n" % (b"0" * 64, b"9" * 300),),
    # A shape that needs 256 MiB for each of many images.
    "image-chunk": (
        b"index int64 0 1\nview binary a a\nheight_px int32 8192 8192\nwidth_px int32 8192 8192\nlit binary a a\n"
        b"values list<float> 1 1",
    ),
    # RecursionError.
    "bench": (b"[" * 3000,),
    # One number where three belong; a division by zero.
    "kernel": (
        b"KPL/IK\n\\begindata\nINS-130102_OD_K = 1\nINS-130102_CENTER = ( 1 1 )\nINS-130102_PIXEL_SAMPLES = 1\n"
        b"INS-130102_PIXEL_LINES = 1\nINS-130102_FOCAL_LENGTH = 1\nINS-130102_PIXEL_SIZE = 0\n\\begintext\n",
    ),
}

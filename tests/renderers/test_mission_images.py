"""Images as missions publish them: PDS3 labels and FITS headers, against astropy, struct and a real NEAR image."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from mission_data import data_path, needs_data

from boresight.renderers.images import open_product
from boresight.scenarios.errors import BoresightError

MSI = data_path("images/near_msi/m0126865998f4_2p_iof.lbl")
LINES, SAMPLES = 5, 7

LABEL = """PDS_VERSION_ID = PDS3
RECORD_TYPE = FIXED_LENGTH
RECORD_BYTES = 512
{pointer}
INSTRUMENT_HOST_NAME = "HAYABUSA"
INSTRUMENT_ID = "AMICA"
TARGET_NAME = "25143 ITOKAWA"
FILTER_NAME = "V"
START_TIME = 2005-10-01T03:04:05.25
EXPOSURE_DURATION = {exposure}
OBJECT = IMAGE
  LINES = 5
  LINE_SAMPLES = 7
  SAMPLE_TYPE = {kind}
  SAMPLE_BITS = {bits}
{more}END_OBJECT = IMAGE
END
"""


def label(**keys: object) -> bytes:
    values = {
        "pointer": '^IMAGE = "A.IMG"',
        "exposure": ".0218 <SECOND>",
        "kind": "MSB_INTEGER",
        "bits": 16,
        "more": "",
    }
    return LABEL.format(**{**values, **keys}).replace("\n", "\r\n").encode()


def packed(code: str) -> bytes:
    """Numbers 0, 1, 2, ... in the order of the file, by struct."""
    return struct.pack(f"{code[0]}{LINES * SAMPLES}{code[1]}", *range(LINES * SAMPLES))


EXPECTED = np.arange(LINES * SAMPLES, dtype=np.float32).reshape(LINES, SAMPLES)


@pytest.mark.parametrize(
    ("kind", "bits", "code"),
    [
        ("MSB_INTEGER", 16, ">h"), ("LSB_INTEGER", 16, "<h"), ("PC_INTEGER", 32, "<i"), ("SUN_INTEGER", 32, ">i"),
        ("UNSIGNED_INTEGER", 8, ">B"), ("VAX_UNSIGNED_INTEGER", 16, "<H"), ("IEEE_REAL", 32, ">f"),
        ("PC_REAL", 32, "<f"), ("IEEE_REAL", 64, ">d"),
    ],
)  # fmt: skip
def test_samples_of_each_type_are_read(tmp_path, kind, bits, code):
    (tmp_path / "a.img").write_bytes(packed(code))  # the label shouts the name
    (tmp_path / "a.lbl").write_bytes(label(kind=kind, bits=bits))
    for name in ("a.lbl", "a.img"):
        np.testing.assert_array_equal(open_product(tmp_path / name).pixels(), EXPECTED)


def test_a_missing_pixel_may_be_told_by_its_bits(tmp_path):
    """As ISIS writes it: 40E00000 are the bits of 7.0."""
    (tmp_path / "a.img").write_bytes(packed(">f"))
    (tmp_path / "a.lbl").write_bytes(label(kind="IEEE_REAL", bits=32, more="  MISSING_CONSTANT = 16#40E00000#\n"))
    with pytest.raises(BoresightError, match=r"1 pixels are marked as missing \(MISSING_CONSTANT = 7\)"):
        open_product(tmp_path / "a.lbl").pixels()


@pytest.mark.parametrize(
    ("pointer", "before"),
    [
        ('^IMAGE = ("A.IMG", 3)', 1024), ('^IMAGE = ("A.IMG", 11 <BYTES>)', 10), ('^IMAGE = "A.IMG"', 0),
        ('^IMAGE = ("A.IMG", 1)', 0),
    ],
)  # fmt: skip
def test_a_detached_label_points_to_records_or_bytes(tmp_path, pointer, before):
    (tmp_path / "A.IMG").write_bytes(b"\xff" * before + packed(">h"))
    (tmp_path / "A.LBL").write_bytes(label(pointer=pointer))
    np.testing.assert_array_equal(open_product(tmp_path / "A.LBL").pixels(), EXPECTED)


@pytest.mark.parametrize("pointer", ["^IMAGE = 3", "^IMAGE = 1025 <BYTES>"])
def test_an_attached_label_is_in_the_file_itself(tmp_path, pointer):
    text = label(pointer=pointer)
    (tmp_path / "b.img").write_bytes(text + b" " * (1024 - len(text)) + packed(">h"))
    product = open_product(tmp_path / "b.img")
    np.testing.assert_array_equal(product.pixels(), EXPECTED)
    assert product.files == (tmp_path / "b.img",)


def test_scaling_prefixes_and_suffixes(tmp_path):
    rows = [struct.pack(">4x7h2x", *range(7 * k, 7 * k + 7)) for k in range(LINES)]
    (tmp_path / "a.img").write_bytes(b"".join(rows))
    more = "  LINE_PREFIX_BYTES = 4\n  LINE_SUFFIX_BYTES = 2\n  SCALING_FACTOR = 0.5\n  OFFSET = -3\n"
    (tmp_path / "a.lbl").write_bytes(label(more=more))
    np.testing.assert_array_equal(open_product(tmp_path / "a.lbl").pixels(), 0.5 * EXPECTED - 3)


def test_a_pointer_may_stand_in_a_file_object(tmp_path):
    """As in the labels of the AMICA images with geometry."""
    text = label().replace(b'^IMAGE = "A.IMG"', b'OBJECT = FILE\r\n^IMAGE = "A.IMG"')
    text = text.replace(b"END_OBJECT = IMAGE\r\n", b"END_OBJECT = IMAGE\r\nEND_OBJECT = FILE\r\n")
    (tmp_path / "a.img").write_bytes(packed(">h"))
    (tmp_path / "a.lbl").write_bytes(text)
    np.testing.assert_array_equal(open_product(tmp_path / "a.lbl").pixels(), EXPECTED)


def test_the_label_tells_time_exposure_and_names(tmp_path):
    (tmp_path / "a.img").write_bytes(packed(">h"))
    (tmp_path / "a.lbl").write_bytes(label(more="  UNIT = DN\n"))
    told = open_product(tmp_path / "a.lbl").metadata()
    assert told.start_utc == "2005-10-01T03:04:05.250000"
    assert told.exposure_s == pytest.approx(0.0218)
    assert (told.spacecraft, told.instrument, told.filter) == ("HAYABUSA", "AMICA", "V")
    assert (told.target, told.unit, told.line_display) == ("25143 ITOKAWA", "DN", None)


@pytest.mark.parametrize(
    ("exposure", "seconds"), [("89.0 <ms>", 0.089), (".131", 0.131), ('"N/A"', None), ("2 <SECONDS>", 2.0)]
)
def test_exposures_come_in_several_units(tmp_path, exposure, seconds):
    (tmp_path / "a.img").write_bytes(packed(">h"))
    (tmp_path / "a.lbl").write_bytes(label(exposure=exposure))
    assert open_product(tmp_path / "a.lbl").metadata().exposure_s == pytest.approx(seconds)


def write_fits(path: Path, **keywords: object) -> None:
    header = fits.Header({key.replace("_KEY", ""): value for key, value in keywords.items()})
    fits.PrimaryHDU(EXPECTED.astype(np.int16), header).writeto(path)


def test_a_fits_file_tells_by_its_header(tmp_path):
    write_fits(tmp_path / "a.fit", INSTRUME="AMICA", EXPTIME=0.5, TI_0=2457499394, OBJECT="ITOKAWA", BUNIT="DN")
    product = open_product(tmp_path / "a.fit")
    told = product.metadata()
    np.testing.assert_array_equal(product.pixels(), EXPECTED)
    assert (told.instrument, told.exposure_s, told.target, told.unit) == ("AMICA", 0.5, "ITOKAWA", "DN")
    assert product.keywords["TI_0"] == 2457499394
    assert product.label is None


def test_a_label_beside_a_fits_file_is_read_with_it(tmp_path):
    write_fits(tmp_path / "a.fit", TI_0=2457499394, EXPTIME=9.0)
    (tmp_path / "a.lbl").write_bytes(label(pointer='^IMAGE = "A.FIT"'))
    for name in ("a.fit", "a.lbl"):
        product = open_product(tmp_path / name)
        np.testing.assert_array_equal(product.pixels(), EXPECTED)
        assert product.keywords["TI_0"] == 2457499394
        assert product.metadata().exposure_s == pytest.approx(0.0218)  # the label is believed before the header
        assert set(product.files) == {tmp_path / "a.fit", tmp_path / "a.lbl"}


FAULTS = {
    "no label": (b"", "does not start with a PDS3 label"),
    "no end": (b"PDS_VERSION_ID = PDS3\r\nA = 1\r\n", "no line END"),
    "not the language": (b"PDS_VERSION_ID = PDS3\r\nX = (1,\r\nEND\r\n", "not a readable PDS3 label"),
    "no pointer": (label(pointer=""), r"\^IMAGE: missing"),
    "no file": (label(pointer='^IMAGE = "B.IMG"'), r"image: B.IMG is not in"),
    "no place": (label(pointer='^IMAGE = ("A.IMG", 3 <KB>)'), r"3 KB is no place"),
    "place from 0": (label(pointer='^IMAGE = ("A.IMG", 0)'), "0 records is no place"),
    "odd type": (label(kind="VAX_REAL"), "SAMPLE_TYPE: VAX_REAL is not read"),
    "odd bits": (label(bits=12), "SAMPLE_BITS: 12 with SAMPLE_TYPE MSB_INTEGER"),
    "colour": (label(more="  BANDS = 3\n"), "BANDS: 3 is not 1"),
    "beyond the end": (label(pointer='^IMAGE = ("A.IMG", 2)'), "too short: 5 lines of 14 bytes from byte 512"),
    "no size": (label().replace(b"LINES = 5", b"LINES = N"), "LINES: 'N' is not a whole number"),
    "bits that are too many": (label(more="  MISSING_CONSTANT = 16#10003#\n"), "0x10003 is no pattern of 16 bits"),
    "negative bits": (label(more="  MISSING_CONSTANT = 16#-3#\n"), "-0x3 is no pattern of 16 bits"),
    "a scale by its bits": (label(more="  SCALING_FACTOR = 16#3#\n"), "SCALING_FACTOR: 3 is not a finite number"),
    "gaps": (label(more="  MISSING_CONSTANT = 3\n"), r"1 pixels are marked as missing"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_of_a_label_is_said_in_one_line(tmp_path, fault):
    content, message = FAULTS[fault]
    (tmp_path / "a.img").write_bytes(packed(">h"))
    (tmp_path / "a.lbl").write_bytes(content)
    with pytest.raises(BoresightError, match=message) as error:
        open_product(tmp_path / "a.lbl").pixels()
    assert str(tmp_path) in str(error.value)
    assert "\n" not in str(error.value)


def test_faults_of_the_metadata(tmp_path):
    (tmp_path / "a.img").write_bytes(packed(">h"))
    for text, message in (
        (label(exposure="3 <pixel>"), "pixel is not a unit of time"),
        (label(exposure="-1"), "exposure: -1 is not a number of at least 0"),
        (label().replace(b"2005-10-01T03:04:05.25", b"2005-10-01"), "no time of the day"),
        (label().replace(b"2005-10-01T03:04:05.25", b'"soon"'), "'soon' is not a time"),
    ):
        (tmp_path / "a.lbl").write_bytes(text)
        with pytest.raises(BoresightError, match=message):
            open_product(tmp_path / "a.lbl").metadata()


def test_other_files_are_refused(tmp_path):
    (tmp_path / "a.img").write_bytes(packed(">h"))
    with pytest.raises(BoresightError, match="has no label of the PDS, neither in it nor beside it"):
        open_product(tmp_path / "a.img")
    with pytest.raises(BoresightError, match="not a format of missions"):
        open_product(tmp_path / "a.png")
    with pytest.raises(BoresightError, match="No such file"):
        open_product(tmp_path / "b.lbl")


def test_a_date_that_looks_like_a_time_zone_is_refused_in_one_line(tmp_path):
    (tmp_path / "a.img").write_bytes(packed(">h"))
    (tmp_path / "a.lbl").write_bytes(label().replace(b"END\r\n", b"A_DATE = 2005-10-0\r\nEND\r\n"))
    with pytest.raises(BoresightError, match="not a readable PDS3 label"):
        open_product(tmp_path / "a.lbl")


@needs_data("images/near_msi")
def test_a_near_label_describes_the_same_pixels_as_astropy_reads(tmp_path):
    """The label points into the FITS file by records; astropy follows the FITS header."""
    fits_file = MSI.with_suffix(".fit")
    theirs = fits.getdata(fits_file).astype(np.float32)
    np.testing.assert_array_equal(open_product(MSI).pixels(), theirs)
    (tmp_path / "raw.img").write_bytes(fits_file.read_bytes())
    (tmp_path / "raw.lbl").write_bytes(MSI.read_bytes().replace(b"M0126865998F4_2P_IOF.FIT", b"RAW.IMG"))
    np.testing.assert_array_equal(open_product(tmp_path / "raw.lbl").pixels(), theirs)


@needs_data("images/near_msi")
def test_a_near_label_tells_what_the_header_tells():
    told = open_product(MSI).metadata()
    header = open_product(MSI.with_suffix(".fit")).keywords
    assert (told.instrument, told.target, told.filter, told.unit) == ("MSI", "EROS", "4", "I/F")
    assert told.exposure_s == pytest.approx(1e-3 * header["NEAR-010"])
    assert told.start_utc == "2000-02-25T05:16:12.656000"
    assert told.line_display == "up"

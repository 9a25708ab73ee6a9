"""Readers of images, of their labels, and of tables of poses."""

from __future__ import annotations

import io
import struct
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from astropy.io import fits

from boresight.renderers.images import open_product
from boresight.renderers.images.pixels import read_image
from boresight.renderers.images.posed_set import read_table
from hostile import recipes
from hostile.target import Target

_PIXELS = (np.arange(30, dtype=np.uint8).reshape(5, 6) * 8).astype(np.uint8)


def targets() -> dict[str, Target]:
    """Images of each kind, labels, and the table of a posed set."""
    return {
        "png": Target(partial(_bitmap, "x.png", True), lambda: (_encoded(".png"), _encoded(".png", np.uint16)), _PNG),
        "tiff": Target(partial(_bitmap, "x.tif", False), lambda: (_encoded(".tif"), _encoded(".tif", np.uint16))),
        "fits": Target(_fits, _fits_seeds, _CARDS),
        "fits-bytes": Target(_product("x.fit"), _fits_files, _CARDS),
        "pds-label": Target(_label, lambda: (LABEL,), _PDS, cost=2),
        "pds-image": Target(_product("x.img"), lambda: (_ATTACHED + bytes(70),), _PDS),
        "pose-table": Target(_table, lambda: (_POSES,), (b"a.png", b"C:\\x", b"..\\x", b"\r\n")),
    }


_PNG = (b"IHDR", b"PLTE\0\0\0", b"tRNS", b"IDAT", b"acTL", b"\0\0\x80\0\0\0\x80\0", b"\0\0\xff\xff\0\0\xff\xff")
_CARDS = (
    b"NAXIS   =                    3", b"NAXIS1  =           1000000000", b"NAXIS2  =                   -1", b"END",
    b"XTENSION= 'BINTABLE'", b"XTENSION= 'IMAGE   '", b"ZIMAGE  =                    T", b"ZCMPTYPE= 'RICE_1'",
    b"BITPIX  =                   64", b"BITPIX  =                    7", b"BSCALE  = 'x'", b"BSCALE  = 1e400",
    b"BZERO   = 32768", b"BLANK   = 0", b"CONTINUE  'x'", b"HIERARCH x y = 1", b"GROUPS  = T", b"PCOUNT  = 999999999",
    b"GCOUNT  = 0", b"GCOUNT  = 100000", b"TFORM1  = '1PB(9)'", b"NAXIS   = 999", b"SIMPLE  = F", b"INHERIT = T",
    b"CHECKSUM= '0'", b"DATE-OBS= '2005-13-41'", b"EXPTIME = -1", b"BUNIT   = 5", b"EXTEND  = T", b"ZNAXIS1 = 99999999",
    b"ZTILE1  = 0", b"ZVAL1   = 0", b"TFIELDS = 999", b"ZBITPIX = 3", b"ZQUANTIZ= 'x'", b"\ndata\n",
    b"\nunit\n",
)  # fmt: skip
_PDS = (
    b"END\r\n", b"OBJECT = IMAGE", b"END_OBJECT", b"GROUP = FILE", b"/*", b"*/", b"<SECOND>", b"<BYTES>", b"2#11#",
    b"16#FFFFFFFFFFFFFFFFFFFF#", b"2005-10-01T03:04:05.25Z", b"2005-10-01T25:00:00", b"2005-365", b"MSB_INTEGER",
    b"IEEE_REAL", b"VAX_REAL", b"SAMPLE_BITS = 64", b"LINES = 1000000000", b"LINE_PREFIX_BYTES = 1000000000000",
    b"MISSING_CONSTANT = 16#FF7FFFFB#", b"MISSING_CONSTANT = 3", b"SCALING_FACTOR = 1e400", b"OFFSET = 1E-999999999",
    b'("A.IMG", 99999999999 <BYTES>)', b'"../../etc/passwd"', b"(((((((((", b"{1, {2, {3}}}", b"RECORD_BYTES = 0",
    b"SCALING_FACTOR = 1E999999999", b"EXPOSURE_DURATION = 1E999999999 <S>", b"1.5 <", b"12:34:60", b"0001-01-01T00:00",
    b"LINES = 5 <m>", b"LINES = {5}", b"^IMAGE = 1.5", b"BANDS = 0", b"EXPOSURE_DURATION = -1", b"NaN", b"sNaN",
    b"START_TIME = 0001-01-01T00:00:00+23:59", b"1E99999999999999999999",
)  # fmt: skip
LABEL = b"""PDS_VERSION_ID = PDS3\r
RECORD_BYTES = 512\r
^IMAGE = ("A.IMG", 1 <BYTES>)\r
INSTRUMENT_ID = "AMICA"\r
START_TIME = 2005-10-01T03:04:05.25\r
EXPOSURE_DURATION = .0218 <SECOND>\r
OBJECT = IMAGE\r
  LINES = 5\r
  LINE_SAMPLES = 7\r
  SAMPLE_TYPE = MSB_INTEGER\r
  SAMPLE_BITS = 16\r
  SCALING_FACTOR = 0.5\r
  MISSING_CONSTANT = -32768\r
END_OBJECT = IMAGE\r
END\r
"""
_ATTACHED = LABEL.replace(b'("A.IMG", 1 <BYTES>)', b"339 <BYTES>")
_POSES = b"""file,time_s,ref_qw,ref_qx,ref_qy,ref_qz,ref_tx_m,ref_ty_m,ref_tz_m,sun_body_x,sun_body_y,sun_body_z
a.png,0,1,0,0,0,0,0,2000,1,0,0
b.png,60.5,0.6,0.8,0,0,1e2,-3.5,2000,0,1,0
"""


def _encoded(suffix: str, dtype: type = np.uint8) -> bytes:
    return cv2.imencode(suffix, _PIXELS.astype(dtype))[1].tobytes()


def _bitmap(name: str, with_checksums: bool, content: bytes, folder: Path) -> object:
    (folder / name).write_bytes(recipes.png(content) if with_checksums else content)
    return read_image(folder / name)


def _opened(path: Path) -> object:
    product = open_product(path)
    return product.metadata(), product.size_px, product.pixels()


def _product(name: str):
    def read(content: bytes, folder: Path) -> object:
        (folder / name).write_bytes(content)
        return _opened(folder / name)

    return read


def _fits(content: bytes, folder: Path) -> object:
    return _product("x.fits")(recipes.fits_file(content), folder)


def _label(content: bytes, folder: Path) -> object:
    (folder / "a.img").write_bytes(struct.pack(">35h", *range(35)))
    return _product("a.lbl")(content, folder)


def _table(content: bytes, folder: Path) -> object:
    (folder / "poses.csv").write_bytes(content)
    return read_table(folder / "poses.csv", ("ref",))


def _fits_files() -> tuple[bytes, ...]:
    plain, packed = io.BytesIO(), io.BytesIO()
    header = fits.Header({"DATE-OBS": "2005-10-01T03:04:05", "EXPTIME": 0.02, "INSTRUME": "AMICA", "BUNIT": "DN"})
    fits.PrimaryHDU(_PIXELS, header).writeto(plain)
    image = fits.CompImageHDU(_PIXELS.astype(np.int16), compression_type="RICE_1")
    fits.HDUList([fits.PrimaryHDU(), image]).writeto(packed)
    return plain.getvalue(), packed.getvalue()


def _fits_seeds() -> tuple[bytes, ...]:
    """Recipes that give the same files."""
    seeds = []
    for content in _fits_files():
        units = []
        with fits.open(io.BytesIO(content), disable_image_compression=True) as read:
            for unit in read:
                info = unit.fileinfo()
                cards = [content[at : at + 80].rstrip() for at in range(info["hdrLoc"], info["datLoc"], 80)]
                data = content[info["datLoc"] : info["datLoc"] + info["datSpan"]].rstrip(b"\0")
                units.append(b"\n".join(c for c in cards if c not in (b"", b"END")) + b"\ndata\n" + data.hex().encode())
        seeds.append(b"\nunit\n".join(units))
    return tuple(seeds)

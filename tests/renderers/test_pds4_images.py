"""Images with PDS4 labels, written here by struct; broken labels."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from astropy.io import fits

from boresight.renderers.images import PosedImageSet, open_product
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera
from boresight.scenarios.spec.scenario import ImageSetSpec

LINES, SAMPLES = 4, 6
EXPECTED = np.arange(LINES * SAMPLES, dtype=np.float32).reshape(LINES, SAMPLES)
LABEL = """<?xml version="1.0" encoding="UTF-8"?>
<Product_Observational xmlns="http://pds.nasa.gov/pds4/pds/v1" xmlns:disp="http://pds.nasa.gov/pds4/disp/v1"
  xmlns:img="http://pds.nasa.gov/pds4/img/v1">
  <Identification_Area><title>t</title></Identification_Area>
  <Observation_Area>
    <Time_Coordinates><start_date_time>2022-09-26T23:14:12.737Z</start_date_time></Time_Coordinates>
    <Observing_System>
      <name>DART DRACO</name>
      <Observing_System_Component><name>DART</name><type>Host</type></Observing_System_Component>
      <Observing_System_Component><name>DRACO</name><type>Instrument</type></Observing_System_Component>
    </Observing_System>
    <Target_Identification><name>(65803) Didymos</name><type>Asteroid</type></Target_Identification>
    <Discipline_Area>
      <disp:Display_Direction>
        <disp:vertical_display_direction>Bottom to Top</disp:vertical_display_direction>
      </disp:Display_Direction>
      <img:Exposure><img:exposure_duration unit="ms">12.5</img:exposure_duration></img:Exposure>
      <img:Optical_Filter><img:filter_name>clear</img:filter_name></img:Optical_Filter>
    </Discipline_Area>
  </Observation_Area>
  <File_Area_Observational>
    <File><file_name>IMAGE.DAT</file_name></File>
    <Header><offset unit="byte">0</offset><object_length unit="byte">10</object_length>
      <parsing_standard_id>7-Bit ASCII Text</parsing_standard_id></Header>
    <Array_2D_Image>
      <offset unit="byte">10</offset>
      <axes>2</axes>
      <axis_index_order>Last Index Fastest</axis_index_order>
      <Element_Array><data_type>SignedMSB2</data_type><unit>DN</unit></Element_Array>
      <Axis_Array><axis_name>Line</axis_name><elements>4</elements><sequence_number>1</sequence_number></Axis_Array>
      <Axis_Array><axis_name>Sample</axis_name><elements>6</elements><sequence_number>2</sequence_number></Axis_Array>
    </Array_2D_Image>
  </File_Area_Observational>
</Product_Observational>
"""


def packed(code):
    return bytes(10) + struct.pack(f"{code[0]}{LINES * SAMPLES}{code[1]}", *range(LINES * SAMPLES))


def written(folder, *changes, code=">h"):
    """Write label and image with changes of the label; return the label's path."""
    text = LABEL
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "image.dat").write_bytes(packed(code))
    (folder / "a.xml").write_text(text, encoding="utf-8")
    return folder / "a.xml"


@pytest.mark.parametrize(
    ("kind", "code"),
    [
        ("UnsignedByte", ">B"), ("SignedByte", ">b"), ("SignedMSB2", ">h"), ("SignedLSB2", "<h"), ("SignedMSB4", ">i"),
        ("SignedLSB4", "<i"), ("UnsignedMSB2", ">H"), ("UnsignedLSB2", "<H"), ("UnsignedMSB4", ">I"),
        ("UnsignedLSB4", "<I"), ("IEEE754MSBSingle", ">f"), ("IEEE754LSBSingle", "<f"), ("IEEE754MSBDouble", ">d"),
        ("IEEE754LSBDouble", "<d"),
    ],
)  # fmt: skip
def test_samples_of_each_type_are_read(tmp_path, kind, code):
    path = written(tmp_path, ("SignedMSB2", kind), code=code)
    product = open_product(path)
    np.testing.assert_array_equal(product.pixels(), EXPECTED)
    assert product.size_px == (SAMPLES, LINES)
    assert {file.name for file in product.files} == {"a.xml", "image.dat"}


def test_pixels_are_scaled_and_the_metadata_told(tmp_path):
    scaled = "<unit>DN</unit><scaling_factor>0.5</scaling_factor><value_offset>-3e0</value_offset>"
    product = open_product(written(tmp_path, ("<unit>DN</unit>", scaled)))
    np.testing.assert_array_equal(product.pixels(), 0.5 * EXPECTED - 3.0)
    told = product.metadata()
    assert told.start_utc == "2022-09-26T23:14:12.737000"
    assert told.exposure_s == pytest.approx(0.0125)
    assert (told.spacecraft, told.instrument, told.filter) == ("DART", "DRACO", "clear")
    assert (told.target, told.unit, told.line_display) == ("(65803) Didymos", "DN", "up")


def test_a_label_beside_an_image_and_one_of_a_fits_file_are_found(tmp_path):
    written(tmp_path, ("IMAGE.DAT", "a.img")).with_name("image.dat").rename(tmp_path / "a.img")
    np.testing.assert_array_equal(open_product(tmp_path / "a.img").pixels(), EXPECTED)
    folder = tmp_path / "fits"
    folder.mkdir()
    path = written(folder, ("IMAGE.DAT", "b.fits"))
    fits.PrimaryHDU(EXPECTED).writeto(folder / "b.fits")
    product = open_product(path)
    np.testing.assert_array_equal(product.pixels(), EXPECTED)
    assert product.metadata().instrument == "DRACO"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("</Product_Observational>", "", "not a readable PDS4 label"),
        ("Product_Observational", "Bundle", "its root is 'Bundle', not Product_Observational"),
        ("Array_2D_Image", "Array_3D_Image", "has no Array_2D_Image"),
        ("<file_name>IMAGE.DAT</file_name>", "", "file_name: missing"),
        ("IMAGE.DAT", "../x.dat", r"\.\./x\.dat is not in"),
        ("SignedMSB2", "SignedBitString", "data_type: SignedBitString is not read"),
        ("Last Index", "First Index", "axis_index_order: 'First Index Fastest'"),
        (">10</offset>", ">-1</offset>", "offset: '-1' is not a whole number"),
        (">10</offset>", ">9999</offset>", "too short: 4 lines of 12 bytes from byte 9999"),
        ("<elements>4<", "<elements>4.0<", r"elements: '4\.0' is not a whole number"),
        ("<elements>4<", f"<elements>{10**14}<", "pixels are none, or more than"),
        ('<offset unit="byte">10', '<offset unit="kB">10', "offset: its unit is kB, not byte"),
        ('<offset unit="byte">10', "<offset>10", "offset: its unit is missing, not byte"),
        ("<sequence_number>2<", "<sequence_number>3<", "of 2 axes, sequence_number 1 is Line and 2 is missing"),
        (">Line<", ">Band<", "1 is Band and 2 is Sample: only images that are stored line by line"),
        ("<unit>DN</unit>", "<scaling_factor>x</scaling_factor>", "scaling_factor: 'x' is not a number"),
        ("<unit>DN</unit>", "<scaling_factor>nan</scaling_factor>", "is not a finite number of any use"),
        *(
            (
                "</Array_2D",
                f"<Special_Constants><{name}>7</{name}></Special_Constants></Array_2D",
                rf"1 pixels are marked as missing \({name.upper()} = 7\)",
            )
            for name in ("missing_constant", "invalid_constant", "saturated_constant", "low_instrument_saturation")
        ),
    ],
)
def test_a_label_that_cannot_be_used_is_one_line(tmp_path, old, new, message):
    path = written(tmp_path, (old, new))
    with pytest.raises(BoresightError, match=message) as refused:
        open_product(path).pixels()
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("kind", "code", "bits"),
    [("IEEE754MSBSingle", ">f", "40E00000"), ("IEEE754LSBDouble", "<d", "401C000000000000"), ("SignedMSB2", ">h", "7")],
)
def test_a_missing_pixel_may_be_told_by_its_bits(tmp_path, kind, code, bits):
    special = f"<Special_Constants><missing_constant>16#{bits}#</missing_constant></Special_Constants></Array_2D"
    path = written(tmp_path, ("SignedMSB2", kind), ("</Array_2D", special), code=code)
    with pytest.raises(BoresightError, match=r"1 pixels are marked as missing \(MISSING_CONSTANT = 7\)"):
        open_product(path).pixels()


def test_a_scale_is_no_pattern_of_bits(tmp_path):
    path = written(tmp_path, ("<unit>DN</unit>", "<scaling_factor>16#40000000#</scaling_factor>"))
    with pytest.raises(BoresightError, match="scaling_factor: '16#40000000#' is not a number"):
        open_product(path).pixels()


def test_an_image_to_be_displayed_from_right_to_left_is_refused(tmp_path):
    path = mission_product(tmp_path, *TYPES[0])
    path.write_text(path.read_text().replace("Left to Right", "Right to Left"))
    with pytest.raises(BoresightError, match="horizontal_display_direction: 'Right to Left' is not read"):
        open_product(path)


def test_an_image_that_is_stored_by_columns_is_refused(tmp_path):
    """Sample may be the first axis (PDS4_PDS.sch, Array_2D_Image): with Last Index Fastest lines are then columns."""
    path = written(tmp_path, (">Line<", ">?<"), (">Sample<", ">Line<"), (">?<", ">Sample<"))
    with pytest.raises(BoresightError, match="1 is Sample and 2 is Line: only images that are stored line by line"):
        open_product(path)


# As missions write them: prefixes, several areas and arrays, a display for each array.
MISSION = """<?xml version="1.0" encoding="utf-8"?>
<?xml-model href="https://pds.nasa.gov/pds4/pds/v1/PDS4_PDS_1G00.sch"
  schematypens="http://purl.oclc.org/dsdl/schematron"?>
<pds:Product_Observational xmlns:pds="http://pds.nasa.gov/pds4/pds/v1" xmlns:disp="http://pds.nasa.gov/pds4/disp/v1"
  xmlns:img="http://pds.nasa.gov/pds4/img/v1" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"
  xsi:schemaLocation="http://pds.nasa.gov/pds4/pds/v1 https://pds.nasa.gov/pds4/pds/v1/PDS4_PDS_1G00.xsd">
  <pds:Identification_Area>
    <pds:logical_identifier>urn:nasa:pds:mission:data:image</pds:logical_identifier>
    <pds:version_id>1.0</pds:version_id><pds:title>Image &amp; backplane</pds:title>
    <pds:information_model_version>1.16.0.0</pds:information_model_version>
    <pds:product_class>Product_Observational</pds:product_class>
  </pds:Identification_Area>
  <pds:Observation_Area>
    <pds:Time_Coordinates>
      <pds:start_date_time>2022-09-26T23:14:12.737Z</pds:start_date_time>
      <pds:stop_date_time>2022-09-26T23:14:12.750Z</pds:stop_date_time>
    </pds:Time_Coordinates>
    <pds:Observing_System>
      <pds:Observing_System_Component>
        <pds:name>DART</pds:name><pds:type>Host</pds:type>
      </pds:Observing_System_Component>
    </pds:Observing_System>
    <pds:Target_Identification><pds:name>Didymos</pds:name><pds:type>Asteroid</pds:type></pds:Target_Identification>
    <pds:Discipline_Area>
      DISPLAYS
    </pds:Discipline_Area>
  </pds:Observation_Area>
  <pds:File_Area_Observational>
    <pds:File><pds:file_name>header.txt</pds:file_name><pds:file_size unit="byte">10</pds:file_size></pds:File>
    <pds:Header><pds:offset unit="byte">0</pds:offset><pds:object_length unit="byte">10</pds:object_length>
      <pds:parsing_standard_id>7-Bit ASCII Text</pds:parsing_standard_id></pds:Header>
  </pds:File_Area_Observational>
  <pds:File_Area_Observational>
    <pds:File><pds:file_name>image.dat</pds:file_name></pds:File>
    ARRAYS
  </pds:File_Area_Observational>
  <pds:File_Area_Observational_Supplemental>
    <pds:File><pds:file_name>header.txt</pds:file_name></pds:File>
    <pds:Header><pds:offset unit="byte">0</pds:offset><pds:object_length unit="byte">10</pds:object_length>
      <pds:parsing_standard_id>7-Bit ASCII Text</pds:parsing_standard_id></pds:Header>
  </pds:File_Area_Observational_Supplemental>
</pds:Product_Observational>
"""
DISPLAY = """<disp:Display_Settings>
        <pds:Local_Internal_Reference>
          <pds:local_identifier_reference>{name}</pds:local_identifier_reference>
          <pds:local_reference_type>display_settings_to_array</pds:local_reference_type>
        </pds:Local_Internal_Reference>
        <disp:Display_Direction>
          <disp:horizontal_display_axis>Sample</disp:horizontal_display_axis>
          <disp:horizontal_display_direction>Left to Right</disp:horizontal_display_direction>
          <disp:vertical_display_axis>Line</disp:vertical_display_axis>
          <disp:vertical_display_direction>{down}</disp:vertical_display_direction>
        </disp:Display_Direction>
      </disp:Display_Settings>"""
ARRAY = """<pds:Array_2D_Image>
      <pds:name>{name}</pds:name><pds:local_identifier>{name}</pds:local_identifier>
      <pds:offset unit="byte">{offset}</pds:offset><pds:axes>2</pds:axes>
      <pds:axis_index_order>Last Index Fastest</pds:axis_index_order>
      <pds:Element_Array><pds:data_type>{kind}</pds:data_type>
        <pds:scaling_factor>0.25</pds:scaling_factor><pds:value_offset>100</pds:value_offset></pds:Element_Array>
      <pds:Axis_Array><pds:axis_name>Line</pds:axis_name><pds:elements>4</pds:elements>
        <pds:sequence_number>1</pds:sequence_number></pds:Axis_Array>
      <pds:Axis_Array><pds:axis_name>Sample</pds:axis_name><pds:elements>6</pds:elements>
        <pds:sequence_number>2</pds:sequence_number></pds:Axis_Array>
    </pds:Array_2D_Image>"""


def mission_product(folder, kind, code):
    """Write a product as missions do, with two arrays in a file; return the path of its label."""
    arrays = [ARRAY.format(name="image", offset=10, kind=kind), ARRAY.format(name="backplane", offset=0, kind=kind)]
    (folder / "header.txt").write_bytes(b"SIMPLE = T")
    (folder / "image.dat").write_bytes(packed(code))
    displays = [
        DISPLAY.format(name="backplane", down="Top to Bottom"),
        DISPLAY.format(name="image", down="Bottom to Top"),
    ]
    label = MISSION.replace("DISPLAYS", "\n      ".join(displays)).replace("ARRAYS", "\n    ".join(arrays))
    (folder / "m.xml").write_text(label, encoding="utf-8")
    return folder / "m.xml"


TYPES = [("UnsignedByte", ">B"), ("SignedMSB2", ">h"), ("UnsignedLSB2", "<H"), ("IEEE754LSBSingle", "<f")]


@pytest.mark.parametrize(("kind", "code"), TYPES)
def test_a_label_as_missions_write_it_is_read(tmp_path, kind, code):
    product = open_product(mission_product(tmp_path, kind, code))
    np.testing.assert_array_equal(product.pixels(), 0.25 * EXPECTED + 100.0)
    told = product.metadata()
    assert (told.spacecraft, told.target, told.line_display) == ("DART", "Didymos", "up")


@pytest.mark.parametrize(("kind", "code"), TYPES)
def test_pixels_are_those_of_another_reader(tmp_path, kind, code):
    pds4_tools = pytest.importorskip("pds4_tools", reason="pds4_tools is not installed")
    path = mission_product(tmp_path, kind, code)
    foreign = pds4_tools.read(str(path), quiet=True)["image"].data
    np.testing.assert_array_equal(open_product(path).pixels(), np.asarray(foreign, dtype=np.float32))


@pytest.mark.parametrize(
    ("exposure", "message"), [("soon", "'soon' is not a number"), ("-1", "is not a number of at least 0")]
)
def test_an_exposure_that_is_none_is_refused(tmp_path, exposure, message):
    product = open_product(written(tmp_path, (">12.5<", f">{exposure}<")))
    with pytest.raises(BoresightError, match=message):
        product.metadata()


def test_an_exposure_of_an_unknown_unit_is_refused(tmp_path):
    with pytest.raises(BoresightError, match="fortnight is not a unit of time"):
        open_product(written(tmp_path, ('unit="ms"', 'unit="fortnight"'))).metadata()


ENTITIES = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa">' + "".join(
    f'<!ENTITY {new} "{f"&{old};" * 10}">' for old, new in zip("abcdefghi", "bcdefghij", strict=True)
)


def test_entities_do_not_expand_without_bounds(tmp_path):
    """Of these, j is 10 GB; declared and not used, it does no harm."""
    declared = ("<Product_Obs", f"{ENTITIES}]><Product_Obs")
    np.testing.assert_array_equal(open_product(written(tmp_path, declared)).pixels(), EXPECTED)
    with pytest.raises(BoresightError, match="not a readable PDS4 label"):
        open_product(written(tmp_path, declared, ("<title>t", "<title>&j;")))


def test_a_set_with_a_table_of_poses_has_images_of_the_pds(tmp_path):
    path = written(tmp_path)
    columns = {"file": "a.xml", "time_s": 0, "ref_qw": 1, "ref_qx": 0, "ref_qy": 0, "ref_qz": 0}
    columns |= {"ref_tx_m": 0, "ref_ty_m": 0, "ref_tz_m": 900, "sun_body_x": 0, "sun_body_y": 0, "sun_body_z": 1}
    text = "\n".join(",".join(map(str, line)) for line in (columns, columns.values()))
    (tmp_path / "poses.csv").write_text(text)
    images = PosedImageSet.open(
        ImageSetSpec(folder=str(tmp_path), truth="ref"), Camera.from_fov(SAMPLES, LINES, np.radians(5.0))
    )
    np.testing.assert_array_equal(images.image(0), EXPECTED)
    # Both files decide: the label, and the pixels.
    digests = [images.content_digest()]
    path.write_text(path.read_text().replace("DRACO", "LUKE"))
    digests.append(images.content_digest())
    (tmp_path / "image.dat").write_bytes(packed(">h")[:-1] + b"\0")
    digests.append(images.content_digest())
    assert len(set(digests)) == 3
    path.write_text("<a/>")
    with pytest.raises(BoresightError, match="not a PDS4 label"):
        images.image(0)

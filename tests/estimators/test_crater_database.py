"""Numbering of craters, their positions, and the files: against scipy's connected components and written values."""

from __future__ import annotations

import numpy as np
import pytest
from crater_looks import ellipsoid, look, pair, population, turned
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from boresight.estimators.craters.contract import CraterMatches
from boresight.estimators.craters.database.build import build_database
from boresight.estimators.craters.database.files import (
    LANDMARKS,
    PICTURES,
    CraterDatabase,
    read_landmarks,
    read_pictures,
)
from boresight.estimators.craters.database.landmarks import NO_NUMBER, PairMatches, number_craters
from boresight.estimators.registry import crater_matcher_class
from boresight.scenarios.craters.simulated import NO_CRATER
from boresight.scenarios.errors import BoresightError


@pytest.fixture(scope="module")
def ground():
    return ellipsoid()


@pytest.fixture(scope="module")
def craters(ground):
    return population(ground, 3)


def _matched(first: int, second: int, *pairs: tuple[int, int], score: float = 1.0) -> PairMatches:
    rows = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    return PairMatches(first, second, CraterMatches(rows, np.full(len(rows), score)))


def test_numbers_are_the_connected_parts_of_the_graph_of_matches() -> None:
    rng = np.random.default_rng(1)
    truth = [rng.permutation(30)[:12] for _ in range(6)]
    found, edges = [], []
    for i in range(6):
        for j in range(i + 1, 6):
            _, here, there = np.intersect1d(truth[i], truth[j], return_indices=True)
            kept = rng.uniform(size=len(here)) < 0.4
            found.append(_matched(i, j, *zip(here[kept], there[kept], strict=True)))
            edges += [(12 * i + a, 12 * j + b) for a, b in zip(here[kept], there[kept], strict=True)]
    numbering = number_craters([12] * 6, found)
    a, b = np.array(edges).T
    _, parts = connected_components(coo_matrix((np.ones(len(a)), (a, b)), shape=(72, 72)), directed=False)
    numbers = np.concatenate(numbering.numbers)
    sizes = np.bincount(parts)[parts]
    np.testing.assert_array_equal(numbers == NO_NUMBER, sizes == 1)
    for one in range(72):
        same = (numbers == numbers[one]) & (numbers[one] != NO_NUMBER)
        np.testing.assert_array_equal(same, (parts == parts[one]) & (sizes[one] > 1))
    assert numbering.conflicts == 0
    assert numbering.count == len(np.unique(parts[sizes > 1]))
    np.testing.assert_array_equal(numbering.hits(), np.bincount(numbers[numbers >= 0]))


def test_a_match_that_would_give_an_image_one_number_twice_is_refused_and_counted() -> None:
    right = [_matched(0, 1, (0, 0), (1, 1)), _matched(1, 2, (0, 0), (1, 1)), _matched(0, 2, (0, 0), (1, 1))]
    wrong = _matched(2, 3, (0, 0), score=0.5), _matched(0, 3, (1, 0), score=0.4)
    numbering = number_craters([2, 2, 2, 1], [*wrong, *right])
    assert numbering.conflicts == 1
    for numbers in numbering.numbers:
        assert len(np.unique(numbers)) == len(numbers)
    np.testing.assert_array_equal(np.concatenate(numbering.numbers), [0, 1, 0, 1, 0, 1, 0])


def test_matches_of_nothing_are_refused() -> None:
    with pytest.raises(BoresightError, match="there are 2 images"):
        number_craters([1, 1], [_matched(0, 2, (0, 0))])
    with pytest.raises(BoresightError, match="name a detection"):
        number_craters([1, 1], [_matched(0, 1, (0, 1))])
    assert number_craters([], []).count == 0
    assert number_craters([3, 0], []).count == 0


@pytest.fixture(scope="module")
def built(ground, craters):
    rng = np.random.default_rng(5)
    first, second = pair(ground, craters, 1, 10.0, 10.0)
    pose = first.image.frame.prior_T_cam_body
    towards = -pose.rotation[2]
    target = pose.camera_position_m - 200e3 * towards
    sun = first.image.frame.prior_T_cam_body.rotation.T @ first.image.frame.sun_dir_cam
    third = look(2, ground, craters, target, (turned(towards, 8.0, 1.0), sun), rng)
    looks = [first, second, third]
    images = [one.image for one in looks]
    return looks, build_database(images, crater_matcher_class("vote").from_options({}), ground)


def test_a_data_base_has_each_crater_once_and_near_its_place(built, craters) -> None:
    looks, result = built
    landmarks = result.database.landmarks
    assert len(landmarks) >= 8
    truth = np.full(len(landmarks), NO_CRATER)
    for one, numbers in zip(looks, result.numbering.numbers, strict=True):
        assert len(np.unique(numbers[numbers >= 0])) == (numbers >= 0).sum()
        for number, crater in zip(numbers, one.crater, strict=True):
            if number >= 0:
                truth[np.searchsorted(landmarks.number, number)] = crater
    assert len(np.unique(truth)) == len(truth)
    errors = landmarks.position_body_m - craters.centre_body_m[truth]
    d2 = np.einsum("ni,nij,nj->n", errors, np.linalg.inv(landmarks.covariance_m2), errors)
    # The images' priors are common to all craters: the mean of 3 degrees of freedom scatters with 2 or 3 draws alone.
    assert d2.mean() < 12.0
    np.testing.assert_allclose(landmarks.radius_m, craters.radius_m[truth], rtol=0.25)
    np.testing.assert_array_equal(landmarks.images, result.numbering.hits())


def test_files_are_read_back_exactly(built, tmp_path) -> None:
    database = built[1].database
    database.save(tmp_path)
    back = CraterDatabase.load(tmp_path)
    for name in ("number", "position_body_m", "normal_body", "radius_m", "covariance_m2", "images"):
        np.testing.assert_array_equal(getattr(back.landmarks, name), getattr(database.landmarks, name))
    for one, other in zip(back.pictures, database.pictures, strict=True):
        assert (one.number, one.time_s, one.camera) == (other.number, other.time_s, other.camera)
        np.testing.assert_array_equal(one.T_cam_body.rotation, other.T_cam_body.rotation)
        np.testing.assert_array_equal(one.T_cam_body.translation_m, other.T_cam_body.translation_m)
        np.testing.assert_array_equal(one.sun_dir_cam, other.sun_dir_cam)
        np.testing.assert_array_equal(one.landmark, other.landmark)
        np.testing.assert_array_equal(one.ellipses.centre_px, other.ellipses.centre_px)
        np.testing.assert_array_equal(one.ellipses.semi_axes_px, other.ellipses.semi_axes_px)
        np.testing.assert_array_equal(one.ellipses.angle_rad, other.ellipses.angle_rad)
    assert sorted(path.name for path in tmp_path.iterdir()) == [LANDMARKS, PICTURES]


def _changed(path, line: int, text: str) -> None:
    lines = path.read_text().splitlines()
    lines[line - 1] = text
    path.write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize(("file", "change", "said"), [
    (LANDMARKS, lambda lines: lines[1], r"landmarks.txt:3: landmark 0 is listed twice"),
    (LANDMARKS, lambda lines: "landmark 7 1 2", r"landmarks.txt:3: a landmark has 15 fields, not 3"),
    (LANDMARKS, lambda lines: lines[2].replace(" ", " nan ", 2).rsplit(" ", 2)[0], r"landmarks.txt:3: field"),
    (LANDMARKS, lambda lines: "crater 7", r"landmarks.txt:3: 'crater' is no kind of record"),
    (PICTURES, lambda lines: lines[1].replace("picture 0", "picture x"), r"pictures.txt:3: field 1 of the picture"),
    (PICTURES, lambda lines: lines[1], r"pictures.txt:3: picture 0 is listed twice"),
    (PICTURES, lambda lines: lines[3], r"pictures.txt:4: landmark \d+ is listed twice in picture 0"),
    (PICTURES, lambda lines: lines[2].replace("sighting 0", "sighting 9"), r"pictures.txt:3: a sighting of picture 9"),
])  # fmt: skip
def test_a_wrong_line_is_one_clear_error(built, tmp_path, file, change, said) -> None:
    built[1].database.save(tmp_path)
    path = tmp_path / file
    _changed(path, 3, change(path.read_text().splitlines()))
    with pytest.raises(BoresightError, match=said) as raised:
        CraterDatabase.load(tmp_path)
    assert "\n" not in str(raised.value)


def test_files_that_are_missing_or_of_another_format_are_refused(built, tmp_path) -> None:
    with pytest.raises(BoresightError, match="cannot be read"):
        read_landmarks(tmp_path / "nothing.txt")
    (tmp_path / "other.txt").write_text("number,x,y\n")
    with pytest.raises(BoresightError, match=r"other.txt:1: the first line is not"):
        read_pictures(tmp_path / "other.txt")
    built[1].database.save(tmp_path)
    path = tmp_path / LANDMARKS
    path.write_text("\n".join(path.read_text().splitlines()[:-1]) + "\n")
    with pytest.raises(BoresightError, match="which has no position"):
        CraterDatabase.load(tmp_path)

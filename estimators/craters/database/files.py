"""The text files of crater navigation: detections, matches, picture sequence and landmarks.

All are in metres, seconds, radians and pixels ((u, v) = column and row; the centre of the first is at 0.5), one record
a line, first its kind, then its fields, separated by spaces. Numbers are written as Python's ``repr``, the shortest
text that reads back as the same number. A line that begins with ``#`` is a comment; the first one names the format and
its version.

Craters of an image, the most confident first, rows counted from 0::

    # boresight crater detections 1
    image NUMBER TIME REASON
    crater IMAGE ROW U V SEMI_MAJOR SEMI_MINOR ANGLE CONFIDENCE

Matches of pairs of images, by the images' places in the sequence::

    # boresight crater matches 1
    pair FIRST SECOND REASON
    match FIRST SECOND ROW_IN_FIRST ROW_IN_SECOND SCORE

``REASON`` is why nothing was found, its words joined by underscores; ``-`` if there was no obstacle.

Picture sequence of Cheng et al. (2003), in the order of time::

    # boresight picture sequence 1
    picture NUMBER TIME WIDTH HEIGHT FX FY CX CY R11 R12 R13 R21 R22 R23 R31 R32 R33 TX TY TZ SUNX SUNY SUNZ
    sighting PICTURE LANDMARK U V SEMI_MAJOR SEMI_MINOR ANGLE

``R`` and ``T`` take body to camera coordinates; ``SUN`` points to the Sun in camera axes. Sightings follow their
picture.

Landmarks of the same paper, ascending::

    # boresight landmarks of craters 1
    landmark NUMBER X Y Z NX NY NZ RADIUS SXX SXY SXZ SYY SYZ SZZ IMAGES

``X Y Z`` is the a priori location in the body frame, ``N`` the normal of the rim, ``S`` the location's covariance.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from boresight.estimators.craters.contract import CraterDetections, CraterMatches
from boresight.estimators.craters.database.landmarks import Landmarks, PairMatches, SequencePicture
from boresight.scenarios.atomic import write_text
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Ellipses, Pose
from boresight.scenarios.reading import LARGEST_NUMBER, number_in

_MAX_DIGITS = 18  # more may not fit 64 bits


@dataclass(frozen=True, slots=True)
class TextRecord:
    """A line of a file: its place, its kind and its fields."""

    path: Path
    line: int
    kind: str
    fields: tuple[str, ...]

    def error(self, what: str) -> BoresightError:
        """Return an error whose message begins with the file and line."""
        return BoresightError(f"{self.path}:{self.line}: {what}")

    def integer(self, field: int) -> int:
        """Read a field as a non-negative integer."""
        text = self.fields[field]
        if not text.isdecimal() or len(text) > _MAX_DIGITS:
            raise self.error(
                f"field {field + 1} of the {self.kind} is {text!r}, not a whole number of at most {_MAX_DIGITS} digits"
            )
        return int(text)

    def numbers(self, first: int, last: int) -> list[float]:
        """Read fields ``first`` to before ``last`` as finite numbers."""
        values = []
        for field in range(first, last):
            value = number_in(self.fields[field])
            if not abs(value) <= LARGEST_NUMBER:
                raise self.error(
                    f"field {field + 1} of the {self.kind} is {self.fields[field]!r}, not a finite number of any use"
                )
            values.append(value)
        return values


def write_records(path: Path, head: str, lines: Iterable[str]) -> None:
    """Write a file whole or not at all; raise BoresightError if it cannot be written."""
    write_text(path, "".join(f"{line}\n" for line in (f"# {head}", *lines)))


def read_records(path: Path, head: str, fields: Mapping[str, int]) -> Iterator[TextRecord]:
    """Read the records of a file; ``fields`` gives the number of fields of each kind.

    Raise BoresightError if the file cannot be read, is of another format, or a line is of an unknown kind or length.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise BoresightError(f"{path}: cannot be read: {error}") from error
    if not lines or lines[0] != f"# {head}":
        raise BoresightError(f"{path}:1: the first line is not '# {head}'")
    for number, line in enumerate(lines[1:], start=2):
        parts = line.split()
        if not parts or parts[0].startswith("#"):
            continue
        record = TextRecord(path, number, parts[0], tuple(parts[1:]))
        if record.kind not in fields:
            raise record.error(f"{record.kind!r} is no kind of record; there are: {', '.join(sorted(fields))}")
        if len(record.fields) != fields[record.kind]:
            wanted = fields[record.kind]
            raise record.error(f"a {record.kind} has {wanted} fields, not {len(record.fields)}")
        yield record


def format_record(*values: str | float) -> str:
    """Format values as one line: integers and texts as they are, other numbers exactly."""
    return " ".join(str(v) if isinstance(v, int | str) else repr(float(v)) for v in values)


PICTURES, LANDMARKS = "pictures.txt", "landmarks.txt"
_SEQUENCE_HEAD = "boresight picture sequence 1"
_LANDMARK_HEAD = "boresight landmarks of craters 1"
_MATCHES_HEAD = "boresight crater matches 1"
_DETECTIONS_HEAD = "boresight crater detections 1"
_UPPER = np.triu_indices(3)  # rows and columns of the stored covariance elements


@dataclass(frozen=True, slots=True, eq=False)
class ImageDetections:
    """The craters found in an image; ``reason`` is why it could not be searched, '' if it was."""

    number: int
    time_s: float
    detections: CraterDetections
    reason: str = ""


def write_detections(path: Path, image: ImageDetections) -> None:
    """Write the craters of an image, whole or not at all."""
    rims = image.detections.ellipses
    lines = [format_record("image", image.number, image.time_s, "_".join(image.reason.split()) or "-")]
    for row, (centre, axes, angle, confidence) in enumerate(
        zip(rims.centre_px, rims.semi_axes_px, rims.angle_rad, image.detections.confidence, strict=True)
    ):
        lines.append(format_record("crater", image.number, row, *centre, *axes, angle, confidence))
    write_records(path, _DETECTIONS_HEAD, lines)


def read_detections(path: Path) -> ImageDetections:
    """Read the craters of an image.

    Raise BoresightError with file and line if a record is malformed, there is not one image, or rows do not count up
    from 0.
    """
    records = list(read_records(path, _DETECTIONS_HEAD, {"image": 3, "crater": 8}))
    if [record.kind for record in records].count("image") != 1 or records[0].kind != "image":
        raise BoresightError(f"{path}: a file of craters has one image, in its first record")
    head, craters = records[0], records[1:]
    number = head.integer(0)
    for row, record in enumerate(craters):
        if (record.integer(0), record.integer(1)) != (number, row):
            raise record.error(f"row {record.integer(1)} of image {record.integer(0)}, not {row} of {number}")
    values = np.array([record.numbers(2, 8) for record in craters]).reshape(-1, 6)
    found = CraterDetections(Ellipses(values[:, :2], values[:, 2:4], values[:, 4]), values[:, 5])
    reason = "" if head.fields[2] == "-" else head.fields[2].replace("_", " ")
    return ImageDetections(number, head.numbers(1, 2)[0], found, reason)


def write_matches(path: Path, found: Sequence[PairMatches]) -> None:
    """Write the matches of pairs of images, whole or not at all."""
    lines = []
    for pair in found:
        images = (pair.first, pair.second)
        lines.append(format_record("pair", *images, "_".join(pair.matches.reason.split()) or "-"))
        for (here, there), score in zip(pair.matches.pairs.tolist(), pair.matches.score, strict=True):
            lines.append(format_record("match", *images, here, there, score))
    write_records(path, _MATCHES_HEAD, lines)


def read_matches(path: Path) -> tuple[PairMatches, ...]:
    """Read the matches of pairs of images.

    Raise BoresightError with file and line if a record is malformed, a match does not follow its pair, or a pair is
    listed twice.
    """
    pairs: list[tuple[TextRecord, list[TextRecord]]] = []
    seen: set[tuple[int, int]] = set()
    for record in read_records(path, _MATCHES_HEAD, {"pair": 3, "match": 5}):
        images = (record.integer(0), record.integer(1))
        if record.kind == "pair":
            if images in seen:
                raise record.error(f"images {images[0]} and {images[1]} are listed twice")
            seen.add(images)
            pairs.append((record, []))
        elif not pairs or (pairs[-1][0].integer(0), pairs[-1][0].integer(1)) != images:
            raise record.error(f"a match of images {images[0]} and {images[1]} does not follow that pair")
        else:
            pairs[-1][1].append(record)
    return tuple(_pair(head, own) for head, own in pairs)


def _pair(head: TextRecord, rows: Sequence[TextRecord]) -> PairMatches:
    pairs = np.array([[row.integer(2), row.integer(3)] for row in rows], dtype=np.int64).reshape(-1, 2)
    score = np.array([row.numbers(4, 5)[0] for row in rows], dtype=np.float64)
    reason = "" if head.fields[2] == "-" else head.fields[2].replace("_", " ")
    return PairMatches(head.integer(0), head.integer(1), CraterMatches(pairs, score, reason))


@dataclass(frozen=True, slots=True, eq=False)
class CraterDatabase:
    """Landmarks, and the pictures that show them.

    Raises BoresightError if a picture shows a landmark that is not in the list.
    """

    pictures: tuple[SequencePicture, ...]
    landmarks: Landmarks

    def __post_init__(self) -> None:
        for picture in self.pictures:
            unknown = np.setdiff1d(picture.landmark, self.landmarks.number)
            if len(unknown):
                raise BoresightError(
                    f"picture {picture.number} shows landmark {int(unknown[0])}, which has no position"
                )

    def save(self, folder: Path) -> None:
        """Write both files to a folder, each whole or not at all."""
        write_pictures(folder / PICTURES, self.pictures)
        write_landmarks(folder / LANDMARKS, self.landmarks)

    @classmethod
    def load(cls, folder: Path) -> CraterDatabase:
        """Read both files of a folder; raise BoresightError with file and line if one is malformed."""
        pictures, landmarks = read_pictures(folder / PICTURES), read_landmarks(folder / LANDMARKS)
        try:
            return cls(pictures, landmarks)
        except BoresightError as error:
            raise BoresightError(f"{folder}: {error}") from error


def write_pictures(path: Path, pictures: Sequence[SequencePicture]) -> None:
    """Write a picture-sequence file."""
    lines = []
    for p in pictures:
        camera = p.camera
        size = (camera.width_px, camera.height_px)
        optics = (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px)
        pose = (*p.T_cam_body.rotation.ravel(), *p.T_cam_body.translation_m)
        lines.append(format_record("picture", p.number, p.time_s, *size, *optics, *pose, *p.sun_dir_cam))
        for number, centre, axes, angle in zip(
            p.landmark, p.ellipses.centre_px, p.ellipses.semi_axes_px, p.ellipses.angle_rad, strict=True
        ):
            lines.append(format_record("sighting", p.number, int(number), *centre, *axes, angle))
    write_records(path, _SEQUENCE_HEAD, lines)


def read_pictures(path: Path) -> tuple[SequencePicture, ...]:
    """Read a picture-sequence file.

    Raise BoresightError with file and line if a record is malformed, a picture is listed twice, or a landmark twice in
    a picture, or a sighting does not follow its picture.
    """
    pictures: list[tuple[TextRecord, list[TextRecord]]] = []
    seen: set[int] = set()
    shown: set[int] = set()
    for record in read_records(path, _SEQUENCE_HEAD, {"picture": 23, "sighting": 7}):
        number = record.integer(0)
        if record.kind == "picture":
            if number in seen:
                raise record.error(f"picture {number} is listed twice")
            seen.add(number)
            shown = set()
            pictures.append((record, []))
            continue
        if not pictures or pictures[-1][0].integer(0) != number:
            raise record.error(f"a sighting of picture {number} does not follow that picture")
        landmark = record.integer(1)
        if landmark in shown:
            raise record.error(f"landmark {landmark} is listed twice in picture {number}")
        shown.add(landmark)
        pictures[-1][1].append(record)
    return tuple(_picture(head, rows) for head, rows in pictures)


def write_landmarks(path: Path, landmarks: Landmarks) -> None:
    """Write a landmark file."""
    upper = landmarks.covariance_m2[:, _UPPER[0], _UPPER[1]]
    values = np.column_stack([landmarks.position_body_m, landmarks.normal_body, landmarks.radius_m, upper])
    lines = [
        format_record("landmark", int(number), *row, int(images))
        for number, row, images in zip(landmarks.number, values, landmarks.images, strict=True)
    ]
    write_records(path, _LANDMARK_HEAD, lines)


def read_landmarks(path: Path) -> Landmarks:
    """Read a landmark file.

    Raise BoresightError with file and line if a record is malformed, a number is listed twice, or numbers do not
    ascend.
    """
    numbers: list[int] = []
    rows: list[list[float]] = []
    images: list[int] = []
    for record in read_records(path, _LANDMARK_HEAD, {"landmark": 15}):
        number = record.integer(0)
        if number in numbers[-1:] or (numbers and number < numbers[-1] and number in numbers):
            raise record.error(f"landmark {number} is listed twice: every crater has one number")
        if numbers and number < numbers[-1]:
            raise record.error(f"landmark {number} comes after {numbers[-1]}: they have to ascend")
        numbers.append(number)
        rows.append(record.numbers(1, 14))
        images.append(record.integer(14))
    values = np.array(rows).reshape(-1, 13)
    covariance = np.empty((len(rows), 3, 3))
    covariance[:, _UPPER[0], _UPPER[1]] = covariance[:, _UPPER[1], _UPPER[0]] = values[:, 7:]
    return Landmarks(
        np.array(numbers, dtype=np.int64),
        values[:, :3],
        values[:, 3:6],
        values[:, 6],
        covariance,
        np.array(images, dtype=np.int64),
    )


def _picture(head: TextRecord, rows: Sequence[TextRecord]) -> SequencePicture:
    values = head.numbers(1, 23)
    width, height = head.integer(2), head.integer(3)
    camera = Camera(width, height, values[3], values[4], values[5], values[6])
    pose = Pose(np.array(values[7:16]).reshape(3, 3), np.array(values[16:19]))
    rims = np.array([row.numbers(2, 7) for row in rows]).reshape(-1, 5)
    return SequencePicture(
        head.integer(0),
        values[0],
        camera,
        pose,
        np.array(values[19:22]),
        np.array([row.integer(1) for row in rows], dtype=np.int64),
        Ellipses(rims[:, :2], rims[:, 2:4], rims[:, 4]),
    )

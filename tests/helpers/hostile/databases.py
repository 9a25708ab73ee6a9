"""Readers of data bases: landmarks, maplets, descriptors, craters, and the weights of the network."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from boresight.campaign.data.named_craters import GAZETTEER, read_gazetteer
from boresight.estimators.craters.contract import CraterDetections, CraterMatches
from boresight.estimators.craters.database.files import (
    CraterDatabase,
    ImageDetections,
    read_detections,
    read_landmarks,
    read_matches,
    read_pictures,
    write_detections,
    write_matches,
)
from boresight.estimators.craters.database.landmarks import Landmarks
from boresight.estimators.craters.database.numbering import PairMatches
from boresight.estimators.craters.database.pictures import SequencePicture
from boresight.estimators.craters.learned.detector import read_network
from boresight.estimators.craters.learned.network import SHAPES
from boresight.estimators.craters.planning import PlannedImage, read_plan, write_plan
from boresight.estimators.descriptors.database import FILE as DESCRIPTORS
from boresight.estimators.descriptors.database import DescriptorDatabase, ViewFeatures
from boresight.estimators.landmark.database import LandmarkDatabase
from boresight.estimators.maplets.database import FILE as MAPLETS
from boresight.estimators.maplets.database import MapletDatabase
from boresight.scenarios.geometry import Camera, Ellipses, Pose
from hostile import recipes
from hostile.target import Target

Written = Callable[[], tuple[bytes, ...]]


def targets() -> dict[str, Target]:
    """Each file of each data base."""
    return {
        **{f"landmarks-{name}": _of_landmarks(name) for name in ("landmarks.csv", "facets.csv", "database.json")},
        "maplets": Target(_archive(MAPLETS, MapletDatabase.load), _maplets, _ARRAYS),
        "maplets-bytes": Target(_laid(MAPLETS, _in_folder(MapletDatabase.load)), _packed(_maplets)),
        "descriptors": Target(_archive(DESCRIPTORS, DescriptorDatabase.load), _descriptors, _ARRAYS),
        "crater-pictures": Target(_laid("pictures.txt", read_pictures), _written(_pictures, "pictures.txt"), _RECORDS),
        "crater-landmarks": Target(
            _laid("landmarks.txt", read_landmarks), _written(_pictures, "landmarks.txt"), _RECORDS
        ),
        "crater-detections": Target(_laid("1.txt", read_detections), _written(_detections, "1.txt"), _RECORDS),
        "crater-matches": Target(_laid("1.txt", read_matches), _written(_matches, "1.txt"), _RECORDS),
        "image-plan": Target(_laid("plan.txt", read_plan), _written(_plan, "plan.txt"), _RECORDS),
        "weights": Target(
            _archive("weights.npz", lambda folder: read_network(folder / "weights.npz")), _weights, _ARRAYS
        ),
        "gazetteer": Target(_gazetteer, lambda: (_CRATERS,)),
    }


_ARRAYS = (
    b"<f8", b"<f4", b">i2", b"|u1", b"|O", b"<U3", b"<c16", b"<M8[s]", b"|V8", b"<i8", b"|S5", b"1000000000,1000000000",
    b"1073741824", b"-1,3", b"0", b"3", b"head", b"heights", b"counts", b"1,1,1,1,1", b"'x'", b"1000000000000",
)  # fmt: skip
_RECORDS = (b"picture", b"sighting", b"landmark", b"match", b"pair", b"image", b"crater", b"# boresight", b"-")
_CRATERS = b"# IAU\nname,lat_deg,lon_east_deg,diam_km\nHimeros,-21,283,10\nPsyche,31.5,95,5.3\n"


def _laid(name: str, read: Callable[[Path], object]) -> Callable[[bytes, Path], object]:
    def lay(content: bytes, folder: Path) -> object:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(content)
        return read(folder / name)

    return lay


def _in_folder(load: Callable[[Path], object]) -> Callable[[Path], object]:
    return lambda path: load(path.parent)


def _archive(name: str, load: Callable[[Path], object]) -> Callable[[bytes, Path], object]:
    lay = _laid(name, _in_folder(load))
    return lambda content, folder: lay(recipes.npz(content), folder)


def _packed(seeds: Written) -> Written:
    return lambda: tuple(recipes.npz(seed) for seed in seeds())


def _written(write: Callable[[Path], None], name: str) -> Written:
    def seeds() -> tuple[bytes, ...]:
        with tempfile.TemporaryDirectory() as folder:
            write(Path(folder))
            return ((Path(folder) / name).read_bytes(),)

    return seeds


def _gazetteer(content: bytes, folder: Path) -> object:
    return _laid(GAZETTEER, lambda _path: read_gazetteer([folder]))(content, folder)


def _of_landmarks(name: str) -> Target:
    """One of the three files is fuzzed, the others are sound."""
    sound: dict[str, bytes] = {}

    def read(content: bytes, folder: Path) -> object:
        if not sound:
            sound.update(_landmark_files())
        for other, text in sound.items():
            (folder / other).write_bytes(content if other == name else text)
        return LandmarkDatabase.load(folder).mesh().volume_m3

    return Target(read, lambda: (_landmark_files()[name],))


def _landmark_files() -> dict[str, bytes]:
    corners = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [-1, -1, -1]])
    facets = np.array([[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]])
    with tempfile.TemporaryDirectory() as folder:
        LandmarkDatabase(corners, np.stack([0.1 * np.eye(3)] * 4), np.full(4, 9), facets, {"a": 1}).save(Path(folder))
        return {path.name: path.read_bytes() for path in Path(folder).iterdir()}


def _unpacked(save: Callable[[Path], None], name: str) -> tuple[bytes, ...]:
    with tempfile.TemporaryDirectory() as folder:
        save(Path(folder))
        with np.load(io.BytesIO((Path(folder) / name).read_bytes())) as stored:
            return (b"\n".join(recipes.array_line(key, stored[key]) for key in stored.files),)


def _maplets() -> tuple[bytes, ...]:
    heights = np.zeros((2, 3, 3))
    maplets = MapletDatabase(np.eye(3)[:2], np.stack([np.eye(3)] * 2), heights, 1.0, heights + 0.5)
    return _unpacked(maplets.save, MAPLETS)


def _descriptors() -> tuple[bytes, ...]:
    x, z = np.eye(3)[[0, 2]]
    seen = [ViewFeatures(x, z, np.eye(3)[:n], np.zeros((n, 32), dtype=np.uint8)) for n in (2, 1)]
    return _unpacked(DescriptorDatabase("orb", tuple(seen)).save, DESCRIPTORS)


def _network(folder: Path) -> object:
    return read_network(folder / "weights.npz")


def _weights() -> tuple[bytes, ...]:
    return (b"\n".join(recipes.array_line(n, np.full(shape, 0.5, np.float32)) for n, shape in SHAPES.items()),)


def _rims(n: int) -> Ellipses:
    return Ellipses(np.full((n, 2), 20.5), np.full((n, 2), 4.0), np.full(n, 0.3))


def _pictures(folder: Path) -> None:
    camera = Camera(64, 48, 100.0, 100.0, 32.0, 24.0)
    pictures: Sequence[SequencePicture] = [
        SequencePicture(
            i, 60.0 * i, camera, Pose(np.eye(3), np.array([0, 0, 9.0])), np.eye(3)[2], np.arange(2), _rims(2)
        )
        for i in range(2)
    ]
    covariance = np.stack([np.eye(3)] * 2)
    landmarks = Landmarks(np.arange(2), np.eye(3)[:2], np.eye(3)[:2], np.ones(2), covariance, np.array([2, 2]))
    CraterDatabase(tuple(pictures), landmarks).save(folder)


def _detections(folder: Path) -> None:
    write_detections(folder / "1.txt", ImageDetections(1, 60.0, CraterDetections(_rims(3), np.array([0.9, 0.8, 0.7]))))


def _matches(folder: Path) -> None:
    found = CraterMatches(np.array([[0, 1], [2, 0]]), np.array([1.0, 0.5]))
    write_matches(folder / "1.txt", [PairMatches(0, 1, found), PairMatches(0, 2, CraterMatches.none("too far"))])


def _plan(folder: Path) -> None:
    write_plan(
        folder / "plan.txt",
        [PlannedImage(i, 60.0 * i, "nadir", np.eye(3)[0], np.eye(3), np.eye(3), np.eye(3)[2]) for i in range(2)],
    )

"""Real images or tracks of a scenario, with poses from a table, SUM files or SPICE kernels."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

from boresight.renderers.images import ImageSet, PosedImageSet, keep_clear, split_survey
from boresight.renderers.mitsuba3.rays import outline_points
from boresight.scenarios.bodies import body_digest, load_body
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.sequences.track_table import TrackTable, track_files, track_files_digest


def images_digest(scenario: LoadedScenario) -> str:
    """Digest the real images or tracks of a scenario; '' if they are rendered or simulated."""
    if scenario.spec.sequence is not None and scenario.spec.sequence.tracks is not None:
        return track_files_digest(scenario.spec.sequence.tracks, scenario.search_dirs)
    return "" if scenario.spec.images is None else _all_images(scenario).content_digest()


def open_images(scenario: LoadedScenario) -> ImageSet:
    """Open the usable real images of a scenario.

    Raise BoresightError if the scenario has none, or a file is missing or wrong.
    """
    # The digests are part of the cache's key, as a file may change under the same name.
    return _usable(scenario, images_digest(scenario), body_digest(scenario.spec.body, scenario.search_dirs))


def open_survey(scenario: LoadedScenario) -> ImageSet:
    """Open the real images of a scenario that are for data bases; raise BoresightError if it has none."""
    spec = scenario.spec.images
    if spec is None or not spec.survey:
        raise BoresightError(f"{scenario.path}: images.survey names no images, but a data base has source: survey")
    return split_survey(_all_images(scenario), spec.survey)[1]


def open_tracks(scenario: LoadedScenario) -> TrackTable | None:
    """Read the real tracks of a scenario; None if it has none.

    Raise `BoresightError` if a file is missing or wrong.
    """
    section = scenario.spec.sequence
    if section is None or section.tracks is None:
        return None
    try:
        return TrackTable.open(section.tracks, scenario.spec.camera.camera().pinhole, scenario.search_dirs)
    except BoresightError as error:
        raise BoresightError(f"{scenario.path}: {error}") from error


def image_files(scenario: LoadedScenario) -> Iterator[tuple[str, Path]]:
    """Yield the files of a scenario's real images or tracks: name in the scenario, and path."""
    spec, sequence = scenario.spec.images, scenario.spec.sequence
    if sequence is not None and sequence.tracks is not None:
        yield from track_files(sequence.tracks, scenario.search_dirs)
    if spec is None:
        return
    images = _all_images(scenario)
    kernels = () if spec.spice is None else spec.spice.kernels
    yield from zip(kernels, images.files, strict=False)
    for path in images.files[len(kernels) :]:
        if spec.adjusted is not None and isinstance(images, PosedImageSet) and path == images.sources[-1]:
            yield spec.adjusted.table, path
            continue
        name = path.relative_to(images.folder).as_posix() if isinstance(images, PosedImageSet) else path.name
        yield f"{spec.folder}/{name}", path


def left_out_notes(scenario: LoadedScenario) -> list[str]:
    """Describe the real images of a scenario that are left out, with the reasons; empty if none are."""
    if scenario.spec.images is None:
        return []
    images = open_images(scenario)
    if not images.left_out:
        return []
    listed = "; ".join(f"{name}: {reason}" for name, reason in images.left_out)
    total = len(images) + len(images.left_out)
    return [f"{scenario.spec.name}: {len(images.left_out)} of {total} images are left out. {listed}"]


@lru_cache(maxsize=4)
def _usable(scenario: LoadedScenario, *_content: str) -> ImageSet:
    images, spec = _all_images(scenario), scenario.spec
    if spec.images is not None and spec.images.survey:
        images, _ = split_survey(images, spec.images.survey)
    if spec.images is None or not spec.images.keep_clear_px:
        return images
    body = load_body(spec.body, scenario.search_dirs)
    return keep_clear(images, outline_points(body.mesh), spec.images.keep_clear_px)


def _all_images(scenario: LoadedScenario) -> ImageSet:
    spec = scenario.spec
    if spec.images is None:
        raise BoresightError(f"{scenario.path}: give either viewpoint or images")
    if spec.images.spice is None:
        return PosedImageSet.open(spec.images, spec.camera.camera(), scenario.search_dirs)
    # Imported here, as most runs need no SPICE.
    from boresight.renderers.spice import SpiceImageSet

    return SpiceImageSet.open(spec.images, spec.camera.camera(), scenario.search_dirs)

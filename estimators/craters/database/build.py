"""From images with their detections to the data base: pairs, matches, numbers, positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from estimators.craters.contract import CraterImage, CraterMatcher, Ground
from estimators.craters.database.files import CraterDatabase
from estimators.craters.database.landmarks import locate_landmarks
from estimators.craters.database.numbering import Numbering, PairMatches, number_craters
from estimators.craters.database.pictures import placed_pictures
from estimators.craters.matching.preliminary import ImagePairs, PreliminaryOptions, preliminary_pairs


@dataclass(frozen=True, slots=True, eq=False)
class BuiltDatabase:
    """A data base, and how it came about.

    Parameters
    ----------
    database
        Landmarks and pictures.
    pairs
        Of images that were matched.
    found
        What the matcher said of each.
    numbering
        Numbers of all detections, also of craters that no image places on the body.
    """

    database: CraterDatabase
    pairs: ImagePairs
    found: tuple[PairMatches, ...]
    numbering: Numbering


def build_database(
    images: Sequence[CraterImage],
    matcher: CraterMatcher,
    ground: Ground,
    options: PreliminaryOptions | None = None,
) -> BuiltDatabase:
    """Match all images that may show the same craters, and number and place what they have in common."""
    options = options or PreliminaryOptions()
    pairs = preliminary_pairs(images, ground, options)
    found = tuple(PairMatches(int(i), int(j), matcher.match(images[i], images[j], ground)) for i, j in pairs.pairs)
    numbering = number_craters([len(image.detections.ellipses) for image in images], found)
    landmarks = locate_landmarks(images, numbering, ground, options.height_sigma_m)
    pictures = placed_pictures(images, numbering, landmarks.number)
    return BuiltDatabase(CraterDatabase(pictures, landmarks), pairs, found, numbering)

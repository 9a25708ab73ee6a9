"""The learned crater detector: ring templates, and a network as verifier and regressor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import as_file, files
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
from pydantic import Field

from boresight.estimators.craters.contract import CraterDetections
from boresight.estimators.craters.detection.classic import ClassicOptions
from boresight.estimators.craters.detection.preparation import PreparedImage, noise_level, prepare_image
from boresight.estimators.craters.detection.refinement import (
    SCALES_PX,
    confidence,
    gradient_scales,
    refine,
    suppress_duplicates,
)
from boresight.estimators.craters.learned.network import (
    OUTPUTS,
    SHAPES,
    Network,
    PatchSource,
    cut_patches,
    ellipses_of,
    rims_from_outputs,
    shape_of,
)
from boresight.estimators.craters.learned.proposals import propose
from boresight.estimators.options import parse_options
from boresight.scenarios.arrays import FloatArray, Image, IndexArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Ellipses
from boresight.scenarios.observation import Frame
from boresight.scenarios.reading import read_arrays
from boresight.scenarios.spec.base import SpecModel

WEIGHTS = "weights.npz"
MIRRORED = np.array([1.0, 1.0, -1.0, 1.0, 1.0, -1.0])  # signs of the outputs where the patch is mirrored

_MIN_MERIT = 0.6  # of the refined rim, equation (4) of Cheng et al. (2003)
_MAX_DISTANCE = 0.25  # of the refined rim from the network's, in radii


def steepest_walls(
    rims: Ellipses, picture: PreparedImage, rounds: int, options: ClassicOptions
) -> tuple[Ellipses, FloatArray]:
    """Return the ellipses on the steepest part of the walls inside of rims (n), and their merits (n,), equation (4).

    They are the rims made smaller, and moved to the nearby maximum of the merit in ``rounds``.
    """
    gap = float(np.sin(np.radians(options.transition_deg)))
    scales = gradient_scales(picture, [s[0] for s in SCALES_PX], [s[1] for s in SCALES_PX], options.softness)
    walls = Ellipses(rims.centre_px, rims.semi_axes_px / options.crest_scale, rims.angle_rad)
    walls = refine(walls, scales, picture.sun_px, gap, rounds)
    return walls, confidence(walls, scales, picture.sun_px, gap)


def blend_with_gradient(seen: Ellipses, picture: PreparedImage, from_px: float, options: ClassicOptions) -> Ellipses:
    """Move rims with a mean radius of at least ``from_px`` halfway to the nearby maximum of the merit, (2) and (3).

    Where the maximum is far away or low, the rim stays as the network placed it.
    """
    rows = np.flatnonzero(seen.radius_px >= from_px)
    if not len(rows):
        return seen
    rims = seen[rows]
    steepest, merit = steepest_walls(rims, picture, options.rounds, options)
    apart = np.linalg.norm(steepest.centre_px - rims.centre_px, axis=1)
    good = (merit > _MIN_MERIT) & (apart < _MAX_DISTANCE * rims.radius_px)
    crest = Ellipses(steepest.centre_px, steepest.semi_axes_px * options.crest_scale, steepest.angle_rad)[good]
    rims, rows = rims[good], rows[good]
    # Halfway in the parameters of `shape_of`: angles of nearly circular rims cannot be averaged themselves.
    shape = 0.5 * (shape_of(rims, picture.sun_px) + shape_of(crest, picture.sun_px))
    middle = ellipses_of(0.5 * (rims.centre_px + crest.centre_px), shape, picture.sun_px)
    centre, axes, angle = seen.centre_px.copy(), seen.semi_axes_px.copy(), seen.angle_rad.copy()
    centre[rows], axes[rows], angle[rows] = middle.centre_px, middle.semi_axes_px, middle.angle_rad
    return Ellipses(centre, axes, angle)


class VerifierOptions(SpecModel):
    """Options of detectors whose rims the network verifies."""

    window_px: float = Field(
        default=20.0, gt=2.0, description="Standard deviation of the window that evens contrast out."
    )
    radius_min_px: float = Field(default=4.5, gt=1.0, description="Least mean radius of a crater.")
    blend_from_px: float = Field(
        default=8.0, gt=0.0, description="Least mean radius of a rim that the gradient of the image helps to place."
    )
    ground_min: float = Field(default=0.75, ge=0.0, le=1.0, description="Least share of a rim that lies on lit ground.")
    confidence_min: float


class LearnedOptions(VerifierOptions):
    """Options of the learned detector."""

    levels: int = Field(
        default=5, ge=1, le=6, description="Levels of the pyramid of templates; each doubles the radii."
    )
    merit_min: float = Field(default=0.3, ge=0.0, lt=1.0, description="Least merit of a ring template's proposal.")
    proposals: int = Field(default=1600, ge=1, description="Most proposals passed to the network.")
    rounds: int = Field(default=3, ge=1, description="How often the network is applied to the remaining proposals.")
    mirror: bool = Field(default=True, description="In the last round, average over mirror images of the patches.")
    confidence_min: float = Field(
        default=0.9848,
        ge=0.0,
        lt=1.0,
        description="Least probability of a crater: that with 4 % of false alarms in tests/training/thresholds.py.",
    )


def each_once(seen: Ellipses, odds: FloatArray, picture: PreparedImage, options: VerifierOptions) -> IndexArray:
    """Return the rows of rims that are large enough and on lit ground, each crater once, the most probable first."""
    keep = (seen.radius_px >= options.radius_min_px) & (picture.on_ground(seen) >= options.ground_min)
    rows = np.flatnonzero(keep)
    return np.asarray(rows[suppress_duplicates(seen[rows], odds[rows], 0.6, 1.6)], dtype=np.int64)


def detections(seen: Ellipses, odds: FloatArray, picture: PreparedImage, options: VerifierOptions) -> CraterDetections:
    """Return the rims with their probabilities, the logistic function of the log odds (n,); large rims are blended."""
    rims = blend_with_gradient(seen, picture, options.blend_from_px, ClassicOptions())
    return CraterDetections.above(options.confidence_min, rims, 1.0 / (1.0 + np.exp(-odds)))


@lru_cache(maxsize=1)
def packaged_network() -> Network:
    """Load the network in this package; raise BoresightError if it is damaged."""
    with as_file(files(__package__ or "") / WEIGHTS) as path:
        return read_network(path)


def read_network(path: Path) -> Network:
    """Read the weights of a network.

    Raise BoresightError if the file is missing or damaged, or its weights do not fit together.
    """
    return Network(read_weights(path, SHAPES))


def read_weights(path: Path, shapes: Mapping[str, tuple[int, ...]]) -> dict[str, Image]:
    """Read weights of given shapes; raise BoresightError if the file is missing or damaged, or shapes differ."""
    try:
        stored = read_arrays(path)
        weights = {name: stored[name].astype(np.float32) for name in shapes}
    except (KeyError, ValueError, IndexError, TypeError, ArithmeticError, MemoryError) as error:
        raise BoresightError(
            f"{path}: the network's weights cannot be read: {error}; install boresight again"
        ) from error
    fit = all(part.shape == shapes[name] and np.isfinite(part).all() for name, part in weights.items())
    if not fit:
        raise BoresightError(
            f"{path}: the network's weights are not finite or of another network; install boresight again"
        )
    return weights


@dataclass(frozen=True, slots=True)
class CraterLearned:
    """Finds craters by ring templates and a small network that decides which rings are craters and corrects their rims.

    The network was trained on rendered ground of its own; its weights are part of the package.

    Use it when
    -----------
    As many craters as possible are wanted, of rendered or similar images.

    It fails when
    -------------
    The image is refused as by ``crater-classic``. Large craters are missed: in 500 images of ``cheng2003-detection`` it
    finds 92.0 % of 11,572 detectable craters, but 75.3 % of those over 60 pixels across. All training images
    are rendered: of real craters it finds 0.27 (Moon) and 0.37 (Mars) at 10 % false alarms, ``crater-heat-map`` 0.43
    and 0.40.

    Cost
    ----
    0.23 s for the image of 537 x 412 pixels of ``boresight craters``.

    Source
    ------
    Ours; large rims are also refined by equations (2) to (4) of Cheng et al. (2003).
    """

    name: ClassVar[str] = "crater-learned"
    version: ClassVar[int] = 3
    options_model: ClassVar[type[SpecModel]] = LearnedOptions

    options: LearnedOptions
    network: Network

    @classmethod
    def from_options(cls, options: Mapping[str, object]) -> Self:
        """Build from a campaign's options; raise BoresightError if one is invalid."""
        return cls(parse_options(LearnedOptions, options, cls.name), packaged_network())

    def detect(self, frame: Frame, camera: Camera) -> CraterDetections:
        """Find rims, the most probable first; the confidence is a probability to the accuracy of the training.

        Raise BoresightError as `prepare_image` does.
        """
        o = self.options
        picture = prepare_image(frame, camera, o.window_px)
        source = PatchSource.of(frame.image, picture, frame.sun_dir_cam, noise_level(frame.image, picture.ground))
        seen = propose(picture, o.levels, o.merit_min, o.proposals).ellipses
        seen, odds = self.refine_proposals(source, seen)
        rows = each_once(seen, odds, picture, o)
        return detections(seen[rows], odds[rows], picture, o)

    def refine_proposals(self, source: PatchSource, seen: Ellipses) -> tuple[Ellipses, FloatArray]:
        """Apply the network repeatedly, each time to the rims that it returned; return the rims, and log odds (n,).

        After each round but the last, duplicates and unlikely rims are dropped.
        """
        odds = np.zeros(len(seen))
        for turn in range(self.options.rounds):
            if len(seen) == 0:
                return seen, odds
            last = turn + 1 == self.options.rounds
            outputs = self.network_outputs(source, seen, mirror=self.options.mirror and last)
            odds = outputs[:, 0]
            seen = rims_from_outputs(seen, outputs[:, 1:], source.sun_px)
            if not last:
                # Proposals of one crater converge to the same rim, so that few are left for the later, equally costly
                # rounds.
                rows = suppress_duplicates(seen, odds, 0.2, 1.2)
                seen, odds = seen[rows[odds[rows] > -4.0]], odds[rows[odds[rows] > -4.0]]
        return seen, odds

    def network_outputs(self, source: PatchSource, seen: Ellipses, mirror: bool) -> FloatArray:
        """Return the outputs (n, OUTPUTS); with ``mirror`` the mean over the patches and their mirror images."""
        if len(seen) == 0:
            return np.zeros((0, OUTPUTS))
        pixels, scalars = cut_patches(source, seen)
        outputs = self.network.forward(pixels, scalars).astype(np.float64)
        if not mirror:
            return outputs
        # Mirrored across the direction of the Sun, a crater is still lit from the same side: the two errors of the
        # network partly cancel in the mean.
        mirrored = self.network.forward(pixels[:, ::-1], scalars).astype(np.float64)
        return np.asarray(0.5 * (outputs + mirrored * MIRRORED), dtype=np.float64)

"""A crater detector for real images: a heat map proposes rims, which a network and the image's gradient verify."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import as_file, files
from typing import ClassVar, Self

import numpy as np
from pydantic import Field

from boresight.estimators.craters.contract import CraterDetections
from boresight.estimators.craters.detection.classic import ClassicOptions
from boresight.estimators.craters.detection.preparation import noise_level, prepare_image
from boresight.estimators.craters.detection.refinement import suppress_duplicates
from boresight.estimators.craters.learned.detector import (
    CraterLearned,
    LearnedOptions,
    VerifierOptions,
    detections,
    each_once,
    packaged_network,
    read_weights,
    steepest_walls,
)
from boresight.estimators.craters.learned.heat_map import SHAPES, HeatMapNetwork, search
from boresight.estimators.craters.learned.network import PatchSource, rims_from_outputs
from boresight.estimators.options import parse_options
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import Camera
from boresight.scenarios.observation import Frame
from boresight.scenarios.spec.base import SpecModel

WEIGHTS = "heat_map.npz"

_CONSTANT, _OF_VERDICT, _OF_HEAT, _OF_MERIT = -1.058, 0.306, 1.028, 6.0


def log_odds(verdict: FloatArray, heat: FloatArray, merit: FloatArray) -> FloatArray:
    """Combine the network's log odds (n,), the heat map's logits (n,) and the merit (n,) of equation (4).

    The weights of the first two were fitted once, on both kinds of synthetic ground that tests/training draws; no
    script of the repository fits them. That of the merit was chosen among 3 to 20 on the Moon's images for choices.
    """
    networks = _OF_VERDICT * np.clip(verdict, -8.0, 12.0) + _OF_HEAT * heat
    return np.asarray(_CONSTANT + networks + _OF_MERIT * merit, dtype=np.float64)


class HeatMapOptions(VerifierOptions):
    """Options of the detector by a heat map."""

    logit_min: float = Field(
        -2.5, ge=-10.0, le=5.0, description="Least logit of the heat map's maxima that are proposed."
    )
    proposals: int = Field(
        4000, ge=1, description="Most maxima of the heat map at each resolution, a factor of 4 apart."
    )
    mirror: bool = Field(True, description="Average the network's outputs over mirror images of the patches.")
    confidence_min: float = Field(
        0.93,
        ge=0.0,
        lt=1.0,
        description="Least probability of a crater: with 2 % of false alarms on rendered ground, 14 % on the Moon.",
    )


@lru_cache(maxsize=1)
def packaged_heat_map() -> HeatMapNetwork:
    """Load the network of the heat map in this package; raise BoresightError if it is damaged."""
    with as_file(files(__package__ or "") / WEIGHTS) as path:
        return HeatMapNetwork(read_weights(path, SHAPES))


@dataclass(frozen=True, slots=True)
class CraterHeatMap:
    """Finds craters by a heat map; the network of ``crater-learned`` and the merit of the gradient verify the rims.

    Both networks were trained on synthetic ground of their own; their weights are part of the package.

    Use it when
    -----------
    Images are real, with craters of a few pixels that overlap, are worn or full of shadow.

    It fails when
    -------------
    The image is refused as by ``crater-classic``, or has a side below 48 pixels. Of its detections 2 % are false in
    rendered images and 14 and 19 % in two sets of the Moon, where many craters have no label
    (docs/papers/craters-real.md): raise ``confidence_min`` where fewer are needed. Of version 1, rims of rendered
    images lie 0.353 px off (median of 155 in 7 images), those of ``crater-learned`` 0.319 px (of 150).

    Cost
    ----
    1.05 s of one core for an image of 537 x 412 pixels (mean of 7, on a busy machine; ``crater-learned``: 0.53 s).

    Source
    ------
    Ours; large rims are also refined by equations (2) to (4) of Cheng et al. (2003).
    """

    name: ClassVar[str] = "crater-heat-map"
    version: ClassVar[int] = 3
    options_model: ClassVar[type[SpecModel]] = HeatMapOptions

    options: HeatMapOptions
    heat_map: HeatMapNetwork
    verifier: CraterLearned

    @classmethod
    def from_options(cls, options: Mapping[str, object]) -> Self:
        """Build from a campaign's options; raise BoresightError if one is invalid."""
        parsed = parse_options(HeatMapOptions, options, cls.name)
        return cls(parsed, packaged_heat_map(), CraterLearned(LearnedOptions(), packaged_network()))

    def detect(self, frame: Frame, camera: Camera) -> CraterDetections:
        """Find rims, the most probable first; the confidence is a probability to the accuracy of the training.

        Raise BoresightError as `prepare_image` does.
        """
        o, outputs_of = self.options, self.verifier.network_outputs
        picture = prepare_image(frame, camera, o.window_px)
        source = PatchSource.of(frame.image, picture, frame.sun_dir_cam, noise_level(frame.image, picture.ground))
        ground = picture.ground.astype(np.float32)
        seen, logit = search(self.heat_map, frame.image, ground, picture.sun_px, o.logit_min, o.proposals)
        rows = suppress_duplicates(seen, logit, 0.3, 1.3)
        seen, logit = seen[rows], logit[rows]
        outputs = outputs_of(source, seen, o.mirror)
        seen = rims_from_outputs(seen, outputs[:, 1:], source.sun_px)
        merit = steepest_walls(seen, picture, 0, ClassicOptions())[1]
        rows = each_once(seen, log_odds(outputs[:, 0], logit, merit), picture, o)
        # The network judges and places rims best from nearby, and few are left: once more.
        outputs = outputs_of(source, seen[rows], o.mirror)
        seen = rims_from_outputs(seen[rows], outputs[:, 1:], source.sun_px)
        odds = log_odds(outputs[:, 0], logit[rows], merit[rows])
        order = np.argsort(-odds, kind="stable")
        return detections(seen[order], odds[order], picture, o)

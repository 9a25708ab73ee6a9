"""The crater detector of Cheng et al. (2003) with its options."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from pydantic import Field

from boresight.estimators.craters.contract import CraterDetections
from boresight.estimators.craters.detection.ellipse_fit import fit_candidates
from boresight.estimators.craters.detection.grouping import RimArc, pair_arcs, rim_arcs, sunward_edges
from boresight.estimators.craters.detection.preparation import EdgePixels, PreparedImage, canny, prepare_image
from boresight.estimators.craters.detection.refinement import (
    SCALES_PX,
    GradientScales,
    confidence,
    gradient_scales,
    refine,
    suppress_duplicates,
)
from boresight.estimators.options import Configured
from boresight.scenarios.geometry import Camera, Ellipses
from boresight.scenarios.observation import Frame
from boresight.scenarios.spec.base import SpecModel


class ClassicOptions(SpecModel):
    """Parameters that the paper leaves open, with units."""

    window_px: float = Field(
        default=20.0, gt=2.0, description="Standard deviation of the window that evens contrast out."
    )
    small_kernel_px: int = Field(
        default=3, ge=3, le=5, multiple_of=1, description="Width of the first Canny pass's kernel."
    )
    large_kernel_px: int = Field(default=9, ge=7, le=15, description="Width of the second Canny pass's kernel.")
    strong_share: float = Field(
        default=0.15, gt=0.0, lt=1.0, description="Share of the ground above Canny's upper threshold."
    )
    weak_ratio: float = Field(default=0.5, gt=0.0, le=1.0, description="Canny's lower threshold over the upper one.")
    sunward_deg: float = Field(
        default=75.0, gt=10.0, lt=90.0, description="Largest angle of a rim's gradient from the Sun."
    )
    bend_deg: float = Field(default=35.0, gt=5.0, lt=90.0, description="Largest turn between neighbours of one edge.")
    turn_deg: float = Field(default=25.0, gt=5.0, lt=120.0, description="Least turn of the normal along a rim edge.")
    arc_points: int = Field(default=5, ge=3, description="Least pixels of a rim edge.")
    radius_min_px: float = Field(default=5.0, gt=1.0, description="Least mean radius of a crater.")
    radius_max_px: float = Field(default=150.0, gt=1.0, description="Largest mean radius of a crater.")
    axis_ratio_min: float = Field(default=0.35, gt=0.0, lt=1.0, description="Least ratio of the axes.")
    transition_deg: float = Field(
        default=30.0, ge=0.0, lt=80.0, description="Arc left out on each side of the lit and shaded ends."
    )
    softness: float = Field(
        default=3.0, ge=0.0, description="Gradients that count half in refinement, over the median one."
    )
    rounds: int = Field(
        default=25, ge=0, description="Most iterations of conjugate gradients; 0 leaves the fit as it is."
    )
    crest_scale: float = Field(
        default=1.06, gt=0.5, lt=2.0, description="Crest's radius over that of the steepest gradient."
    )
    confidence_min: float = Field(
        default=0.9317,
        ge=-1.0,
        lt=1.0,
        description="Least confidence, equation (4): that with 4 % of false alarms in tests/training/thresholds.py.",
    )


@dataclass(frozen=True, slots=True, eq=False)
class DetectionStages:
    """The results of each stage, as in the paper's figure 2.

    ``edges`` are those of the small and the large kernel, figure 2b, ``shaded`` and ``lit`` convex rim edges, figure
    2c, ``refined`` the ellipses of all groups after refinement, and ``detections`` is figure 2d.
    """

    picture: PreparedImage
    edges: tuple[EdgePixels, EdgePixels]
    shaded: tuple[RimArc, ...]
    lit: tuple[RimArc, ...]
    refined: Ellipses
    detections: CraterDetections


class CraterClassic(Configured[ClassicOptions]):
    """Finds craters by pairs of lit and shaded rim edges, an ellipse fit and its refinement, after Cheng et al. (2003).

    Two Canny passes with a small and a large kernel find edges. Edges that are convex towards or away from the Sun are
    paired, ellipses are fitted to the pairs and refined on the gradient of the image, and those of low confidence are
    dropped.

    Use it when
    -----------
    The method of the paper is wanted, or detections must not depend on a training.

    It fails when
    -------------
    Less than 2 % of the image is lit ground, a quarter of the pixels is saturated, or the Sun is along the boresight:
    the image is refused. In 500 images of ``cheng2003-detection`` it finds 40.9 % of 11,572 detectable craters, where
    ``crater-learned`` finds 92.0 %.

    Cost
    ----
    0.20 s for the image of 537 x 412 pixels of ``boresight craters``.

    Source
    ------
    Cheng et al. (2003), section on crater detection, equations (2) to (4); what they leave open is in the options.
    """

    name: ClassVar[str] = "crater-classic"
    version: ClassVar[int] = 3
    options_model = ClassicOptions

    def detect(self, frame: Frame, camera: Camera) -> CraterDetections:
        """Find rims, the most confident first; raise BoresightError as `prepare_image` does."""
        return self.stages(frame, camera).detections

    def stages(self, frame: Frame, camera: Camera) -> DetectionStages:
        """Return the results of each stage; raise BoresightError as `prepare_image` does."""
        o = self.options
        picture = prepare_image(frame, camera, o.window_px)
        # Two passes as in the paper: a small kernel places sharp rims, a large one finds degraded ones.
        small = canny(picture, o.small_kernel_px, o.strong_share, o.weak_ratio)
        large = canny(picture, o.large_kernel_px, o.strong_share, o.weak_ratio)
        shaded, lit = list[RimArc](), list[RimArc]()
        groups = []
        for edges in (small, large):
            one, other, found = self._fit_groups(edges, picture)
            shaded += one
            lit += other
            groups.append(found)
        fitted = Ellipses.joined(groups)
        scales = gradient_scales(picture, [s[0] for s in SCALES_PX], [s[1] for s in SCALES_PX], o.softness)
        refined, detections = self._refine_and_select(fitted, scales, picture)
        return DetectionStages(picture, (small, large), tuple(shaded), tuple(lit), refined, detections)

    def _fit_groups(self, edges: EdgePixels, picture: PreparedImage) -> tuple[list[RimArc], list[RimArc], Ellipses]:
        """Group the edges of one pass into arcs and fit ellipses to their pairs."""
        o = self.options
        rising = sunward_edges(edges, picture, np.radians(o.sunward_deg))
        arcs = rim_arcs(rising, picture, np.radians(o.turn_deg), np.radians(o.bend_deg), o.arc_points)
        shaded = [arc for arc in arcs if not arc.lit]
        lit = [arc for arc in arcs if arc.lit]
        radius = (o.radius_min_px, o.radius_max_px)
        pairs = pair_arcs(shaded, lit, picture, radius)
        return shaded, lit, fit_candidates(pairs, shaded, lit, rising, picture, radius, o.axis_ratio_min)

    def _refine_and_select(
        self, fitted: Ellipses, scales: GradientScales, picture: PreparedImage
    ) -> tuple[Ellipses, CraterDetections]:
        """Refine and rate rims, drop duplicates, and scale them from the steepest gradient out to the crest.

        Return the refined rims, duplicates included, and the detections.
        """
        o = self.options
        gap = float(np.sin(np.radians(o.transition_deg)))
        first = confidence(fitted, scales, picture.sun_px, gap)
        # Both passes and many pairs of arcs find the same rim: near copies are dropped before the costly refinement,
        # and the most confident 120 of the rest go on.
        fitted = fitted[suppress_duplicates(fitted, first, 0.15, 1.15)][:120]
        refined = refine(fitted, scales, picture.sun_px, gap, o.rounds)
        value = confidence(refined, scales, picture.sun_px, gap)
        rows = suppress_duplicates(refined, value, 0.6, 1.6)
        kept = refined[rows]
        # The steepest brightness lies on the inner wall; the true rim is the crest, a little farther out.
        crest = Ellipses(kept.centre_px, kept.semi_axes_px * o.crest_scale, kept.angle_rad)
        return refined, CraterDetections.above(o.confidence_min, crest, value[rows])

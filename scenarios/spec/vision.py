"""Tracks of a sequence: features of rendered images, or a simulated vision layer and its errors."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from boresight.scenarios.spec.base import SpecModel, deviation, optional, rule


class ImageVisionSpec(SpecModel):
    """Features of the scenario's rendered images, matched from frame to frame.

    About an orbit the body does not rotate, so that the images of one revolution are used for all. Trials begin at
    ``starts`` places around the orbit with the same images; every ``starts`` trials the detector noise is drawn again.
    Along a trajectory all trials begin at its first state, each with noise of its own.
    """

    starts: int = Field(6, ge=1, le=360, description="Places around the orbit where trials begin, evenly spaced")
    detector: Literal["surf", "sift", "orb"] = Field("surf", description="What finds and describes features")
    features: int = Field(3000, ge=8, le=20_000, description="Features of an image at most, the strongest first")
    ratio_max: float = Field(
        0.8, gt=0, le=1, description="Distance of a descriptor to the best over that to the second best, at most"
    )
    epipolar: Literal["fundamental", "known-attitude"] = Field(
        "fundamental",
        description="What RANSAC fits to the matches: the fundamental matrix, or the direction of motion alone",
    )
    epipolar_max_px: float = Field(2.0, gt=0, description="Distance of a match from its epipolar line at most")
    carry: Literal["feature", "patch"] = Field(
        "feature",
        description="A track goes on where its feature is matched, or where its first patch is registered",
    )
    guided: bool = Field(
        False,
        description="Seek features where an estimator expects them; each estimator has its own tracks",
    )
    tracks: int = Field(30, ge=3, le=5000, description="Features tracked in each frame, the strongest first")
    growth_max: float = Field(
        1.08,
        gt=1,
        description="A track begins where areas grow or shrink by this factor at most from frame to frame",
    )
    spacing_px: float = Field(0.0, ge=0, description="Distance of a new track from all others at least")
    sigma_px: float = deviation(0.5, "a coordinate that estimators are told", gt=0)


class TrackErrorsSpec(SpecModel):
    """Errors that a tracker of images makes in addition to ``noise_px``: they accumulate from frame to frame.

    Estimators are told ``noise_px``, and of these errors what ``sequence.knowledge`` states.
    """

    walk_px: float = Field(
        0.0, ge=0, description="Standard deviation of a coordinate's random step from frame to frame, of each track"
    )
    contraction: float = Field(
        0.0,
        gt=-0.1,
        lt=0.1,
        description="Share of its distance from the principal point by which each tracked point moves towards it from"
        " frame to frame, the same in all sequences; negative: away from it",
    )
    drift_px: float = Field(
        0.0,
        ge=0,
        description="Standard deviation of each coordinate of a step that all tracked points take from frame to frame,"
        " drawn for a sequence",
    )
    student_t: float | None = Field(
        None,
        gt=2,
        description="Degrees of freedom of noise and steps, of the same standard deviations; left out: normal",
    )


class VisionSpec(SpecModel):
    """A simulated vision layer: section 4 of Delpech et al. (2015).

    The paper prints no image size: its 2 px at 3 sigma are read as those of 1024 px across 30 deg.
    """

    landmarks_per_frame: float = Field(
        15.0, gt=0, le=5000, description="N: mean number of landmarks in a frame; the density is adapted to it"
    )
    count: Literal["average", "constant"] = Field(
        "average", description="N on average over a field that is uniform by chance, or filled up to N in every frame"
    )
    field: Literal["renewed", "fixed"] = Field(
        "renewed",
        description="New landmarks for new tracks, or landmarks for good that are found again as new tracks",
    )
    tracked_share: float = Field(
        0.5, gt=0, lt=1, description="Share of the landmarks in view that are tracked, with field: fixed"
    )
    recognised: float = Field(
        0.0, ge=0, le=1, description="Share of the landmarks found again that are recognised, with field: fixed"
    )
    mistaken: float = Field(
        0.0,
        ge=0,
        lt=1,
        description="Share of the new tracks that are taken for another lost landmark, with field: fixed",
    )
    lit_only: bool = Field(False, description="Only landmarks that the Sun, along the orbit's normal, shines on")
    noise_px: float = deviation(2.0 / 3.0, "a coordinate: 2 px at 3 sigma", ge=0)
    track_errors: TrackErrorsSpec | None = optional(
        "Errors that accumulate along a track; left out: independent noise alone"
    )
    repeatability: float = Field(
        0.9, gt=0, le=1, description="k: share of the landmarks still visible that are tracked over a change of view"
    )
    repeatability_step_deg: float = Field(2.0, gt=0, description="The change of view that k belongs to")
    min_connection: int = Field(3, ge=0, description="Tracks that live on from frame to frame, if as many are visible")
    mismatch_share: float = Field(
        0.0, ge=0, lt=1, description="Share of the tracked points that are seen at the nearest other one"
    )
    outlier_share: float = Field(
        0.0, ge=0, lt=1, description="Share of the tracked points that are seen anywhere in the image"
    )

    @rule
    def _only_a_fixed_field_is_seen_again(self) -> None:
        given = self.stated("tracked_share", "recognised", "mistaken")
        if given and self.field == "renewed":
            raise ValueError(f"{given[0]} has no part in a field that is renewed: say field: fixed, or leave it out")
        if self.field == "fixed" and self.count == "constant":
            raise ValueError("count: constant draws landmarks as they are needed: with field: fixed say count: average")
        if self.recognised + self.mistaken > 1:
            raise ValueError(f"recognised {self.recognised:g} and mistaken {self.mistaken:g} are more than all")

    def survival(self, change_deg: float) -> float:
        """Return the survival probability of a visible track over a change of view: k^(change / step)."""
        return float(self.repeatability ** (change_deg / self.repeatability_step_deg))

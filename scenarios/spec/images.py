"""Image-set section: real images in place of rendered ones."""

from __future__ import annotations

from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from scenarios.spec.base import SpecModel


class ImageSetSpec(SpecModel):
    """Real images with a table of poses and Sun directions in place of rendered ones."""

    prose: ClassVar = frozenset({"credit"})

    folder: str = Field(description="Folder of the images (beside the scenario file, or under BORESIGHT_DATA)")
    table: str = Field("poses.csv", pattern=r"^[^/\\]+$", description="Table of poses in that folder")
    first_row: Literal["top", "bottom"] = Field(
        "top", description="Where the first stored row belongs; FITS images are often stored bottom up"
    )
    truth: str = Field("ref", min_length=1, description="Prefix of the columns that are scored against")
    also_score: tuple[str, ...] = Field((), description="Prefixes of further poses to score against")
    noise_realisations: int = Field(1, ge=1, description="Pose errors drawn for each image")
    credit: str = Field("", description="Credit line that every figure with these images carries")

    @model_validator(mode="after")
    def _prefixes_once(self) -> Self:
        prefixes = (self.truth, *self.also_score)
        twice = sorted({prefix for prefix in prefixes if prefixes.count(prefix) > 1})
        if twice:
            raise ValueError(f"{', '.join(twice)} is named twice in truth and also_score")
        return self

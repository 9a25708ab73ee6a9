"""Image-set section: real images instead of rendered ones."""

from __future__ import annotations

import re
from pathlib import PurePosixPath
from typing import ClassVar, Literal

from pydantic import Field, field_validator

from boresight.scenarios.spec.base import SpecModel, rule
from boresight.scenarios.spec.camera import BodyKernelsSpec, Rectangle


class SpiceSpec(BodyKernelsSpec):
    """Times, poses, Sun and camera from labels and SPICE kernels."""

    instrument: str = Field(min_length=1, description="The camera: hayabusa-amica, near-msi")
    files: str = Field("*.lbl", min_length=1, description="Images in the folder: a pattern of labels or image files")

    @field_validator("files")
    @classmethod
    def _stays_in_the_folder(cls, files: str) -> str:
        path = PurePosixPath(files)
        if path.is_absolute() or ".." in path.parts or "\0" in files or re.search(r"[^/]\*\*|\*\*[^/]", files):
            raise ValueError(f"files: {files!r} is no pattern of files in the folder, such as *.lbl")
        return files


class ImageSetSpec(SpecModel):
    """Real images instead of rendered ones, with poses from a table or from SPICE kernels."""

    prose: ClassVar = frozenset({"credit", "aligned"})

    folder: str = Field(description="Folder of the images (beside the scenario file, or under BORESIGHT_DATA)")
    table: str = Field("poses.csv", pattern=r"^[^/\\]+$", description="Table of poses in that folder")
    first_row: Literal["top", "bottom"] = Field(
        "top", description="Where the first stored row belongs; FITS images are often stored bottom up"
    )
    spice: SpiceSpec | None = Field(None, description="Poses from kernels instead of the table")
    truth: str = Field(
        "ref",
        min_length=1,
        description="Prefix of the columns that are scored against; with spice a name for the kernels' pose",
    )
    also_score: tuple[str, ...] = Field((), description="Prefixes of further poses to score against")
    aligned: tuple[str, ...] = Field(
        (),
        description="Those of truth and also_score that were found by aligning renderings of the shape with the images:"
        " reports say that errors against them are correlated with those of methods that do the same",
    )
    noise_realisations: int = Field(1, ge=1, description="Pose errors drawn for each image")
    keep_clear_px: tuple[Rectangle, ...] = Field(
        (),
        description="Rectangles [left, top, right, bottom] of the detector; images with the body in one are left out",
    )
    credit: str = Field("", description="Credit line that every figure with these images carries")

    @rule
    def _prefixes_once(self) -> None:
        prefixes = (self.truth, *self.also_score)
        twice = sorted({prefix for prefix in prefixes if prefixes.count(prefix) > 1})
        if twice:
            raise ValueError(f"{', '.join(twice)} is named twice in truth and also_score")
        unknown = [name for name in self.aligned if name not in prefixes]
        if unknown:
            raise ValueError(f"aligned names {unknown[0]}, which is neither truth nor in also_score")

    @rule
    def _kernels_leave_no_choice(self) -> None:
        if self.spice is not None:
            given = {"table": self.table != "poses.csv", "first_row": self.first_row != "top"}
            given |= {"also_score": bool(self.also_score)}
            senseless = [key for key, is_given in given.items() if is_given]
            if senseless:
                raise ValueError(f"{', '.join(senseless)} has no meaning beside spice; leave it out")

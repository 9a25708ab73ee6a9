"""Scenario file: body, camera, views, real images or orbit, pose errors, sensors and onboard model."""

from __future__ import annotations

import re
from pathlib import PurePosixPath
from typing import ClassVar, Literal, Self

from pydantic import Field, field_validator, model_validator

from boresight.scenarios.spec.base import SpecModel, optional, rule
from boresight.scenarios.spec.body import BodySpec
from boresight.scenarios.spec.brdf import BrdfSpec, LambertSpec
from boresight.scenarios.spec.camera import BodyKernelsSpec, CameraSpec, DetectorSpec, Rectangle, RenderingSpec
from boresight.scenarios.spec.craters import LISTED_PX, CraterPairsSpec, CratersSpec
from boresight.scenarios.spec.distribution import Choice, Law, Row3
from boresight.scenarios.spec.onboard import OnboardSpec
from boresight.scenarios.spec.orbit import OrbitSpec
from boresight.scenarios.spec.second import SecondBodySpec
from boresight.scenarios.spec.sequence import SequenceSpec
from boresight.scenarios.spec.stars import StarsSpec
from boresight.scenarios.spec.world import PAPER_POSE_ERROR, CorrelatedSpec, LightingSpec, PoseErrorSpec, ViewpointSpec


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


class MovedPosesSpec(SpecModel):
    """Poses of the table with the shape turned and moved in the body axes of the table, the same for all images.

    x_body = R(rotation_vector_deg) x_shape + origin_m: a mission's poses are of its own shape, and another one has its
    axes and its origin elsewhere.
    """

    name: str = Field(min_length=1, description="Name of one's own, for truth and also_score")
    of: str = Field(min_length=1, description="Prefix of the poses in the table")
    rotation_vector_deg: Row3 = Field((0.0, 0.0, 0.0), description="Rotation from the axes of the shape to the table's")
    origin_m: Row3 = Field((0.0, 0.0, 0.0), description="Origin of the shape in the table's body axes")


class AdjustedPosesSpec(SpecModel):
    """Further poses of the same images, with covariances, from a table of their own."""

    name: str = Field(min_length=1, description="Prefix of the columns; a name for truth and also_score")
    table: str = Field(description="Table of the poses (beside the scenario file, or under BORESIGHT_DATA)")


class SumfileSpec(SpecModel):
    """An image and its SUM file of stereophotoclinometry, with its pose, Sun and epoch."""

    image: str = Field(pattern=r"^[^/\\]+$", description="Image in the folder of the set")
    sumfile: str = Field(pattern=r"^[^/\\]+$", description="SUM file in that folder")


class ColmapImageSpec(SpecModel):
    """An image of a model of COLMAP, with what the model does not hold."""

    image: str = Field(
        pattern=r"^[^/\\][^\\]*$", description="Image in the folder of the set; its end is the name in the model"
    )
    sun_body: Row3 = Field(description="Direction to the Sun in the body frame, of any length")
    time_s: float = Field(0.0, ge=-1e12, le=1e12, description="Epoch, where it is known")


class ColmapSpec(SpecModel):
    """Poses of a model of COLMAP (cameras and images, .bin or .txt), which must be in the frame of the shape."""

    unit: Literal["m", "km"] = Field("m", description="Unit of the model's translations")
    images: tuple[ColmapImageSpec, ...] = Field(min_length=1, description="Images of the set")


class ImageSetSpec(SpecModel):
    """Real images instead of rendered ones, with poses from a table, SUM files, a model of COLMAP or SPICE kernels."""

    prose: ClassVar = frozenset({"credit", "aligned"})

    folder: str = Field(description="Folder of the images (beside the scenario file, or under BORESIGHT_DATA)")
    table: str = Field("poses.csv", pattern=r"^[^/\\]+$", description="Table of poses in that folder")
    first_row: Literal["top", "bottom"] = Field(
        "top", description="Where the first stored row belongs; FITS images are often stored bottom up"
    )
    spice: SpiceSpec | None = Field(None, description="Poses from kernels instead of the table")
    sumfiles: tuple[SumfileSpec, ...] | None = optional(
        "Poses from SUM files of stereophotoclinometry instead of the table: each image with its file", min_length=1
    )
    colmap: ColmapSpec | None = optional("Poses from a model of COLMAP in that folder instead of the table")
    truth: str = Field(
        "ref",
        min_length=1,
        description="Prefix of the columns that are scored against; without a table a name for their pose",
    )
    also_score: tuple[str, ...] = Field((), description="Prefixes of further poses to score against")
    aligned: tuple[str, ...] = Field(
        (),
        description="Those of truth and also_score that were found by aligning renderings of the shape with the images:"
        " reports say that errors against them are correlated with those of methods that do the same",
    )
    moved: tuple[MovedPosesSpec, ...] = optional("Further poses, with the shape in another place", ())
    adjusted: AdjustedPosesSpec | None = optional("Further poses, with covariances that enter NEES")
    rendered: bool = optional(
        "Render the views of the images with the pose of truth, through detector, in place of reading them", False
    )
    survey: tuple[str, ...] = optional(
        "Images of the set that are for data bases of methods (source: survey), not for trials", ()
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
        names = [one.name for one in self.moved]
        if self.adjusted is not None and (self.adjusted.name not in prefixes or self.adjusted.name in names):
            raise ValueError(f"adjusted: name {self.adjusted.name} in truth or also_score, and in no other place")
        if idle := [name for name in names if name not in prefixes]:
            raise ValueError(f"moved: {idle[0]} is neither truth nor in also_score: name it there, or leave it out")
        if len(set(names)) < len(names):
            raise ValueError(f"moved: two have the name {max(names, key=names.count)}")
        if shadows := [one.of for one in self.moved if one.of in names]:
            raise ValueError(f"moved: {shadows[0]} is both a name and the poses that are moved: choose another name")

    def place_of(self, name: str) -> MovedPosesSpec | None:
        """Return the moved poses of a name; None for poses as the table has them."""
        return next((one for one in self.moved if one.name == name), None)

    def as_rendered(self) -> Self:
        """Return the same views as renderings, with the pose of truth and no other."""
        moved = tuple(one for one in self.moved if one.name == self.truth)
        adjusted = self.adjusted if self.adjusted is not None and self.adjusted.name == self.truth else None
        alone = {"rendered": True, "also_score": (), "aligned": (), "survey": (), "moved": moved, "adjusted": adjusted}
        return self.model_copy(update=alone)

    @rule
    def _renderings_have_one_pose(self) -> None:
        if self.rendered and (self.also_score or self.aligned):
            raise ValueError("rendered images have the pose of truth and no other: leave also_score and aligned empty")
        if self.rendered and self.survey:
            raise ValueError("survey: images of a survey are real ones, not rendered")
        if len(set(self.survey)) < len(self.survey):
            raise ValueError("survey: an image appears twice")

    @rule
    def _kernels_leave_no_choice(self) -> None:
        senseless = self.stated("table", "first_row", "sumfiles", "colmap", "also_score", "moved", "adjusted", "survey")
        if self.spice is not None and senseless:
            raise ValueError(f"{', '.join(senseless)} has no meaning beside spice; leave it out")

    @rule
    def _without_a_table_each_image_has_one_pose(self) -> None:
        source = "sumfiles" if self.sumfiles is not None else "colmap"
        listed = self.sumfiles if self.colmap is None else self.colmap.images
        senseless = self.stated("table", "also_score", "moved", "adjusted", *({"sumfiles", "colmap"} - {source}))
        if listed is not None and senseless:
            raise ValueError(f"{', '.join(senseless)} has no meaning beside {source}; leave it out")
        names = [one.image for one in listed or ()]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"{source}: {twice[0]} appears twice")
        files = [one.sumfile for one in self.sumfiles or ()]
        if len(set(files)) < len(files):
            raise ValueError(
                f"sumfiles: {max(files, key=files.count)} is the file of two images: each has its own pose"
            )


_ONBOARD_OF = {
    "sequence": frozenset[str](),
    "orbit": frozenset[str](),
    "crater_pairs": frozenset({"body", "facets", "relief", "height_error"}),
}
"""Keys of ``onboard`` that apply to such scenarios; their other a priori knowledge is set in those sections."""

NAME_PATTERN = r"^[a-z0-9][a-z0-9._-]*$"
NAMED = "Small letters, digits and . _ -; by default the name of the file, if it has no other characters"


class AltimeterSpec(SpecModel):
    """A laser altimeter along the camera's boresight; its Gaussian error is independent of the prior's."""

    sigma_m: float = Field(gt=0, description="Standard deviation of a range")


class SensorsSpec(SpecModel):
    """Sensors by name; those left out are not on board."""

    altimeter: AltimeterSpec | None = Field(None, description="Measures the distance to the surface on the boresight")

    @property
    def aboard(self) -> frozenset[str]:
        """Names of the sensors on board."""
        return frozenset(name for name in type(self).model_fields if getattr(self, name) is not None)


class ScenarioSpec(SpecModel):
    """Content of a scenario file. Its digest is part of every result's key.

    Images are either rendered from a ``viewpoint`` or read from ``images``. Instead of images, a ``sequence`` gives
    tracks, ``crater_pairs`` detections of craters, and an ``orbit`` sightings of numbered craters.
    """

    alternatives: ClassVar = (("viewpoint", "images", "sequence", "crater_pairs", "orbit"),)
    prose: ClassVar = frozenset({"name", "description"})
    own: ClassVar = frozenset({"name", "description"})

    name: str = Field(pattern=NAME_PATTERN, description=NAMED)
    description: str = Field("", description="One line about the scenario")
    body: BodySpec = BodySpec()
    craters: CratersSpec | None = optional(
        "Craters that are all known, on a surface that is fine where the camera looks"
    )
    camera: CameraSpec
    rendering: RenderingSpec = RenderingSpec()
    detector: DetectorSpec | None = Field(None, description="Left out: ideal, noise-free images")
    brdf: BrdfSpec = Field(LambertSpec(), description="Reflectance of the surface")
    viewpoint: ViewpointSpec | None = Field(None, description="Where rendered images are seen from")
    lighting: LightingSpec = LightingSpec()
    correlated: CorrelatedSpec | None = optional("Keys of views and images that are drawn together")
    second_body: SecondBodySpec | None = optional("A second body in rendered images, on an orbit about the first")
    stars: StarsSpec | None = optional("Stars behind the body in rendered images; left out: a black sky")
    images: ImageSetSpec | None = Field(None, description="Real images, instead of viewpoint")
    sequence: SequenceSpec | None = Field(None, description="Tracks of a camera's way, instead of viewpoint")
    crater_pairs: CraterPairsSpec | None = Field(None, description="Detections in two looks, instead of viewpoint")
    orbit: OrbitSpec | None = optional(
        "Weeks of images of craters from an orbit, or of an approach, instead of viewpoint"
    )
    pose_error: PoseErrorSpec = PAPER_POSE_ERROR
    sensors: SensorsSpec = Field(SensorsSpec(), description="What is measured beside the image")
    onboard: OnboardSpec = Field(OnboardSpec(), description="What the spacecraft believes, where it is wrong")

    @rule
    def _craters_on_a_smooth_body(self) -> None:
        if self.craters is not None and (beside := self.body.stated("detail", "height_error", "local", "albedo_map")):
            told = " and ".join(f"body.{key}" for key in beside)
            raise ValueError(f"craters are put on a smooth shape: leave out {told}")
        if self.craters is not None and self.body.shading != "flat":
            raise ValueError("craters have facets smaller than pixels, with flat normals: leave out body.shading")

    @rule
    def _second_body_in_rendered_images(self) -> None:
        if self.second_body is None:
            return
        if self.viewpoint is None:
            raise ValueError(f"second_body has no part in a scenario with {self._kind}: leave it out")
        if self.craters is not None:
            raise ValueError("second_body: no image has two bodies and the section craters: leave one of the two out")
        if self.second_body.body.shading != self.body.shading:
            raise ValueError(f"second_body.body.shading: both bodies have the same: give {self.body.shading}")
        albedo, ratio = getattr(self.brdf, "albedo", None), self.second_body.albedo_ratio
        if albedo is not None and albedo * ratio > 1.0:
            raise ValueError(f"second_body.albedo_ratio: {ratio:g} times the albedo {albedo:g} is above 1: give less")

    @model_validator(mode="after")
    def _stars_behind_a_rotating_body(self) -> Self:
        """Give the stars the rotation of the trajectory's body."""
        if self.stars is None:
            return self
        if self.viewpoint is None:
            raise ValueError(f"stars has no part in a scenario with {self._kind}: leave it out")
        if self.detector is None:
            raise ValueError("stars: they are seen by a detector: add the section detector")
        rotation = None if self.viewpoint.trajectory is None else self.viewpoint.trajectory.rotation
        if rotation is None or self.stars.rotation == rotation:
            return self
        if self.stars.rotation is not None:
            raise ValueError("stars.rotation is not that of viewpoint.trajectory: leave it out")
        return self.model_copy(update={"stars": self.stars.model_copy(update={"rotation": rotation})})

    @rule
    def _survey_of_a_known_camera(self) -> None:
        wrong = self.onboard.focal_error, *self.onboard.principal_point_error_px
        if self.images is not None and self.images.survey and any(wrong):
            raise ValueError("images.survey: its images have the true camera: leave the errors of onboard's out")

    @model_validator(mode="after")
    def _smallest_listed_crater(self) -> Self:
        if self.craters is None or self.craters.known_diameter_m is not None:
            return self
        if self.m_per_px is None:
            raise ValueError(
                f"craters.known_diameter_m: missing, but a scenario with {self._kind} has no range: give it"
            )
        listed = {"known_diameter_m": LISTED_PX * self.m_per_px}
        return self.model_copy(update={"craters": self.craters.model_copy(update=listed)})

    @property
    def believed_pose_error(self) -> PoseErrorSpec:
        """The distribution of the prior's error that the spacecraft believes in."""
        return self.onboard.pose_error or self.pose_error

    @property
    def m_per_px(self) -> float | None:
        """Length across the line of sight that a pixel covers at the origin of the body; None if no range is given.

        At the ground below the camera if its altitude is given.
        """
        if self.viewpoint is not None:
            range_m = self.viewpoint.median_range_m
        elif self.crater_pairs is not None:
            range_m = self.crater_pairs.range_m
        elif self.orbit is not None:
            range_m = self.orbit.arc.ranges_m[1]
        else:
            return None
        return range_m / self.camera.camera().fx_px

    @rule
    def _onboard_knows_of_something(self) -> None:
        onboard = self.onboard
        if onboard.body is not None and onboard.stated("facets", "relief", "height_error", "albedo"):
            raise ValueError(
                "onboard.body is a whole shape: give facets, relief, height_error and albedo in it, not beside it"
            )
        if onboard.facets is not None and self.body.detail is None:
            raise ValueError("onboard.facets: the body has no detail stage whose resolution could be changed")
        if onboard.relief is not None and self.body.detail is None:
            raise ValueError("onboard.relief: the body has no detail stage whose small relief could be another")
        if onboard.distortion_error != 0.0 and self.camera.distortion is None:
            raise ValueError("onboard.distortion_error: the camera has no distortion that could be known wrongly")

    @rule
    def _onboard_has_a_part(self) -> None:
        lent = _ONBOARD_OF.get(self._kind, frozenset(OnboardSpec.model_fields))
        idle = [key for key in self.onboard.stated() if key not in lent]
        if idle:
            raise ValueError(f"onboard.{idle[0]} has no part in a scenario with {self._kind}: leave it out")

    @property
    def bodies(self) -> tuple[BodySpec, ...]:
        """The body, and the second one if there is one."""
        return (self.body,) if self.second_body is None else (self.body, self.second_body.body)

    @property
    def real(self) -> bool:
        """True if the images of single views are real ones."""
        return self.images is not None and not self.images.rendered

    @property
    def _kind(self) -> str:
        """Name of the one given section of those that exclude each other."""
        return next(key for key in self.alternatives[0] if getattr(self, key) is not None)

    @model_validator(mode="after")
    def _belief_has_the_attitude_of_the_draw(self) -> Self:
        believed, true = self.onboard.pose_error, self.pose_error
        if believed is None or "attitude" in believed.model_fields_set or true.pose_cam_deg_m is not None:
            return self
        if believed.pose_cam_deg_m is not None or believed.attitude == true.attitude:
            return self
        believed = believed.model_copy(update={"attitude": true.attitude})
        return self.model_copy(update={"onboard": self.onboard.model_copy(update={"pose_error": believed})})

    @rule
    def _states_bring_their_own(self) -> None:
        states = None if self.viewpoint is None else self.viewpoint.states
        for key, law in (("pose_error", self.pose_error), ("onboard.pose_error", self.onboard.pose_error)):
            if law is not None and law.position_rtn_m is not None and not (states and states.has_planes):
                raise ValueError(
                    f"{key}.position_rtn_m needs viewpoint.trajectory, with velocities that are not along the positions"
                )
        drawn = self.lighting.model_copy(update={"brightness": 1.0})
        if states is not None and states.sun_dir is not None and drawn != LightingSpec():
            raise ValueError("lighting has no part where the trajectory's table has the Sun: leave one of the two out")

    @rule
    def _motion_of_a_trajectory(self) -> None:
        motion = None if self.detector is None else self.detector.motion
        if motion is not None and motion.trajectory and (self.viewpoint is None or not self.viewpoint.flies):
            raise ValueError("detector.motion.trajectory needs a viewpoint.trajectory that has velocities")

    @rule
    def _correlated_keys_are_drawn(self) -> None:
        if self.correlated is None:
            return
        if self.viewpoint is None:
            raise ValueError(f"correlated has no part in a scenario with {self._kind}: leave it out")
        states = self.viewpoint.states
        idle = {"viewpoint.roll_deg", "viewpoint.off_pointing_deg"} if states and states.attitude else set[str]()
        idle |= {"lighting.phase_deg"} if states and states.sun_dir else set()
        idle |= {"viewpoint.roll_deg"} if self.viewpoint.targets else set()  # drawn uniform there
        laws = {key: None if key in idle else self.law_of(key) for key in self.correlated.keys}
        constant = [key for key, law in laws.items() if law is None or law.support[0] == law.support[1]]
        if constant:
            raise ValueError(f"correlated.keys: {constant[0]} is not drawn: give it a distribution, or leave it out")
        counts = [len(law.choice) if isinstance(law, Choice) else 0 for law in laws.values()]
        if self.correlated.same_row and (0 in counts or len(set(counts)) > 1):
            raise ValueError("correlated.same_row: give each of the keys a choice of as many values")

    def law_of(self, key: str) -> Law | None:
        """Return the distribution of a key of a section; None if it is a constant or not given."""
        section, _, name = key.partition(".")
        law = getattr(getattr(self, section), name, None)
        return law if isinstance(law, Law) else None

    @rule
    def _real_images_bring_their_own(self) -> None:
        sequence, pairs, imaging = self.sequence, self.crater_pairs, None if self.orbit is None else self.orbit.imaging
        rendered = self.viewpoint or (sequence and sequence.images) or (pairs and pairs.images)
        if self.lighting.brightness != 1.0 and not rendered and (imaging is None or imaging.detections == "drawn"):
            raise ValueError("lighting.brightness has no part where no image is rendered: leave it out")
        if self.real and self.detector is not None:
            raise ValueError("detector has no part in a scenario with images: they carry their own noise; leave it out")
        if self.images is not None and self.lighting != LightingSpec():
            raise ValueError("lighting has no part in a scenario with images: their table says where the Sun is")
        if self.real and self.sensors.aboard:
            raise ValueError("sensors has no part in a scenario with images: there is no exact truth to measure in")

"""Camera, detector and rendering sections."""

from __future__ import annotations

import dataclasses
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, ValidationInfo, model_validator

from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, OpenCVDistortion, RadialDistortion
from boresight.scenarios.geometry.lens import Lens
from boresight.scenarios.spec.artefacts import CosmicRaysSpec, MotionSpec, PixelsSpec, StrayLightSpec, WingSpec
from boresight.scenarios.spec.base import SpecModel, optional, rule
from boresight.scenarios.spec.distribution import DrawnModel, Limits, PositiveScalar

# Far beyond any camera; the bounds keep derived quantities finite.
FocalLength = Annotated[float, Field(ge=1, le=1e9)]
Pitch = Annotated[float, Field(gt=0, le=1e4)]
Coefficient = Annotated[float, Field(ge=-1e20, le=1e20)]
ImagePosition = Annotated[float, Field(ge=-1e6, le=1e6)]

NonNegative = Annotated[float, Field(ge=0)]


def _has_area(value: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    left, top, right, bottom = value
    if not (left < right and top < bottom):
        raise ValueError(f"[{left:g}, {top:g}, {right:g}, {bottom:g}] has no area: write [left, top, right, bottom]")
    return value


Rectangle = Annotated[tuple[NonNegative, NonNegative, NonNegative, NonNegative], AfterValidator(_has_area)]


class DistortionSpec(SpecModel):
    """Radial distortion: ideal = seen (1 + k1 r^2 + k2 r^4), in x / z and y / z from the principal point; or OpenCV's.

    OpenCV's polynomial goes the other way, from the ideal position to the seen one.
    """

    alternatives: ClassVar = (("k1", "opencv"),)

    k1: Coefficient | None = Field(
        None, description="Coefficient of r^2; a kernel's constant in mm^-2 times (focal length in mm)^2"
    )
    k2: Coefficient = Field(0.0, description="Coefficient of r^4")
    opencv: tuple[Coefficient, ...] | None = optional(
        "OpenCV's vector k1, k2, p1, p2, and k3, k4, k5, k6 if there are more, instead of k1",
        min_length=4,
        max_length=8,
    )

    @rule
    def _one_polynomial(self) -> None:
        if self.opencv is not None and self.k2 != 0.0:
            raise ValueError("k2 has no part where opencv has the lens: leave it out")

    def lens(self) -> Lens:
        """Return the distortion as a value."""
        return RadialDistortion(self.k1 or 0.0, self.k2) if self.opencv is None else OpenCVDistortion(*self.opencv)

    @classmethod
    def of(cls, lens: Lens) -> Self:
        """Return the section of a lens."""
        if isinstance(lens, RadialDistortion):
            return cls(k1=lens.k1, k2=lens.k2)
        return cls(opencv=dataclasses.astuple(lens))

    def scaled(self, factor: float) -> DistortionSpec:
        """Return the distortion with all coefficients times a factor."""
        if self.opencv is not None:
            return DistortionSpec(opencv=tuple(factor * number for number in self.opencv))
        return DistortionSpec(k1=(self.k1 or 0.0) * factor, k2=self.k2 * factor)


class OpticsSpec(SpecModel):
    """Focal length and pixels as a data sheet has them: ``{focal_mm: 120.8, pixel_um: 12}``."""

    focal_mm: float = Field(gt=0, le=1e7, description="Focal length")
    pixel_um: Pitch | tuple[Pitch, Pitch] = Field(description="Distance of pixels, one or [across, down]")

    @rule
    def _check(self) -> None:
        if not all(1.0 <= focal <= 1e9 for focal in self.focal_px):
            across, down = self.focal_px
            raise ValueError(f"focal lengths of {across:g} and {down:g} px are not within [1, 1e9]: check the units")

    @property
    def focal_px(self) -> tuple[float, float]:
        """Focal lengths in pixels, across and down."""
        across, down = self.pixel_um if isinstance(self.pixel_um, tuple) else (self.pixel_um, self.pixel_um)
        return 1000.0 * self.focal_mm / across, 1000.0 * self.focal_mm / down


class KernelsSpec(SpecModel):
    """SPICE kernels."""

    kernels: tuple[str, ...] = Field(
        min_length=1,
        description="Kernels in the order of loading, a later one overrides: paths next to the scenario file, in its"
        " folder of images, or under BORESIGHT_DATA/spice",
    )


class BodyKernelsSpec(KernelsSpec):
    """Kernels that have the position and the attitude of a body."""

    target: str = Field(min_length=1, description="NAIF's name of the body")
    target_frame: str = Field(min_length=1, description="NAIF's name of the body-fixed frame, that of the shape")
    aberration: Literal["LT+S", "NONE"] = Field(
        "LT+S", description="Light time and stellar aberration of the body's position, or the geometric position"
    )


class SpiceCameraSpec(KernelsSpec):
    """The camera of an instrument kernel, with its size, focal length, principal point and distortion.

    The kernels are the instrument's and its addenda, and a frame kernel if the instrument is named.
    """

    instrument: str = Field(min_length=1, description="NAIF's name or number of the camera: ORX_OCAMS_MAPCAM, -64361")


class CameraSpec(SpecModel):
    """A pinhole or, with ``distortion``, a real lens.

    Its field is ``fov_deg`` (across the width, square pixels), focal lengths in pixels, ``optics``, or that of an
    instrument kernel.
    """

    alternatives: ClassVar = (("fov_deg", "focal_px", "optics", "spice"),)

    width_px: int = Field(512, ge=16, le=8192, description="Columns of the image")
    height_px: int = Field(512, ge=16, le=8192, description="Rows of the image")
    fov_deg: float | None = Field(None, ge=1e-4, lt=180, description="Full field of view across the width")
    focal_px: tuple[FocalLength, FocalLength] | None = Field(
        None, description="Focal lengths [fx, fy]; instead of fov_deg"
    )
    optics: OpticsSpec | None = optional("Focal length and pixels in mm and um, instead of fov_deg")
    spice: SpiceCameraSpec | None = optional("Camera of an instrument kernel, instead of fov_deg and the sizes")
    principal_point_px: tuple[ImagePosition, ImagePosition] | None = Field(
        None, description="Principal point [cx, cy]; the middle of the image by default"
    )
    distortion: DistortionSpec | None = Field(
        None, description="Distortion of the lens; images are resampled to the pinhole before an estimator sees them"
    )

    @model_validator(mode="after")
    def _of_a_kernel(self, info: ValidationInfo) -> Self:
        """Fill in the numbers of the kernel, so that a stored scenario needs none."""
        if self.spice is None:
            return self
        if self.principal_point_px is not None:
            raise ValueError("principal_point_px has no part where the camera is that of a kernel: leave it out")
        try:
            from boresight.scenarios.spice import read_camera  # spiceypy is not always installed

            folders, size_px = (info.context or {}).get("folders", ()), (self.width_px, self.height_px)
            read = read_camera(self.spice.kernels, self.spice.instrument, size_px, folders)
        except (BoresightError, ImportError) as error:
            raise ValueError(f"spice: {error}") from None
        for key in ("width_px", "height_px"):
            if getattr(self, key) not in {type(self).model_fields[key].default, getattr(read, key)}:
                raise ValueError(f"{key} {getattr(self, key)} is not the kernel's {getattr(read, key)}: leave it out")
        known = None if read.distortion is None else DistortionSpec.of(read.distortion)
        size = {"width_px": read.width_px, "height_px": read.height_px, "focal_px": (read.fx_px, read.fy_px)}
        place = {"principal_point_px": (read.cx_px, read.cy_px), "distortion": self.distortion or known}
        return self.model_copy(update={**size, **place, "spice": None})

    @rule
    def _distortion_does_not_fold(self) -> None:
        camera = self.camera()
        # The farthest corner from the principal point, at unit focal length.
        across = max(camera.cx_px, camera.width_px - camera.cx_px) / camera.fx_px
        down = max(camera.cy_px, camera.height_px - camera.cy_px) / camera.fy_px
        lens = camera.distortion
        if lens is not None and not lens.invertible_within(float(np.hypot(across, down))):
            raise ValueError(
                f"{lens} folds the image over within the field; check the sign and the unit: coefficients belong to"
                " x / z, not to mm or pixels"
            )

    def camera(self) -> Camera:
        """Return the camera as a value."""
        if self.fov_deg is not None:
            fx = fy = 0.5 * self.width_px / np.tan(0.5 * np.radians(self.fov_deg))
        elif self.focal_px is not None:
            fx, fy = self.focal_px
        elif self.optics is not None:
            fx, fy = self.optics.focal_px
        else:
            raise ValueError("the camera has neither fov_deg, focal_px nor optics")
        cx, cy = self.principal_point_px or (0.5 * self.width_px, 0.5 * self.height_px)
        lens = None if self.distortion is None else self.distortion.lens()
        return Camera(self.width_px, self.height_px, float(fx), float(fy), cx, cy, lens)


_MOST_TRACKS = 1e5  # in one image: about 5 s
_ARTEFACTS = {
    "psf_wings": "wings of the point spread",
    "stray_light": "stray light",
    "motion": "motion during the exposure",
    "pixels": "flat field and defects of pixels",
    "row_shift_s": "frame transfer",
    "cosmic_rays": "cosmic rays",
    "jpeg_quality": "JPEG compression",
}


class DetectorSpec(DrawnModel):
    """Conversion from radiance to digital numbers. Omit the section for ideal, noise-free images.

    The signal of a surface of radiance factor 1 (a white Lambertian plate facing the Sun) is
    ``white_e_per_s * exposure_s`` electrons a pixel.
    """

    limits: ClassVar = {"exposure_s": Limits(0.0, rms=1e6)}

    psf_sigma_px: float = Field(0.5, ge=0, le=20, description="Gaussian point spread function")
    exposure_s: PositiveScalar = Field(0.1, description="Exposure time, one or drawn")
    white_e_per_s: float = Field(2.0e6, gt=0, le=1e12, description="Electrons a second from a radiance factor of 1")
    dark_e_per_s: float = Field(10.0, ge=0, le=1e12, description="Dark current")
    full_well_e: float = Field(100_000.0, gt=0, description="Electrons at which a pixel saturates")
    read_noise_e: float = Field(10.0, ge=0, description="RMS noise of a read-out")
    shot_noise: bool = Field(True, description="Poisson noise of signal and dark current")
    gain_e_per_dn: float = Field(25.0, gt=0, description="Electrons for one digital number")
    offset_dn: float = Field(10.0, ge=0, description="Bias level")
    bits: int = Field(12, ge=1, le=16, description="Digital numbers run from 0 to 2**bits - 1")
    psf_wings: tuple[WingSpec, ...] | None = optional(
        "Further Gaussians of the point spread function; psf_sigma_px has the rest of the light", min_length=1
    )
    stray_light: StrayLightSpec | None = optional("Light beside the image: a veil and a linear background")
    motion: MotionSpec | None = optional("Motion of the camera during the exposure; rolling shutter")
    pixels: PixelsSpec | None = optional("Flat field, hot and dead pixels")
    row_shift_s: float | None = optional(
        "Frame transfer without a shutter: time of the shift by one row. Each pixel collects light from every row of"
        " its column for this time",
        gt=0,
        le=10,
    )
    cosmic_rays: CosmicRaysSpec | None = optional("Tracks of charged particles")
    jpeg_quality: int | None = optional("Quality of a JPEG compression of the digital numbers", ge=1, le=100)

    @rule
    def _artefacts_go_together(self) -> None:
        wings = self.psf_wings or ()
        share = sum(wing.share for wing in wings)
        if share >= 1.0:
            raise ValueError(f"psf_wings: their shares are {share:g} together: leave light for psf_sigma_px")
        if any(wing.sigma_px <= self.psf_sigma_px for wing in wings):
            raise ValueError(f"psf_wings: give each a sigma_px above psf_sigma_px {self.psf_sigma_px:g}")
        if self.row_shift_s is not None and self.motion is not None and self.motion.row_delay_s is not None:
            raise ValueError("row_shift_s: frame transfer has no rolling shutter: leave out this or motion.row_delay_s")
        if self.jpeg_quality is not None and self.bits != 8:
            raise ValueError(f"jpeg_quality: JPEG has 8 bits and the detector {self.bits}: give bits: 8")
        exposure_s = self.exposure_s if isinstance(self.exposure_s, float) else self.exposure_s.median
        if self.cosmic_rays is not None and self.cosmic_rays.hits_per_s * exposure_s > _MOST_TRACKS:
            raise ValueError(f"cosmic_rays.hits_per_s: more than {_MOST_TRACKS:g} tracks in an exposure: give less")

    @property
    def artefacts(self) -> tuple[str, ...]:
        """Names of the artefacts that images have, in words."""
        return tuple(words for key, words in _ARTEFACTS.items() if self.stated(key))

    @rule
    def _offset_below_the_top(self) -> None:
        if self.offset_dn >= 2**self.bits - 1:
            raise ValueError(
                f"offset_dn {self.offset_dn:g} is not below {2**self.bits - 1}, the largest number of {self.bits} bits"
            )


class RenderingSpec(SpecModel):
    """Sampling of the rendered scene."""

    samples_per_pixel: int = Field(4, ge=1, le=64, description="A square number: a regular grid in each pixel")

    @rule
    def _square(self) -> None:
        if round(self.samples_per_pixel**0.5) ** 2 != self.samples_per_pixel:
            raise ValueError(f"{self.samples_per_pixel} is not a square number (1, 4, 9, 16, ...)")

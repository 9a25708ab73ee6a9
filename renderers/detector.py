"""Frame detector: point spread, motion, response, shot noise, cosmic rays, saturation, read-out, compression."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d
from scipy.special import ive

from boresight.renderers.artefacts import (
    Beyond,
    Motion,
    background_gradient,
    cosmic_rays,
    jpeg_compressed,
    pixel_pattern,
)
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import View
from boresight.scenarios.spec.camera import DetectorSpec


@dataclass(frozen=True, slots=True)
class Detector:
    """Frame detector: light is scattered, moves, and is counted, read out and compressed, in this order.

    ``version`` enters the digest of every run: raise it when pixels change.
    """

    name: ClassVar[str] = "frame-detector"
    version: ClassVar[int] = 1

    spec: DetectorSpec

    def expose(
        self,
        radiance_factor: NDArray[np.float32],
        rng: np.random.Generator,
        points_e_per_s: FloatArray | None = None,
        view: View | None = None,
        velocity_body_m_s: FloatArray | None = None,
    ) -> NDArray[np.float32]:
        """Expose one frame of an (H, W) mean radiance factor I/F, which is not modified.

        ``rng`` is the source of all that is drawn for the frame, ``points_e_per_s`` (H, W) the light of point
        sources, blurred by ``psf_sigma_px`` already (`renderers.stars`). Motion and the gradient of stray light need
        the ``view``, ``motion.trajectory`` the camera's velocity (3,) about the body in body axes. Return (H, W) whole
        digital numbers from 0 to 2**bits - 1. Raise `BoresightError` if the image is not two-dimensional, holds
        negative or non-finite values, moves too far, or if view or velocity are needed and missing.
        """
        image = np.asarray(radiance_factor, dtype=np.float64)
        if image.ndim != 2 or not (np.isfinite(image) & (image >= 0.0)).all():
            raise BoresightError(
                f"the detector needs an (H, W) image of finite radiance factors of at least 0, not one of shape"
                f" {image.shape} between {image.min(initial=0.0)} and {image.max(initial=0.0)}"
            )
        # A stream of its own, so that the draws of exposure, motion and rays are not those of shot and read noise.
        own, exposure_s = rng.spawn(1)[0], self.spec.exposure_s
        exposure_s = exposure_s if isinstance(exposure_s, float) else exposure_s.draw(own)
        of_motion, of_rays = own.spawn(2)
        motion = self.motion(exposure_s, view, velocity_body_m_s, of_motion)
        rate_e_per_s = self.rate_e_per_s(image, exposure_s, motion, points_e_per_s, view)
        return self.digitise(self.collect(rate_e_per_s * exposure_s, exposure_s, rng, of_rays), rng)

    def motion(
        self, exposure_s: float, view: View | None, velocity_body_m_s: FloatArray | None, rng: np.random.Generator
    ) -> Motion | None:
        """Draw the motion of the camera during an exposure; None without any. Parameters are those of `expose`."""
        moved = self.spec.motion
        if moved is None:
            return None
        view = _given(view)
        rate_rad_s, velocity_m_s = np.zeros(3), np.zeros(3)
        if moved.rate_deg_s is not None:
            rate_rad_s = np.radians(moved.rate_deg_s.draw(rng))
        if moved.trajectory:
            if velocity_body_m_s is None:
                raise BoresightError("detector.motion.trajectory: the view has no velocity")
            velocity_m_s = view.T_cam_body.rotate(velocity_body_m_s)
        return Motion(view, exposure_s, rate_rad_s, velocity_m_s, moved.row_delay_s or 0.0)

    def rate_e_per_s(
        self,
        radiance_factor: FloatArray,
        exposure_s: float,
        motion: Motion | None = None,
        points_e_per_s: FloatArray | None = None,
        view: View | None = None,
    ) -> FloatArray:
        """Return the mean electrons (H, W) a second of the scene, its background and the dark current.

        Parameters are those of `expose`. Raise `BoresightError` if the view is needed and missing.
        """
        spec = self.spec
        # The optics blur the light before it is counted, so the counts of neighbouring pixels are independent. Dark
        # electrons are counted with them: a sum of Poisson variables is one too.
        light = self._scattered(spec.white_e_per_s * blurred(radiance_factor, spec.psf_sigma_px), "nearest")
        light = light if motion is None else motion.smeared(light)
        rate_e_per_s = self._counted(light, exposure_s) + spec.dark_e_per_s
        if spec.pixels is not None:
            rate_e_per_s = rate_e_per_s + pixel_pattern(spec.pixels, light.shape)[1]
        if points_e_per_s is not None:
            points = self._scattered(points_e_per_s, "constant")
            # Stars are too far to be moved by the camera's velocity.
            points = points if motion is None else replace(motion, velocity_m_s=np.zeros(3)).smeared(points, "constant")
            rate_e_per_s = rate_e_per_s + self._counted(points, exposure_s)
        if spec.stray_light is not None and spec.stray_light.gradient_e_per_s:
            background = background_gradient(spec.stray_light, _given(view))
            rate_e_per_s = rate_e_per_s + self._counted(background, exposure_s)
        return rate_e_per_s

    def _scattered(self, light: FloatArray, beyond: Beyond) -> FloatArray:
        """Scatter light (H, W), blurred by ``psf_sigma_px`` already, into the wings of the point spread and a veil."""
        spec, veil = self.spec, 0.0 if self.spec.stray_light is None else self.spec.stray_light.veil_share
        if spec.psf_wings:
            # Variances of successive convolutions add.
            wings = [
                wing.share * blurred(light, math.sqrt(wing.sigma_px**2 - spec.psf_sigma_px**2), beyond)
                for wing in spec.psf_wings
            ]
            light = (1.0 - sum(wing.share for wing in spec.psf_wings)) * light + sum(wings)
        return (1.0 - veil) * light + veil * light.mean() if veil else light

    def _counted(self, light: FloatArray, exposure_s: float) -> FloatArray:
        """Return what pixels count a second of light (H, W), that of the transfer of the frame included."""
        if self.spec.pixels is not None:
            light = light * pixel_pattern(self.spec.pixels, light.shape)[0]
        if self.spec.row_shift_s is not None:
            # Cleared by shifts before the exposure and read by shifts after it, a pixel passes all rows.
            light = light + self.spec.row_shift_s / exposure_s * light.sum(axis=0)
        return light

    def collect(
        self, expected_e: FloatArray, exposure_s: float, rng: np.random.Generator, of_rays: np.random.Generator
    ) -> FloatArray:
        """Return the (H, W) electrons collected in the exposure, limited to the full well."""
        spec = self.spec
        electrons = rng.poisson(expected_e).astype(np.float64) if spec.shot_noise else expected_e
        if spec.cosmic_rays is not None:
            electrons = electrons + cosmic_rays(spec.cosmic_rays, electrons.shape, exposure_s, of_rays)
        # A pixel saturates before it is read: read noise is added to the clipped charge.
        return np.minimum(electrons, spec.full_well_e)

    def digitise(self, electrons: FloatArray, rng: np.random.Generator) -> NDArray[np.float32]:
        """Read out (H, W) electrons as digital numbers: read noise, gain, offset, clipping and compression."""
        spec = self.spec
        read_e = electrons + rng.normal(0.0, spec.read_noise_e, electrons.shape)
        numbers = np.rint(read_e / spec.gain_e_per_dn + spec.offset_dn)
        numbers = np.clip(numbers, 0.0, 2.0**spec.bits - 1.0).astype(np.float32)
        return numbers if spec.jpeg_quality is None else jpeg_compressed(numbers, spec.jpeg_quality)


def _given(view: View | None) -> View:
    if view is None:
        raise BoresightError("motion and the gradient of stray light need the view of the image")
    return view


def blurred(image: FloatArray, sigma_px: float, beyond: Beyond = "nearest") -> FloatArray:
    """Convolve an (H, W) image with a Gaussian; beyond the edge are its nearest pixels, or zeros with ``constant``.

    The kernel is the discrete Gaussian exp(-t) I_n(t) with t = sigma**2 (Lindeberg 1990). Unlike a sampled Gaussian it
    adds exactly sigma**2 to the variance of a spot even where sigma is below a pixel, and variances of successive
    convolutions add.
    """
    if sigma_px == 0.0:
        return image
    kernel = point_spread(sigma_px)
    rows = correlate1d(image, kernel, axis=0, mode=beyond)
    spread: FloatArray = correlate1d(rows, kernel, axis=1, mode=beyond)
    return spread


def point_spread(sigma_px: float) -> FloatArray:
    """Discrete Gaussian (2 n + 1,) of standard deviation ``sigma_px`` and sum 1, n = 6 sigma rounded up plus 4."""
    # For sigma below a pixel the tails fall as t^n / (2^n n!), slower than a Gaussian: hence the 4 more pixels.
    reach = int(np.ceil(6.0 * sigma_px)) + 4
    # ive(n, t) = exp(-t) I_n(t) at once; I_n alone overflows for large t.
    weights = ive(np.abs(np.arange(-reach, reach + 1)), sigma_px**2)
    return np.asarray(weights / weights.sum(), dtype=np.float64)

"""From radiance to digital numbers: point spread, electrons, noise, saturation, quantisation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d
from scipy.special import ive

from scenarios.errors import BoresightError
from scenarios.spec.camera import DetectorSpec

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Detector:
    """A frame detector behind a Gaussian point spread function.

    ``version`` is part of every result's key: raise it when pixels change.
    """

    name: ClassVar[str] = "frame-detector"
    version: ClassVar[int] = 1

    spec: DetectorSpec

    def expose(self, radiance_factor: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
        """Expose one frame.

        Parameters
        ----------
        radiance_factor
            (H, W) radiance factor I/F, mean over each pixel; not changed.
        rng
            Source of the shot noise and the read noise.

        Returns
        -------
        ndarray
            (H, W) float32 digital numbers, whole, 0 to 2**bits - 1.

        Raises
        ------
        BoresightError
            If the image is not two-dimensional, or holds negative or non-finite values.
        """
        image = np.asarray(radiance_factor, dtype=np.float64)
        if image.ndim != 2 or not (np.isfinite(image) & (image >= 0.0)).all():
            raise BoresightError(
                f"the detector needs an (H, W) image of finite radiance factors of at least 0, not one of shape"
                f" {image.shape} between {image.min(initial=0.0)} and {image.max(initial=0.0)}"
            )
        return self.digitise(self.collect(image, rng), rng)

    def collect(self, radiance_factor: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return the (H, W) electrons in the wells at the end of the exposure."""
        spec = self.spec
        rate_e_per_s = spec.white_e_per_s * blurred(radiance_factor, spec.psf_sigma_px) + spec.dark_e_per_s
        expected_e = rate_e_per_s * spec.exposure_s
        electrons = rng.poisson(expected_e).astype(np.float64) if spec.shot_noise else expected_e
        return np.minimum(electrons, spec.full_well_e)

    def digitise(self, electrons: FloatArray, rng: np.random.Generator) -> NDArray[np.float32]:
        """Return the (H, W) digital numbers that wells with ``electrons`` are read out as."""
        spec = self.spec
        read_e = electrons + rng.normal(0.0, spec.read_noise_e, electrons.shape)
        numbers = np.rint(read_e / spec.gain_e_per_dn + spec.offset_dn)
        return np.clip(numbers, 0.0, 2.0**spec.bits - 1.0).astype(np.float32)


def blurred(image: FloatArray, sigma_px: float) -> FloatArray:
    """Spread an (H, W) image by a Gaussian; what lies beyond the edge is like the edge.

    The kernel is the discrete Gaussian exp(-t) I_n(t), t = sigma**2: it adds exactly sigma**2 to the variance of
    any spot, also where sigma is less than a pixel, and two spreads make one of the summed variance, which a
    sampled Gaussian does not (Lindeberg 1990).
    """
    if sigma_px == 0.0:
        return image
    kernel = point_spread(sigma_px)
    rows = correlate1d(image, kernel, axis=0, mode="nearest")
    spread: FloatArray = correlate1d(rows, kernel, axis=1, mode="nearest")
    return spread


def point_spread(sigma_px: float) -> FloatArray:
    """Return the (2 n + 1,) discrete Gaussian of standard deviation ``sigma_px``, of sum 1, out to 6 sigma."""
    reach = int(np.ceil(6.0 * sigma_px)) + 4
    weights = ive(np.abs(np.arange(-reach, reach + 1)), sigma_px**2)
    return np.asarray(weights / weights.sum(), dtype=np.float64)

"""Frame detector: point spread, shot noise, saturation, read noise, quantisation.

Another artefact is a key of `DetectorSpec` (`scenarios/spec/camera.py`) and a step of `Detector.collect` or `digitise`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d
from scipy.special import ive

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.spec.camera import DetectorSpec
from boresight.scenarios.spec.distribution import drawn


@dataclass(frozen=True, slots=True)
class Detector:
    """Frame detector with a Gaussian point spread function.

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
    ) -> NDArray[np.float32]:
        """Expose one frame of an (H, W) mean radiance factor I/F, which is not modified.

        ``rng`` is the source of the shot noise and the read noise, ``points_e_per_s`` (H, W) the light of point
        sources, blurred already (`renderers.stars`). Return (H, W) whole digital numbers from 0 to
        2**bits - 1. Raise `BoresightError` if the image is not two-dimensional, or holds negative or non-finite values.
        """
        image = np.asarray(radiance_factor, dtype=np.float64)
        if image.ndim != 2 or not (np.isfinite(image) & (image >= 0.0)).all():
            raise BoresightError(
                f"the detector needs an (H, W) image of finite radiance factors of at least 0, not one of shape"
                f" {image.shape} between {image.min(initial=0.0)} and {image.max(initial=0.0)}"
            )
        return self.digitise(self.collect(image, rng, points_e_per_s), rng)

    def collect(
        self, radiance_factor: FloatArray, rng: np.random.Generator, points_e_per_s: FloatArray | None = None
    ) -> FloatArray:
        """Return the (H, W) electrons collected in the exposure, limited to the full well."""
        spec = self.spec
        # The optics blur the light before it is counted, so the counts of neighbouring pixels are independent. Dark
        # electrons are counted with them: a sum of Poisson variables is one too.
        rate_e_per_s = spec.white_e_per_s * blurred(radiance_factor, spec.psf_sigma_px) + spec.dark_e_per_s
        if points_e_per_s is not None:
            rate_e_per_s = rate_e_per_s + points_e_per_s
        expected_e = rate_e_per_s * drawn(spec.exposure_s, rng)
        electrons = rng.poisson(expected_e).astype(np.float64) if spec.shot_noise else expected_e
        # A pixel saturates before it is read: read noise is added to the clipped charge.
        return np.minimum(electrons, spec.full_well_e)

    def digitise(self, electrons: FloatArray, rng: np.random.Generator) -> NDArray[np.float32]:
        """Read out (H, W) electrons as digital numbers, with read noise, gain, offset and clipping."""
        spec = self.spec
        read_e = electrons + rng.normal(0.0, spec.read_noise_e, electrons.shape)
        numbers = np.rint(read_e / spec.gain_e_per_dn + spec.offset_dn)
        return np.clip(numbers, 0.0, 2.0**spec.bits - 1.0).astype(np.float32)


def blurred(image: FloatArray, sigma_px: float) -> FloatArray:
    """Convolve an (H, W) image with a Gaussian, repeating the edge pixels beyond the edge.

    The kernel is the discrete Gaussian exp(-t) I_n(t) with t = sigma**2 (Lindeberg 1990). Unlike a sampled Gaussian it
    adds exactly sigma**2 to the variance of a spot even where sigma is below a pixel, and variances of successive
    convolutions add.
    """
    if sigma_px == 0.0:
        return image
    kernel = point_spread(sigma_px)
    rows = correlate1d(image, kernel, axis=0, mode="nearest")
    spread: FloatArray = correlate1d(rows, kernel, axis=1, mode="nearest")
    return spread


def point_spread(sigma_px: float) -> FloatArray:
    """Discrete Gaussian (2 n + 1,) of standard deviation ``sigma_px`` and sum 1, n = 6 sigma rounded up plus 4."""
    # For sigma below a pixel the tails fall as t^n / (2^n n!), slower than a Gaussian: hence the 4 more pixels.
    reach = int(np.ceil(6.0 * sigma_px)) + 4
    # ive(n, t) = exp(-t) I_n(t) at once; I_n alone overflows for large t.
    weights = ive(np.abs(np.arange(-reach, reach + 1)), sigma_px**2)
    return np.asarray(weights / weights.sum(), dtype=np.float64)

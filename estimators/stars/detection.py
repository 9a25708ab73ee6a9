"""Point sources of an image: peaks on dark sky, with positions by a fit of the point spread function."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.special import erf

from boresight.scenarios.arrays import BoolArray, FloatArray, Image, IndexArray

_FIRST_SIGMA_PX = 0.8
_SIGMAS_PX = (0.25, 4.0)  # of a point spread function that is measured
_BRIGHT = 20  # stars from which it is measured
_ROUNDS, _SETTLED_PX = 8, 1e-3
_LEAST_INFORMATION, _LEAST_SHARE = 1e-12, 1e-9
_MOST_SIGMA_PX = 0.5
_MOST_MISFIT = 0.05  # of the squared light that the fit leaves beyond the noise: doubles and lit patches leave more
_SHARED = 12  # pixels near the largest value from which on they are full, and not the peak of a star
_CLIP = 3.0
_STEP = 4  # of the pixels that the level of the sky is from


@dataclass(frozen=True, slots=True, eq=False)
class Detections:
    """Point sources, the brightest first.

    ``uv_px`` (n, 2) are their positions, ``flux_dn`` (n,) the sum of their light, and ``sigma_px`` (n,) standard
    deviations of a coordinate. ``psf_sigma_px`` is the standard deviation of the point spread function before the
    pixels, and ``noise_dn`` that of a pixel of the sky.
    """

    uv_px: FloatArray
    flux_dn: FloatArray
    sigma_px: FloatArray
    psf_sigma_px: float
    noise_dn: float

    def __len__(self) -> int:
        return len(self.flux_dn)


def sky_level(image: Image) -> tuple[float, float]:
    """Return mean and standard deviation of the dark sky, by clipping at 3 sigma from its darkest pixels upwards.

    The body may cover four fifths of the image.
    """
    values = np.sort(image[::_STEP, ::_STEP].ravel()).astype(np.float64)
    low, level = values[len(values) // 100], values[len(values) // 10]
    # Steps of whole numbers may be larger than the noise: sigma is that of rounding at least.
    sigma = max(float(level - low), 1.0 if np.all(np.rint(values) == values) else 1e-9)
    for _ in range(20):
        start, end = np.searchsorted(values, [level - _CLIP * sigma, level + _CLIP * sigma])
        kept = values[start:end]
        if not len(kept):
            break
        before, level, sigma = (level, sigma), float(kept.mean()), max(float(kept.std()), 1e-9)
        if np.allclose(before, (level, sigma), rtol=0.0, atol=1e-3 * sigma):
            break
    return level, sigma


def detect_stars(
    image: Image, gain_e_per_dn: float, psf_sigma_px: float | None = None, threshold: float = 6.0, most: int = 60
) -> Detections:
    """Find point sources on dark sky in an (H, W) image, at most so many of the brightest.

    A source is a peak of the smoothed image that is ``threshold`` standard deviations above the sky, around which the
    sky is dark: this leaves out the body and its limb. Its position maximises the likelihood under a Gaussian point
    spread function integrated over pixels, the noise of the sky and, by the gain, the shot noise. Its standard
    deviation is the Cramer-Rao bound. Without ``psf_sigma_px`` the function is measured from the brightest sources.
    """
    level, noise = sky_level(image)
    lit = np.asarray(image, dtype=np.float32) - np.float32(level)
    spread = psf_sigma_px or _FIRST_SIGMA_PX
    ring_px = max(2, int(np.ceil(3.0 * np.hypot(spread, 0.3)))) + 2
    rows, columns = _peaks(lit, noise, float(np.hypot(spread, 0.3)), threshold, ring_px)
    dark = _on_dark_sky(lit, rows, columns, ring_px, noise)
    # Twice as many as are wanted, as some are no stars.
    rows, columns = rows[dark][: 2 * most], columns[dark][: 2 * most]
    full = lit >= np.float32(0.98) * lit.max(initial=0.0) if len(rows) else lit > np.inf
    if np.count_nonzero(full) < _SHARED:
        full = np.zeros_like(full)
    fit = _Fit(lit, full, noise, gain_e_per_dn)
    if psf_sigma_px is None:
        sharp = np.flatnonzero(~full[rows, columns])[:_BRIGHT]
        spread = fit.spread(rows[sharp], columns[sharp])
    uv, flux, sigma, misfit = fit.positions(rows, columns, spread)
    # A fit that left its peak, or has no light or another shape, is none.
    away_px = np.abs(uv - np.stack([columns, rows], axis=-1) - 0.5).max(axis=1, initial=0.0)
    kept = np.flatnonzero((away_px < 1.5) & (flux > 0.0) & (sigma < _MOST_SIGMA_PX) & (misfit < _MOST_MISFIT))
    kept = kept[np.argsort(-flux[kept], kind="stable")][:most]
    return Detections(uv[kept], flux[kept], sigma[kept], spread, noise)


def _peaks(
    lit: Image, noise: float, spread_px: float, threshold: float, margin_px: int
) -> tuple[IndexArray, IndexArray]:
    """Return rows and columns of the peaks of the image smoothed with the point spread function, the highest first."""
    smooth = cv2.GaussianBlur(lit, (0, 0), spread_px)
    # White noise of deviation s has s / (2 sqrt(pi) sigma) after it, and s at most.
    least = threshold * noise * min(1.0, 1.0 / (2.0 * np.sqrt(np.pi) * spread_px))
    peaks = np.flatnonzero((smooth >= cv2.dilate(smooth, np.ones((3, 3), np.uint8))) & (smooth > np.float32(least)))
    rows, columns = np.unravel_index(peaks, lit.shape)
    height, width = lit.shape
    inside = (np.minimum(rows, columns) >= margin_px) & (rows < height - margin_px) & (columns < width - margin_px)
    order = np.argsort(-smooth[rows[inside], columns[inside]], kind="stable")
    return rows[inside][order].astype(np.int64), columns[inside][order].astype(np.int64)


def _on_dark_sky(lit: Image, rows: IndexArray, columns: IndexArray, ring_px: int, noise: float) -> BoolArray:
    """(n,) whether three quarters of the pixels of a square ring about each peak are sky."""
    steps = np.arange(-ring_px, ring_px + 1)
    down, across = (grid.ravel() for grid in np.meshgrid(steps, steps, indexing="ij"))
    ring = np.maximum(np.abs(down), np.abs(across)) == ring_px
    dark = np.ones(len(rows), dtype=bool)
    # Its corners first: they leave out most of the thousands of peaks of a body.
    for tested in (ring & (np.abs(down) == np.abs(across)), ring):
        at = rows[dark, None] + down[tested], columns[dark, None] + across[tested]
        dark[dark] = (lit[at] < 5.0 * noise).mean(axis=1) >= (0.75 if tested is ring else 0.5)
    return dark


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Fits of point sources to an image above its sky; ``full`` (H, W) are saturated pixels, which do not count."""

    lit: Image
    full: BoolArray
    noise_dn: float
    gain_e_per_dn: float

    def spread(self, rows: IndexArray, columns: IndexArray) -> float:
        """Measure the standard deviation of the point spread function from bright sources."""
        wide = max(3, int(np.ceil(3.0 * _FIRST_SIGMA_PX)))
        found, sigma, misfit = self._solve(rows, columns, np.full(len(rows), _FIRST_SIGMA_PX), wide, 4)
        usable = (misfit < _MOST_MISFIT) & (found[:, 3] > _SIGMAS_PX[0]) & (found[:, 3] < _SIGMAS_PX[1])
        if not usable.any():
            return _FIRST_SIGMA_PX
        # The median of the better half: blended stars are wider, and faint ones hardly say.
        best = np.flatnonzero(usable)[np.argsort(sigma[usable, 3], kind="stable")][: (usable.sum() + 1) // 2]
        return float(np.median(found[best, 3]))

    def positions(
        self, rows: IndexArray, columns: IndexArray, spread: float
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return positions (n, 2), fluxes (n,), standard deviations of a coordinate (n,), px, and misfits (n,)."""
        reach = max(2, int(np.ceil(3.0 * np.hypot(spread, 0.3))))
        found, sigma, misfit = self._solve(rows, columns, np.full(len(rows), spread), reach, 3)
        uv = found[:, :2] + np.stack([columns, rows], axis=-1) + 0.5
        return uv, found[:, 2], np.asarray(np.sqrt(np.mean(np.square(sigma[:, :2]), axis=1))), misfit

    def _solve(
        self, rows: IndexArray, columns: IndexArray, spread: FloatArray, reach: int, free: int
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Fit offsets from the peak's centre, px, flux and spread, of which the first so many are free, (n, 4).

        The standard deviations (n, free) are those of the inverse Fisher information. The misfits (n,) are the squared
        residuals, beyond their variances, over the squared light.
        """
        steps = np.arange(-reach, reach + 1)
        at = rows[:, None, None] + steps[:, None], columns[:, None, None] + steps
        values, counts = self.lit[at].astype(np.float64), ~self.full[at]
        found = np.zeros((len(rows), 4))
        found[:, 2], found[:, 3] = np.maximum(values.sum(axis=(1, 2)), self.noise_dn), spread
        covariance, misfit = np.full((len(rows), free, free), np.nan), np.full(len(rows), np.nan)
        for _ in range(_ROUNDS if len(rows) else 0):
            model, by = _point_source(found, steps, free)
            variance = self.noise_dn**2 + np.maximum(model, 0.0) / self.gain_e_per_dn
            weighted = by * (counts / variance)[:, None]
            information = np.einsum("npij,nqij->npq", weighted, by)
            right = np.einsum("npij,nij->np", weighted, values - model)
            # A source with few pixels that are not full has no information of some, and a deviation that no one uses.
            least = _LEAST_SHARE * np.einsum("npp->np", information) + _LEAST_INFORMATION
            covariance = np.linalg.inv(information + least[:, None] * np.eye(free))
            excess = np.sum(counts * ((values - model) ** 2 - variance), axis=(1, 2))
            misfit = excess / np.maximum(np.sum(counts * values**2, axis=(1, 2)), self.noise_dn**2)
            step = np.einsum("npq,nq->np", covariance, right)
            step[:, :2] = np.clip(step[:, :2], -0.5, 0.5)
            if free == 4:
                step[:, 3] = np.clip(step[:, 3], -0.3 * found[:, 3], 0.3 * found[:, 3])
            found[:, :free] += step
            found[:, :2] = np.clip(found[:, :2], -2.0, 2.0)
            if np.abs(step[:, [0, 1, -1] if free == 4 else [0, 1]]).max() < _SETTLED_PX:
                break
        return found, np.sqrt(np.einsum("npp->np", covariance)), misfit


def _point_source(found: FloatArray, steps: IndexArray, free: int) -> tuple[FloatArray, FloatArray]:
    """Return pixels (n, k, k) of Gaussian sources and their derivatives (n, free, k, k) by u, v, flux and spread."""
    across, down = (_strip(found[:, axis, None], found[:, 3, None], steps, free == 4) for axis in (0, 1))
    flux = found[:, 2, None, None]

    def product(vertical: FloatArray, horizontal: FloatArray) -> FloatArray:
        return np.asarray(vertical[:, :, None] * horizontal[:, None, :])

    shape = product(down[0], across[0])
    by = [flux * product(down[0], across[1]), flux * product(down[1], across[0]), shape]
    if free == 4:
        by.append(flux * (product(down[2], across[0]) + product(down[0], across[2])))
    return flux * shape, np.stack(by, axis=1)


def _strip(centre: FloatArray, sigma: FloatArray, steps: IndexArray, by_sigma: bool) -> tuple[FloatArray, ...]:
    """Return the integral of a Gaussian over each pixel of a row, (n, k), and its derivatives by centre and sigma."""
    edges = (np.append(steps, steps[-1] + 1) - 0.5 - centre) / sigma
    bell = np.exp(-0.5 * edges**2) / (np.sqrt(2.0 * np.pi) * sigma)
    shares = np.diff(0.5 * erf(edges / np.sqrt(2.0)), axis=1)
    return shares, -np.diff(bell, axis=1), *((-np.diff(edges * bell, axis=1),) if by_sigma else ())

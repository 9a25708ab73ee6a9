"""The network of the learned detector, its input patches around proposed rims, and the rims of its outputs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from boresight.estimators.craters.detection.preparation import PreparedImage
from boresight.estimators.craters.kernels import LANES, NetworkWeights, apply_network
from boresight.estimators.craters.learned.proposals import pyramid
from boresight.scenarios.arrays import FloatArray, Image
from boresight.scenarios.geometry import Ellipses, pixel_to_opencv

SIDE = 32  # samples along either side of a patch
REACH = 2.0  # mean radii from the centre to the edge of a patch
SCALARS = 5  # further inputs of the network

STRIDE = 2  # of every convolution
OUTPUTS = 6  # log odds of a crater; displacement (2), log scale, elongation along and across the Sun (2)
SHAPES = {
    "conv1": (5 * 5 * 1, 12), "bias1": (12,),
    "conv2": (3 * 3 * 12, 24), "bias2": (24,),
    "conv3": (3 * 3 * 24, 32), "bias3": (32,),
    "dense1": ((SIDE // STRIDE**3) ** 2 * 32 + SCALARS, 64), "bias4": (64,),
    "dense2": (64, OUTPUTS), "bias5": (OUTPUTS,),
}  # fmt: skip
"""Of the weights: windows and channels of the three convolutions, inputs and outputs of the two dense layers."""

_LARGEST_STEP = 0.6  # of the radius or of its logarithm: the range of the training data


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """Weights by name, of the shapes in ``SHAPES``."""

    weights: Mapping[str, Image]

    def forward(self, pixels: Image, scalars: Image) -> Image:
        """Return (n, OUTPUTS) for patches (n, SIDE, SIDE, 1) and their numbers (n, SCALARS)."""
        outputs = np.empty((len(pixels), OUTPUTS), dtype=np.float32)
        weights = NetworkWeights(*(np.ascontiguousarray(self.weights[name].T) for name in SHAPES))
        apply_network(outputs, np.ascontiguousarray(pixels[..., 0]), scalars, weights)
        return outputs


@dataclass(frozen=True, slots=True, eq=False)
class PatchSource:
    """An image pyramid with the illumination and noise of the image.

    ``levels`` are the image and its halves, and ``sun_px`` (2,) points towards the Sun. ``sun_depth`` is the cosine of
    the angle between the Sun and the boresight, which is 180 degrees minus the phase angle. ``noise`` is that of the
    image, in its own units.
    """

    levels: tuple[Image, ...]
    sun_px: FloatArray
    sun_depth: float
    noise: float

    @classmethod
    def of(cls, image: Image, picture: PreparedImage, sun_dir_cam: FloatArray, noise: float) -> PatchSource:
        """Build a pyramid of five levels, enough for patches of the largest rims at the default number of levels."""
        return cls(tuple(pyramid(image, 5)), picture.sun_px, float(sun_dir_cam[2]), noise)


def patch_grid(ellipses: Ellipses, sun_px: FloatArray, level: int) -> tuple[Image, Image]:
    """Return the samples' columns and rows (n, SIDE * SIDE), as OpenCV counts them, in an image halved ``level`` times.

    Columns of a patch run towards the Sun, its rows 90 degrees onwards.
    """
    steps = (np.arange(SIDE) + 0.5) * (2.0 * REACH / SIDE) - REACH
    centre, radius = pixel_to_opencv(ellipses.centre_px / 2.0**level), ellipses.radius_px[:, None] / 2.0**level
    unit_u = (steps * sun_px[0] - steps[:, None] * sun_px[1]).ravel()
    unit_v = (steps * sun_px[1] + steps[:, None] * sun_px[0]).ravel()
    u, v = centre[:, :1] + radius * unit_u, centre[:, 1:] + radius * unit_v
    return u.astype(np.float32), v.astype(np.float32)


def cut_patches(source: PatchSource, ellipses: Ellipses) -> tuple[Image, Image]:
    """Cut a patch around each rim, from the level whose pixels are about as far apart as the samples.

    Return patches (n, SIDE, SIDE, 1) of zero mean and unit variance, and (n, SCALARS) further inputs.
    """
    n = len(ellipses)
    pixels = np.zeros((n, SIDE, SIDE), dtype=np.float32)
    # Sampling a finer level than the step would alias; a coarser one would lose detail.
    step = ellipses.radius_px * (2.0 * REACH / SIDE)
    level = np.clip(np.round(np.log2(np.maximum(step, 1e-6))), 0, len(source.levels) - 1).astype(np.int64)
    for i in np.unique(level):
        listed = np.flatnonzero(level == i)
        # Part by part, so that the places of their samples fit the cache.
        for rows in np.array_split(listed, len(listed) // LANES + 1):
            u, v = patch_grid(ellipses[rows], source.sun_px, int(i))
            found = cv2.remap(source.levels[i], u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            pixels[rows] = found.reshape(-1, SIDE, SIDE)
    mean = pixels.mean(axis=(1, 2))
    spread = np.maximum(pixels.std(axis=(1, 2)), 1e-9)
    # Brightness and contrast are divided out of the patch, and enter as separate inputs with a range of about -3 to 3.
    pixels -= mean[:, None, None]
    pixels /= spread[:, None, None]
    level_of = np.maximum(mean, 1e-3 * float(source.levels[0].max()))
    scalars = np.stack(
        [
            np.log(ellipses.radius_px / 12.0),
            np.log(spread / level_of) + 1.5,
            np.log(max(source.noise, 1e-6 * float(level_of.max())) / spread) + 2.0,
            np.full(n, 2.0 * source.sun_depth),
            np.clip(level_of / float(source.levels[-1].max()), 0.0, 2.0),
        ],
        axis=1,
    )
    return np.clip(pixels, -4.0, 4.0, out=pixels)[..., None], np.clip(scalars, -3.0, 3.0).astype(np.float32)


def shape_of(ellipses: Ellipses, sun_px: FloatArray) -> FloatArray:
    """Return smooth shape parameters (n, 3): log mean radius, and half the log ratio of the axes as a vector.

    The vector is (e cos 2p, e sin 2p) with p the angle from the Sun's direction to the longer axis; 0 for a circle.
    """
    axes = np.log(ellipses.semi_axes_px)
    elongation = 0.5 * (axes[:, 0] - axes[:, 1])
    # An axis has the period pi: twice its angle is continuous where the angle jumps from pi to 0.
    angle = 2.0 * (ellipses.angle_rad - np.arctan2(sun_px[1], sun_px[0]))
    return np.stack([axes.mean(axis=1), elongation * np.cos(angle), elongation * np.sin(angle)], axis=1)


def ellipses_of(centre_px: FloatArray, shape: FloatArray, sun_px: FloatArray) -> Ellipses:
    """Convert (n, 2) centres and (n, 3) shapes, as in ``shape_of``, to rims."""
    elongation = np.hypot(shape[:, 1], shape[:, 2])
    angle = 0.5 * np.arctan2(shape[:, 2], shape[:, 1]) + np.arctan2(sun_px[1], sun_px[0])
    axes = np.exp(shape[:, :1] + elongation[:, None] * np.array([1.0, -1.0]))
    return Ellipses(centre_px, axes, angle % np.pi)


def patch_axes(sun_px: FloatArray) -> FloatArray:
    """Return the (2, 2) matrix whose rows are the axes of patches: towards the Sun, and 90 degrees onwards."""
    return np.array([sun_px, [-sun_px[1], sun_px[0]]])


def target_outputs(seen: Ellipses, truth: Ellipses, sun_px: FloatArray) -> FloatArray:
    """Return the outputs (n, 5) to train for: those that take the patches about ``seen`` to the rims ``truth``."""
    radius = seen.radius_px[:, None]
    moved = (truth.centre_px - seen.centre_px) @ patch_axes(sun_px).T / radius
    shape = shape_of(truth, sun_px)
    shape[:, 0] -= np.log(radius[:, 0])
    return np.concatenate([moved, shape], axis=1)


def rims_from_outputs(seen: Ellipses, outputs: FloatArray, sun_px: FloatArray) -> Ellipses:
    """Apply the network's outputs (n, 5) to the rims ``seen`` of its patches: the inverse of ``target_outputs``."""
    radius = seen.radius_px[:, None]
    outputs = np.asarray(outputs, dtype=np.float64)
    # Outside the range of the training data the outputs are extrapolations.
    step = np.clip(outputs[:, :2], -_LARGEST_STEP, _LARGEST_STEP)
    centre = seen.centre_px + radius * step @ patch_axes(sun_px)
    shape = outputs[:, 2:].copy()
    shape[:, 0] = np.clip(shape[:, 0], -_LARGEST_STEP, _LARGEST_STEP) + np.log(radius[:, 0])
    return ellipses_of(centre, shape, sun_px)

"""Images of height fields, and what of their craters can be seen, in batches on a GPU.

The image is turned so that the Sun is along its columns (towards greater ones), but for an error of some degrees.
Lengths are in pixels of the image; x and y are continuous, 0 at the outer edge of the first pixel.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from training.cratered_fields import RINGS

SIDE = 256  # of an image
WINDOW = 20.0  # standard deviation of the window that evens brightness and contrast out
_ANGLES = 16
_SUN_ERROR_DEG = 10.0


@dataclass(frozen=True, slots=True)
class Seen:
    """Craters (batch, n) of images: centre, mean radius, elongation along the columns and along their diagonal.

    An elongation is (a - b) / (a + b) of the semi-axes times the cosine and the sine of twice the angle of the longer.
    ``clear`` are craters that everybody sees, ``doubtful`` those that nobody is blamed for finding or missing.
    """

    x: Tensor
    y: Tensor
    radius: Tensor
    along: Tensor
    across: Tensor
    clear: Tensor
    doubtful: Tensor


@dataclass(frozen=True, slots=True)
class Geometry:
    """Incidence (batch,), direction to the camera (batch, 3), and the matrix (batch, 2, 2) from ground to image."""

    incidence: Tensor
    camera: Tensor
    matrix: Tensor


class Draw:
    """Random numbers of one generator on one device."""

    def __init__(self, seed: int, device: torch.device) -> None:
        self.device = device
        self.generator = torch.Generator(device).manual_seed(seed)

    def uniform(self, low: float, high: float, *shape: int) -> Tensor:
        """Draw uniformly."""
        return low + (high - low) * torch.rand(shape, generator=self.generator, device=self.device)

    def log_uniform(self, low: float, high: float, *shape: int) -> Tensor:
        """Draw uniformly in the logarithm."""
        return torch.exp(self.uniform(float(np.log(low)), float(np.log(high)), *shape))

    def normal(self, *shape: int) -> Tensor:
        """Draw from the standard normal distribution."""
        return torch.randn(shape, generator=self.generator, device=self.device)

    def chance(self, share: float, *shape: int) -> Tensor:
        """Draw truth values that are true with a probability."""
        return torch.rand(shape, generator=self.generator, device=self.device) < share


def rough(draw: Draw, n: int, side: int, shortest: float, longest: float, power: Tensor) -> Tensor:
    """Draw random fields (n, side, side) of zero mean with a power law of amplitudes between two wavelengths."""
    fy = torch.fft.fftfreq(side, device=draw.device)[:, None]
    fx = torch.fft.rfftfreq(side, device=draw.device)[None]
    frequency = torch.sqrt(fx**2 + fy**2)
    band = (frequency > 1.0 / longest) & (frequency < 1.0 / shortest)
    size = torch.where(band, frequency.clamp_min(1e-6) ** -power[:, None, None], 0.0)
    return torch.fft.irfft2(torch.fft.rfft2(draw.normal(n, side, side)) * size, s=(side, side))


def slopes(height: Tensor) -> tuple[Tensor, Tensor]:
    """Return central differences along x and y."""
    padded = F.pad(height[:, None], (1, 1, 1, 1), mode="replicate")[:, 0]
    return 0.5 * (padded[:, 1:-1, 2:] - padded[:, 1:-1, :-2]), 0.5 * (padded[:, 2:, 1:-1] - padded[:, :-2, 1:-1])


def draw_geometry(draw: Draw, n: int) -> Geometry:
    """Draw the Sun's incidence (mostly low Suns), and the camera: overhead, or up to 50 degrees aslant."""
    low = draw.uniform(45.0, 84.0, n)
    incidence = torch.deg2rad(torch.where(draw.chance(0.2, n), draw.uniform(20.0, 50.0, n), low))
    aslant = torch.where(draw.chance(0.35, n), draw.uniform(5.0, 50.0, n), draw.uniform(0.0, 5.0, n))
    emission, towards = torch.deg2rad(aslant), draw.uniform(0.0, 2.0 * np.pi, n)
    c, s = torch.cos(towards), torch.sin(towards)

    def sun_in_image(emission: Tensor) -> tuple[Tensor, Tensor]:
        forward = torch.sin(incidence) * c * torch.cos(emission) - torch.cos(incidence) * torch.sin(emission)
        sideways = -torch.sin(incidence) * s
        return c * forward - s * sideways, s * forward + c * sideways

    # A Sun near the camera has no direction in the image: such images are taken from overhead.
    emission = torch.where(torch.hypot(*sun_in_image(emission)) < 0.25, 0.0, emission)
    u, v = sun_in_image(emission)
    turn = -torch.atan2(v, u) + torch.deg2rad(_SUN_ERROR_DEG * draw.normal(n))
    e = torch.cos(emission)
    plane = torch.stack([e * c * c + s * s, (e - 1.0) * c * s, (e - 1.0) * c * s, e * s * s + c * c], -1).view(n, 2, 2)
    roll = torch.stack([torch.cos(turn), -torch.sin(turn), torch.sin(turn), torch.cos(turn)], -1).view(n, 2, 2)
    camera = torch.stack([torch.sin(emission) * c, torch.sin(emission) * s, e], -1)
    return Geometry(incidence, camera, roll @ plane)


def shade(height: Tensor, albedo: Tensor, geometry: Geometry, lunar: Tensor, ambient: Tensor) -> tuple[Tensor, Tensor]:
    """Return radiance (batch, side, side) and the share of light: Lambert to Lommel-Seeliger, with cast shadows.

    The Sun is towards greater x, so that the shadows follow from a running maximum along the rows.
    """
    slope_x, slope_y = slopes(height)
    sin_i, cos_i = torch.sin(geometry.incidence)[:, None, None], torch.cos(geometry.incidence)[:, None, None]
    cx, cy, cz = (geometry.camera[:, k, None, None] for k in range(3))
    length = torch.sqrt(1.0 + slope_x**2 + slope_y**2)
    mu0 = ((cos_i - slope_x * sin_i) / length).clamp_min(0.0)
    mu = ((cz - slope_x * cx - slope_y * cy) / length).clamp_min(0.05)
    rise = cos_i / sin_i
    place = torch.arange(height.shape[2], device=height.device)
    level = height - rise * place
    horizon = torch.cummax(level.flip(2), dim=2).values.flip(2)
    ahead = torch.cat([horizon[..., 1:], torch.full_like(horizon[..., :1], -1e9)], 2)
    lit = (1.0 - (ahead - level) / rise).clamp(0.0, 1.0)  # soft over the shadow of one pixel
    lunar, ambient = lunar[:, None, None], ambient[:, None, None]
    value = mu0 * ((1.0 - lunar) + 2.0 * lunar / (mu0 + mu))
    flat = cos_i * ((1.0 - lunar) + 2.0 * lunar / (cos_i + cz))
    return (value * lit / flat + ambient) * albedo, lit * (mu0 > 0.0)


def find_visible(
    height: Tensor, lit: Tensor, craters: Tensor, geometry: Geometry, noise: Tensor
) -> tuple[Tensor, Tensor]:
    """Say which craters (batch, n) are clear and which doubtful: by the relief that is left, contrast, noise and light.

    The ground around a crater is compared with the crater's own profile, after its plane is taken away.
    """
    n, side = height.shape[0], height.shape[-1]
    rings = torch.as_tensor(RINGS, device=height.device)
    angle = torch.arange(_ANGLES, device=height.device) * (2.0 * np.pi / _ANGLES)
    unit = torch.stack([rings[:, None] * torch.cos(angle), rings[:, None] * torch.sin(angle)], -1).view(-1, 2)
    radius = craters[..., 2].clamp_min(1.0)
    place = craters[:, :, None, :2] + radius[..., None, None] * unit
    fields = torch.stack([height, lit.to(height.dtype)], 1)
    found = F.grid_sample(fields, place * (2.0 / side) - 1.0, padding_mode="border", align_corners=False)
    weight = rings.repeat_interleave(_ANGLES)
    weight = weight / weight.sum()
    ground = found[:, 0] - (found[:, 0] * weight).sum(-1, keepdim=True)
    square = (weight * unit[:, 0] ** 2).sum()
    for axis in (0, 1):
        tilt = (ground * weight * unit[:, axis]).sum(-1, keepdim=True) / square
        ground = ground - tilt * unit[:, axis]
    own = craters[..., 4:].repeat_interleave(_ANGLES, dim=2)
    own = own - (own * weight).sum(-1, keepdim=True)
    cross, energy = (weight * ground * own).sum(-1), (weight * own**2).sum(-1).clamp_min(1e-12)
    left = cross / energy
    alike = cross / torch.sqrt(energy * (weight * ground**2).sum(-1).clamp_min(1e-12))
    depth = left * (craters[..., 4:].amax(-1) - craters[..., 4:].amin(-1))
    contrast = depth / radius * torch.tan(geometry.incidence)[:, None]
    strength = 0.9 * contrast * radius / noise[:, None]
    light = found[:, 1].view(n, -1, len(rings), _ANGLES)[:, :, -3:].mean((2, 3))
    cut, real = craters[..., 3], craters[..., 2] > 0.0

    def judge(left_min: float, alike_min: float, contrast_min: float, noise_min: float, light_min: float) -> Tensor:
        shape = (left > left_min) & (alike > alike_min)
        return real & shape & (contrast > contrast_min) & (strength > noise_min) & (light > light_min)

    clear = judge(0.5, 0.6, 0.06, 5.0, 0.35) & (cut < 0.55)
    return clear, judge(0.25, 0.35, 0.025, 1.5, 0.1) & ~clear


def project(craters: Tensor, side: int, geometry: Geometry, clear: Tensor, doubtful: Tensor) -> Seen:
    """Take craters of the ground (batch, n, columns) to the image."""
    m = geometry.matrix
    place = torch.einsum("bij,bnj->bni", m, craters[..., :2] - side / 2.0) + SIDE / 2.0
    gram = m @ m.transpose(1, 2)
    trace, difference = gram[:, 0, 0] + gram[:, 1, 1], gram[:, 0, 0] - gram[:, 1, 1]
    spread = torch.sqrt(difference**2 + 4.0 * gram[:, 0, 1] ** 2)
    longer, shorter = torch.sqrt(0.5 * (trace + spread)), torch.sqrt((0.5 * (trace - spread)).clamp_min(1e-6))
    size = ((longer - shorter) / (longer + shorter) / spread.clamp_min(1e-6))[:, None]
    size = size.expand(craters.shape[:2])
    radius = craters[..., 2] * torch.sqrt(longer * shorter)[:, None]
    inside = ((place > 0.0) & (place < SIDE)).all(-1)
    along, across = size * difference[:, None], size * (2.0 * gram[:, 0, 1])[:, None]
    return Seen(place[..., 0], place[..., 1], radius, along, across, clear & inside, doubtful & inside)


def look(radiance: Tensor, geometry: Geometry) -> tuple[Tensor, Tensor]:
    """Resample radiance of the ground to the image (batch, SIDE, SIDE); also return where there is ground."""
    n, side = radiance.shape[0], radiance.shape[-1]
    m = geometry.matrix
    turned = torch.stack([m[:, 1, 1], -m[:, 0, 1], -m[:, 1, 0], m[:, 0, 0]], -1).view(n, 2, 2)
    back = turned / (m[:, 0, 0] * m[:, 1, 1] - m[:, 0, 1] * m[:, 1, 0])[:, None, None] * (SIDE / side)
    theta = torch.cat([back, torch.zeros_like(back[..., :1])], 2)
    grid = F.affine_grid(theta, [n, 1, SIDE, SIDE], align_corners=False)
    fields = torch.stack([radiance, torch.ones_like(radiance)], 1)
    found = F.grid_sample(fields, grid, padding_mode="zeros", align_corners=False)
    return found[:, 0], found[:, 1] > 0.99


@lru_cache(maxsize=4)
def window_matrix(sigma: float, side: int, device: torch.device) -> Tensor:
    """Return the matrix (side, side) of a Gaussian window of 3 standard deviations, mirrored at both ends."""
    reach = int(3.0 * sigma)
    kernel = torch.exp(-0.5 * (torch.arange(-reach, reach + 1) / sigma) ** 2)
    padded = F.pad(torch.eye(side)[None], (reach, reach), mode="reflect")
    return F.conv1d(padded[0][:, None], (kernel / kernel.sum())[None, None])[:, 0].to(device)


def window_mean(image: Tensor) -> Tensor:
    """Return the mean of images (batch, SIDE, SIDE) in the window around each pixel."""
    matrix = window_matrix(WINDOW, SIDE, image.device)
    return matrix.T @ image @ matrix


def blur(image: Tensor, sigma: Tensor, reach: int) -> Tensor:
    """Blur images (batch, rows, columns) by Gaussians of standard deviations (batch,)."""
    n = image.shape[0]
    place = torch.arange(-reach, reach + 1, device=image.device, dtype=image.dtype)
    kernel = torch.exp(-0.5 * (place / sigma[:, None]) ** 2)
    kernel = kernel / kernel.sum(1, keepdim=True)
    padded = F.pad(image[None], (reach, reach, reach, reach), mode="reflect")
    once = F.conv2d(padded, kernel[:, None, None, :], groups=n)
    return F.conv2d(once, kernel[:, None, :, None], groups=n)[0]


def expose(draw: Draw, image: Tensor, noise: Tensor) -> Tensor:
    """Blur by optics, change the gain across a seam, add noise, stretch the tones, and round to 8 bits now and then."""
    n = len(image)
    image = blur(image, draw.uniform(0.35, 1.2, n), 5)
    rows = torch.arange(SIDE, device=image.device, dtype=image.dtype)
    angle, away = draw.uniform(0.0, 2.0 * np.pi, n), draw.uniform(-100.0, 100.0, n)
    c, s = torch.cos(angle)[:, None, None], torch.sin(angle)[:, None, None]
    beyond = c * (rows - SIDE / 2) + s * (rows - SIDE / 2)[:, None] > away[:, None, None]
    gain = torch.where(draw.chance(0.1, n), draw.log_uniform(0.6, 1.6, n), 1.0)[:, None, None]
    image = image * torch.where(beyond, gain, 1.0)
    level = noise[:, None, None] * torch.sqrt(0.3 + 0.7 * image.clamp_min(0.0))
    image = image + level * draw.normal(n, SIDE, SIDE)
    flat = image.reshape(n, -1)[:, ::17]
    high = torch.quantile(flat, 0.995, dim=1).clamp_min(0.2) * draw.uniform(0.8, 1.4, n)
    low = torch.where(draw.chance(0.5, n), 0.0, torch.quantile(flat, 0.01, dim=1)) * draw.uniform(0.0, 0.95, n)
    toned = ((image - low[:, None, None]) / (high - low).clamp_min(0.05)[:, None, None]).clamp(0.0, 1.0)
    toned = 255.0 * toned ** draw.log_uniform(0.55, 1.6, n)[:, None, None]
    rounded = draw.chance(0.7, n)[:, None, None]
    return torch.where(rounded, toned.round(), toned)


def draw_limb(draw: Draw, n: int) -> Tensor:
    """Draw masks of ground: all of the image, or one side of a wavy line."""
    rows = torch.arange(SIDE, device=draw.device, dtype=torch.float32) - SIDE / 2
    angle, away = draw.uniform(0.0, 2.0 * np.pi, n), draw.uniform(-60.0, 100.0, n)
    c, s = torch.cos(angle)[:, None, None], torch.sin(angle)[:, None, None]
    along, off = c * rows[:, None] - s * rows, c * rows + s * rows[:, None]
    wave = draw.uniform(0.0, 8.0, n)[:, None, None]
    off = off + wave * torch.sin(along / 20.0) + along**2 * draw.uniform(0.0, 1.0 / 400.0, n)[:, None, None]
    return (off < away[:, None, None]) | ~draw.chance(0.15, n)[:, None, None]


def channels(image: Tensor, ground: Tensor) -> Tensor:
    """Return what the network is given (batch, 2, rows, columns): contrast in local units, and relative brightness.

    Both are the brightness minus its local mean over the ground; the first is divided by the local standard deviation,
    the second by that mean; 0 off the ground.
    """
    weight = ground.to(image.dtype)
    share = window_mean(weight).clamp_min(1e-3)
    mean = window_mean(image * weight) / share
    square = window_mean((image - mean) ** 2 * weight) / share
    spread = torch.sqrt(square + (0.02 * mean) ** 2).clamp_min(1e-6)
    even = ((image - mean) / spread).clamp(-4.0, 4.0)
    relief = ((image - mean) / mean.clamp_min(1e-6)).clamp(-1.0, 2.0)
    return torch.stack([even * weight, relief * weight], 1)


def draw_images(draw: Draw, height: Tensor, albedo: Tensor, craters: Tensor) -> tuple[Tensor, Seen]:
    """Draw images of fields as `draw_views` does, and return them in the network's channels (batch, 2, SIDE, SIDE)."""
    image, ground, seen = draw_views(draw, height, albedo, craters)
    return channels(image, ground), seen


def draw_views(draw: Draw, height: Tensor, albedo: Tensor, craters: Tensor) -> tuple[Tensor, Tensor, Seen]:
    """Draw images (batch, SIDE, SIDE) of fields (batch, side, side), where there is ground in them, and their craters.

    ``craters`` (batch, n, columns) are those of `training.cratered_fields.draw_field`, 0 in unused rows.
    """
    n, side = height.shape[0], height.shape[-1]
    geometry = draw_geometry(draw, n)
    rise = 1.0 / torch.tan(geometry.incidence)
    hills = rough(draw, n, side, 100.0, 800.0, torch.full((n,), 2.0, device=draw.device))
    fine = rough(draw, n, side, 2.0, 60.0, draw.uniform(1.4, 2.4, n))
    for field, slope in (
        (hills, torch.minimum(draw.log_uniform(0.01, 0.25, n), 0.5 * rise)),
        (fine, torch.minimum(draw.log_uniform(0.004, 0.1, n), 0.5 * rise)),
    ):
        tilt = sum((part**2).mean((1, 2)) for part in slopes(field))
        height = height + field * (slope / torch.sqrt(tilt).clamp_min(1e-9))[:, None, None]
    pattern = rough(draw, n, side, 3.0, 300.0, draw.uniform(1.0, 2.0, n))
    pattern = pattern / pattern.std((1, 2), keepdim=True).clamp_min(1e-9)
    brightness = (1.0 + albedo + draw.log_uniform(0.005, 0.12, n)[:, None, None] * pattern).clamp_min(0.2)
    noise = draw.log_uniform(0.003, 0.08, n)
    radiance, lit = shade(height, brightness, geometry, draw.uniform(0.0, 1.0, n), draw.uniform(0.0, 0.04, n))
    clear, doubtful = find_visible(height, lit, craters, geometry, noise)
    image, ground = look(radiance, geometry)
    ground = ground & draw_limb(draw, n)
    image = expose(draw, image * ground, noise)
    # The detector erodes the ground by some pixels, too.
    ground = -F.max_pool2d(-ground[:, None].to(image.dtype), 9, 1, 4)[:, 0] > 0.5
    seen = project(craters, side, geometry, clear, doubtful)
    on = F.grid_sample(
        ground[:, None].to(image.dtype), torch.stack([seen.x, seen.y], -1)[:, None] * (2.0 / SIDE) - 1.0,
        align_corners=False,
    )[:, 0, 0] > 0.5  # fmt: skip
    seen = Seen(seen.x, seen.y, seen.radius, seen.along, seen.across, seen.clear & on, seen.doubtful & on)
    return image, ground, seen

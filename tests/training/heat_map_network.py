"""The heat map network in torch, its targets and its loss, as it is trained.

Of every second pixel and of each band of radii it returns the logit of a crater's centre there, and its place, radius
and elongation. Batch normalisation is folded into the convolutions in the weights that are written.
"""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from training.field_images import SIDE, Seen

STRIDE = 2  # pixels of the image for one of the heat map
BANDS_PX = (2.5, 4.5, 8.1, 14.6, 26.2)  # radii in the middle of each band
STEP = float(np.log(1.8))  # between the logarithms of the bands
RADIUS_PX = (2.1, 36.0)  # taught; craters a little beyond are neither right nor wrong
DOUBTFUL_PX = (1.6, 52.0)
DOUBTFUL_WEIGHT = 0.1  # of a doubtful crater where it is called none: the less plain, the lower the logit
OUTPUTS = 6  # of each band: logit, place along x and y, log radius, elongation along and across
_REACH = 5  # cells on either side of a centre that targets reach


class Layer(nn.Sequential):
    """A convolution of 3 x 3, normalisation and rectification."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        convolution = nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False)
        super().__init__(convolution, nn.BatchNorm2d(outputs), nn.ReLU(inplace=True))


class HeatMap(nn.Module):
    """A U-Net whose branches are added: from a half to a sixteenth of the resolution and back."""

    def __init__(self, widths: tuple[int, int, int, int] = (24, 48, 64, 96)) -> None:
        super().__init__()
        a, b, c, d = widths
        self.stem = Layer(8, a)
        self.second = Layer(a, a)
        self.down4, self.quarter = Layer(a, b, 2), Layer(b, b)
        self.down8, self.eighth = Layer(b, c, 2), Layer(c, c)
        self.down16, self.deep1, self.deep2 = Layer(c, d, 2), Layer(d, d), Layer(d, d)
        self.side8, self.side4, self.side2 = nn.Conv2d(d, c, 1), nn.Conv2d(c, b, 1), nn.Conv2d(b, a, 1)
        self.up8, self.up4, self.up2 = Layer(c, c), Layer(b, b), Layer(a, 2 * a)
        self.head = nn.Conv2d(2 * a, len(BANDS_PX) * OUTPUTS, 1)
        with torch.no_grad():
            self.head.bias.view(len(BANDS_PX), OUTPUTS)[:, 0] = -4.0

    def forward(self, image: Tensor) -> Tensor:
        """Return (batch, bands, OUTPUTS, rows / 2, columns / 2) of images (batch, 2, rows, columns)."""
        two = self.second(self.stem(F.pixel_unshuffle(image, 2)))
        four = self.quarter(self.down4(two))
        eight = self.eighth(self.down8(four))
        x = self.deep2(self.deep1(self.down16(eight)))
        for skip, side, up in (
            (eight, self.side8, self.up8),
            (four, self.side4, self.up4),
            (two, self.side2, self.up2),
        ):
            x = up(skip + F.interpolate(side(x), scale_factor=2.0, mode="nearest"))
        found = self.head(x)
        return found.view(found.shape[0], len(BANDS_PX), OUTPUTS, *found.shape[2:])


class Targets:
    """What the network is to return for the craters of images.

    ``heat`` (batch, bands, cells, cells) is 1 in the cell of a centre and falls off around it, ``weight`` is small
    around doubtful craters. ``cells`` (m,) of the flat heat map have ``values`` (m, OUTPUTS - 1).
    """

    def __init__(self, seen: Seen) -> None:
        batch, cells = seen.x.shape[0], SIDE // STRIDE
        device = seen.x.device
        size = batch * len(BANDS_PX) * cells * cells
        taught = (seen.radius >= RADIUS_PX[0]) & (seen.radius <= RADIUS_PX[1])
        near = (seen.radius >= DOUBTFUL_PX[0]) & (seen.radius <= DOUBTFUL_PX[1])
        heat, weight = torch.zeros(size, device=device), torch.ones(size, device=device)

        unsure = _Windows(seen, (seen.doubtful & near) | (seen.clear & near & ~taught))
        unsure_cells = unsure.flat[unsure.inside & (unsure.apart < 0.5 * unsure.radius) & (unsure.share > 0.1)]
        weight[unsure_cells] = DOUBTFUL_WEIGHT

        sure = _Windows(seen, seen.clear & taught)
        spread = (0.18 * sure.radius).clamp(1.2, 4.4)
        value = torch.where(sure.inside, sure.share * torch.exp(-0.5 * (sure.apart / spread) ** 2), 0.0)
        flat = sure.flat.clamp(0, size - 1)
        heat.scatter_reduce_(0, flat.reshape(-1), value.reshape(-1), "amax")
        own = sure.inside & sure.first & (value >= heat[flat] - 1e-6) & (value > 0.3)
        middle = sure.inside & sure.first & sure.middle
        heat[sure.flat[middle]] = 1.0
        self.heat = heat.view(batch, len(BANDS_PX), cells, cells)
        self.weight = torch.where(self.heat == 1.0, 1.0, weight.view_as(self.heat))
        self.cells = sure.flat[own]
        self.values = sure.values.expand(*own.shape, -1)[own]


class _Windows:
    """Cells (craters, bands, window) around the centres of chosen craters, and what is true of them there."""

    def __init__(self, seen: Seen, chosen: Tensor) -> None:
        cells = SIDE // STRIDE
        image = torch.nonzero(chosen)[:, 0][:, None, None]
        x, y, radius = (part[chosen][:, None, None] for part in (seen.x, seen.y, seen.radius))
        bands = torch.log(torch.tensor(BANDS_PX, device=x.device))[None, :, None]
        k = torch.arange(-_REACH, _REACH + 1, device=x.device)
        row, column = (part.reshape(1, 1, -1) for part in torch.meshgrid(k, k, indexing="ij"))
        u, v = torch.floor(x / STRIDE).long() + column, torch.floor(y / STRIDE).long() + row
        dx, dy = (u + 0.5) * STRIDE - x, (v + 0.5) * STRIDE - y
        log = torch.log(radius) - bands
        # Bands meet half a step from their middles; beyond, a crater is theirs less and less.
        self.share = torch.exp(-0.5 * ((log.abs() - 0.5 * STEP).clamp_min(0.0) / 0.15) ** 2)
        nearest = log.abs() == log.abs().amin(1, keepdim=True)
        shape = torch.broadcast_shapes(u.shape, bands.shape)
        self.inside = ((u >= 0) & (u < cells) & (v >= 0) & (v < cells)).expand(shape)
        self.first = nearest.expand(shape)
        self.middle = ((column == 0) & (row == 0)).expand(shape)
        self.apart, self.radius = torch.hypot(dx, dy).expand(shape), radius
        band = torch.arange(len(BANDS_PX), device=x.device)[None, :, None]
        self.flat = ((image * len(BANDS_PX) + band) * cells + v) * cells + u
        middle = torch.exp(bands)
        elongation = [part[chosen][:, None, None].expand(shape) for part in (seen.along, seen.across)]
        self.values = torch.stack([(-dx / middle).expand(shape), (-dy / middle).expand(shape), log.expand(shape),
                                   *elongation], -1)  # fmt: skip


def loss_of(outputs: Tensor, targets: Targets) -> tuple[Tensor, Tensor]:
    """Return the focal loss of the centres (Law and Deng 2018, eq. 1), and the mean error of places and radii."""
    outputs = outputs.float()
    logit, heat = outputs[:, :, 0], targets.heat
    log_p, log_q = F.logsigmoid(logit), F.logsigmoid(-logit)
    p = torch.exp(log_p)
    centre = heat == 1.0
    right = -((1.0 - p) ** 2) * log_p
    wrong = -((1.0 - heat) ** 4) * p**2 * log_q * targets.weight
    focal = torch.where(centre, right, wrong).sum() / centre.sum().clamp_min(1)
    found = outputs[:, :, 1:].permute(0, 1, 3, 4, 2).reshape(-1, OUTPUTS - 1)[targets.cells]
    return focal, F.smooth_l1_loss(found, targets.values, beta=0.05) * (OUTPUTS - 1)


def folded(network: HeatMap) -> dict[str, np.ndarray]:
    """Return the convolutions' kernels and biases by name, normalisation folded in, in half precision."""
    weights = {}
    for name, part in network.named_children():
        if isinstance(part, Layer):
            norm = part[1]
            gain = norm.weight / torch.sqrt(norm.running_var + norm.eps)
            kernel, bias = part[0].weight * gain[:, None, None, None], norm.bias - norm.running_mean * gain
        else:
            kernel, bias = part.weight, part.bias
        for key, value in (("kernel", kernel), ("bias", bias)):
            weights[f"{name}_{key}"] = value.detach().float().cpu().numpy().astype(np.float16)
    return weights

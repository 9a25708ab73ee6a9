"""Train the heat map of craters on synthetic ground.

Run as ``PYTHONPATH=tests python3 -m training.heat_map --minutes 7 --out FOLDER --seed 7``, best on a GPU. It needs
torch, numpy, OpenCV and numba, nothing of boresight. Into the folder it writes ``heat_map.npz`` (the weights),
``loss.csv`` (the loss and the recall on held-out ground) and ``heat_map.json`` (how they were made).
"""

from __future__ import annotations

import argparse
import copy
import hashlib
import json
import math
import os
import sys
import time
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TextIO

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from training import cratered_fields as fields
from training.field_images import Draw, Seen, draw_images
from training.heat_map_network import BANDS_PX, OUTPUTS, STRIDE, HeatMap, Layer, Targets, folded, loss_of

_CHUNK = 16  # fields that a thread draws at a time
_MOST_PEAKS = 800  # of an image of 256 x 256 pixels
_COUNTED_PX = (2.6, 32.0)  # radii of the craters that the recall is of
_HELD_OUT = 900_000_000  # seeds of fields for the recall start here


@dataclass(frozen=True, slots=True)
class Course:
    """All that decides the training: ``pool`` fields are kept, ``fresh`` of them replaced in each step."""

    seed: int = 7
    minutes: float = 7.0
    batch: int = 64
    pool: int = 2048
    fresh: int = 12
    rate: float = 2e-3
    decay: float = 1e-2
    place_weight: float = 1.0
    held_out: int = 128


Block = tuple[Tensor, Tensor, Tensor]


def draw_block(first: int, profiles: fields.Floats, count: int = _CHUNK) -> Block:
    """Draw fields of successive seeds: heights, albedo (count, SIDE, SIDE) and craters (count, TABLE, COLUMNS)."""
    shape = (count, fields.SIDE, fields.SIDE)
    height, albedo = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    craters = np.zeros((count, fields.TABLE, fields.COLUMNS), np.float32)
    for k in range(count):
        fields.draw_field(np.random.default_rng(first + k), profiles, height[k], albedo[k], craters[k])
    return torch.from_numpy(height), torch.from_numpy(albedo.astype(np.float16)), torch.from_numpy(craters)


class Pool:
    """Fields on the device, the oldest replaced by those that threads draw meanwhile, in the order of their seeds."""

    def __init__(self, course: Course, device: torch.device, workers: int) -> None:
        self.device, self.fresh = device, course.fresh
        self.profiles = fields.profiles()
        draw_block(0, self.profiles, 1)  # compiles
        self.threads = ThreadPoolExecutor(workers)
        self.next = course.seed * 10_000_000
        self.waiting: deque[Future[Block]] = deque()
        side, n = fields.SIDE, max(course.pool // _CHUNK, 1) * _CHUNK
        self.height = torch.zeros((n, side, side), device=device)
        self.albedo = torch.zeros((n, side, side), device=device, dtype=torch.float16)
        self.craters = torch.zeros((n, fields.TABLE, fields.COLUMNS), device=device)
        self.oldest, self.owed = 0, 0
        self.waited_s = 0.0
        self._order(n // _CHUNK)
        for _ in range(n // _CHUNK):
            self._replace()

    def _order(self, count: int) -> None:
        for _ in range(count):
            self.waiting.append(self.threads.submit(draw_block, self.next, self.profiles))
            self.next += _CHUNK

    def _replace(self) -> None:
        started = time.monotonic()
        block = self.waiting.popleft().result()
        self.waited_s += time.monotonic() - started
        rows = slice(self.oldest, self.oldest + _CHUNK)
        for own, new in zip((self.height, self.albedo, self.craters), block, strict=True):
            own[rows] = new.to(self.device)
        self.oldest = (self.oldest + _CHUNK) % len(self.height)

    def draw(self, draw: Draw, n: int) -> Block:
        """Take fields at random, all turned or mirrored in one of eight ways, and replace the oldest."""
        self._order(max(64 - len(self.waiting), 0))
        self.owed += self.fresh
        while self.owed >= _CHUNK:
            self._replace()
            self.owed -= _CHUNK
        rows = torch.randint(len(self.height), (n,), generator=draw.generator, device=self.device)
        turn = int(torch.randint(8, (1,), generator=draw.generator, device=self.device))
        return turned((self.height[rows], self.albedo[rows].float(), self.craters[rows]), turn)

    def close(self) -> None:
        """End the threads."""
        self.threads.shutdown(wait=False, cancel_futures=True)


def turned(block: Block, turn: int) -> Block:
    """Mirror fields across x (1), across y (2), and swap x with y (4)."""
    height, albedo, craters = block
    x, y = craters[..., 0], craters[..., 1]
    side = height.shape[-1]
    for axis, bit in ((2, 1), (1, 2)):
        if turn & bit:
            height, albedo = height.flip(axis), albedo.flip(axis)
            x, y = (side - x, y) if bit == 1 else (x, side - y)
    if turn & 4:
        height, albedo, x, y = height.transpose(1, 2), albedo.transpose(1, 2), y, x
    return height.contiguous(), albedo.contiguous(), torch.cat([x[..., None], y[..., None], craters[..., 2:]], -1)


def peaks(outputs: Tensor, least: float) -> tuple[np.ndarray, np.ndarray]:
    """Return x, y, radius (n, 3) and logits (n,) of maxima of an image's heat map (bands, OUTPUTS, cells, cells)."""
    logit = outputs[:, 0]
    top = F.max_pool2d(logit[:, None], 3, 1, 1)[:, 0]
    band, row, column = torch.nonzero((logit >= top) & (logit > least), as_tuple=True)
    values = outputs[band, :, row, column]
    middle = torch.tensor(BANDS_PX, device=outputs.device)[band]
    x = (column + 0.5) * STRIDE + values[:, 1] * middle
    y = (row + 0.5) * STRIDE + values[:, 2] * middle
    found = torch.stack([x, y, middle * torch.exp(values[:, 3])], 1).cpu().numpy()
    return found, values[:, 0].cpu().numpy()


def suppressed(found: np.ndarray, logit: np.ndarray) -> np.ndarray:
    """Return rows of the peaks that no likelier one nearby resembles (centre within 0.5 radii, ratio within 1.6)."""
    order, kept = np.argsort(-logit)[:_MOST_PEAKS], []
    for i in order:
        rest = found[kept]
        apart = np.hypot(*(rest[:, :2] - found[i, :2]).T)
        near = apart < 0.5 * np.minimum(rest[:, 2], found[i, 2])
        if not np.any(near & (np.abs(np.log(rest[:, 2] / found[i, 2])) < 0.47)):
            kept.append(i)
    return np.array(kept, dtype=int)


def recall(network: HeatMap, images: Tensor, seen: Seen, false_share: float = 0.1) -> tuple[float, float]:
    """Return the share of clear craters found at a share of false alarms, and the logit of that threshold.

    Right is a centre within half a radius of a crater's and a radius within a factor of exp(0.5) of its own. False
    is a peak that is right of no crater at all.
    """
    logits, hits, clear_total = [], [], 0
    for k in range(len(images)):
        with torch.no_grad():
            outputs = network(images[k : k + 1])[0].float()
        found, logit = peaks(outputs, -4.0)
        rows = suppressed(found, logit)
        found, logit = found[rows], logit[rows]
        parts = (seen.x, seen.y, seen.radius, seen.clear, seen.doubtful)
        x, y, radius, clear, doubtful = (part[k].cpu().numpy() for part in parts)
        there = clear | doubtful
        clear = clear & (radius >= _COUNTED_PX[0]) & (radius <= _COUNTED_PX[1])
        x, y, radius, clear = x[there], y[there], radius[there], clear[there]
        clear_total += int(clear.sum())
        taken = np.zeros(len(x), dtype=bool)
        inside = (found[:, 2] >= _COUNTED_PX[0]) & (found[:, 2] <= _COUNTED_PX[1])
        for one, value in zip(found[inside], logit[inside], strict=True):
            near = np.hypot(x - one[0], y - one[1]) / np.maximum(radius, 1e-6)
            right = (near < 0.5) & (np.abs(np.log(np.maximum(radius, 1e-6) / one[2])) < 0.5)
            new = right & clear & ~taken
            hits.append(2 if new.any() else 1 if right.any() else 0)
            logits.append(value)
            if new.any():
                taken[np.argmin(np.where(new, near, np.inf))] = True
    if not logits:
        return 0.0, 0.0
    order = np.argsort(-np.array(logits))
    kind = np.array(hits)[order]
    false = np.cumsum(kind == 0) / np.arange(1, len(kind) + 1)
    allowed = np.flatnonzero(false <= false_share)
    if not len(allowed):
        return 0.0, float(np.array(logits)[order[0]])
    last = allowed[-1]
    return float(np.sum(kind[: last + 1] == 2) / max(clear_total, 1)), float(np.array(logits)[order[last]])


def held_out(course: Course, pool: Pool, device: torch.device) -> tuple[Tensor, Seen]:
    """Draw the images, with their craters, that the recall is counted on."""
    draw = Draw(course.seed + 1, device)
    count = -(-course.held_out // _CHUNK)
    jobs = [pool.threads.submit(draw_block, _HELD_OUT + k * _CHUNK, pool.profiles) for k in range(count)]
    drawn = []
    for job in jobs:
        height, albedo, craters = (part.to(device) for part in job.result())
        drawn.append(draw_images(draw, height, albedo.float(), craters))
    images = torch.cat([one for one, _ in drawn])
    seen = Seen(*(torch.cat([getattr(two, name) for _, two in drawn]) for name in Seen.__slots__))
    return images, seen


@torch.no_grad()
def start_from(network: HeatMap, path: Path, images: Tensor) -> None:
    """Set a network to stored weights; normalisation is set to change nothing on images (batch, 2, rows, columns).

    Bands of radii that the stored network lacks are those of the smallest that it has, with few craters.
    """
    stored = {name: torch.from_numpy(part.astype(np.float32)).to(images.device) for name, part in np.load(path).items()}

    def unfold(norm: nn.BatchNorm2d, name: str, values: Tensor) -> None:
        variance, mean = torch.var_mean(values, (0, 2, 3))
        norm.running_mean.copy_(mean)
        norm.running_var.copy_(variance)
        norm.weight.copy_(torch.sqrt(variance + norm.eps))
        norm.bias.copy_(mean + stored[f"{name}_bias"])

    hooks = []
    for name, part in network.named_children():
        kernel, bias = stored[f"{name}_kernel"], stored[f"{name}_bias"]
        if isinstance(part, Layer):
            part[0].weight.copy_(kernel)
            hooks.append(part[1].register_forward_pre_hook(lambda norm, x, name=name: unfold(norm, name, x[0])))
            continue
        if name == "head" and len(kernel) < len(part.weight):
            new = (len(part.weight) - len(kernel)) // OUTPUTS
            kernel = torch.cat([*[kernel[:OUTPUTS]] * new, kernel])
            bias = torch.cat([*[bias[:OUTPUTS]] * new, bias])
        part.weight.copy_(kernel)
        part.bias.copy_(bias)
    network.eval()
    network(images)
    for hook in hooks:
        hook.remove()
    network.train()


def train(course: Course, out: Path, device: torch.device, workers: int, start: Path | None = None) -> None:
    """Train for the minutes of the course; the weights are written each minute and at the end.

    ``start`` are weights to begin with, in place of random ones.
    """
    started = time.monotonic()
    torch.manual_seed(course.seed)
    torch.backends.cudnn.benchmark = True
    pool = Pool(course, device, workers)
    images, seen = held_out(course, pool, device)
    network = HeatMap().to(device, memory_format=torch.channels_last)
    draw = Draw(course.seed, device)
    if start is not None:
        start_from(network, start, draw_images(draw, *pool.draw(draw, course.batch))[0])
    mean = copy.deepcopy(network).eval()
    optimiser = torch.optim.AdamW(network.parameters(), lr=course.rate, weight_decay=course.decay)
    say(f"ready after {time.monotonic() - started:.0f} s on {device}, {workers} threads")
    log = (out / "loss.csv").open("w", encoding="utf-8")
    log.write("step,seconds,focal,place,recall,threshold,waited_s\n")
    step, spoken, sums = 0, time.monotonic(), torch.zeros(3, device=device)
    while True:
        part = (time.monotonic() - started) / (60.0 * course.minutes)
        if part >= 1.0 and step > 0:
            break
        rate = course.rate * min(1.0, (step + 1) / 300.0) * 0.5 * (1.0 + math.cos(math.pi * min(part, 1.0)))
        for group in optimiser.param_groups:
            group["lr"] = rate
        with torch.no_grad():
            batch, craters = draw_images(draw, *pool.draw(draw, course.batch))
            targets = Targets(craters)
        batch = batch.contiguous(memory_format=torch.channels_last)
        with torch.autocast(device.type, dtype=torch.bfloat16, enabled=device.type == "cuda"):
            outputs = network(batch)
        focal, place = loss_of(outputs, targets)
        optimiser.zero_grad(set_to_none=True)
        (focal + course.place_weight * place).backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 5.0)
        optimiser.step()
        step += 1
        follow(mean, network, min(0.999, step / (step + 10.0)))
        sums += torch.stack([focal.detach(), place.detach(), torch.ones_like(focal.detach())])
        if time.monotonic() - spoken > 60.0:
            report(log, step, time.monotonic() - started, sums, recall(mean, images, seen), pool.waited_s)
            sums.zero_()
            write(mean, course, step, out, start)
            spoken = time.monotonic()
    report(log, step, time.monotonic() - started, sums, recall(mean, images, seen), pool.waited_s)
    log.close()
    pool.close()
    write(mean, course, step, out, start)


@torch.no_grad()
def follow(mean: HeatMap, network: HeatMap, share: float) -> None:
    """Let the running mean of the weights and of the normalisation's statistics follow the network."""
    own = [part for part in mean.state_dict().values() if part.dtype.is_floating_point]
    new = [part for part in network.state_dict().values() if part.dtype.is_floating_point]
    torch._foreach_lerp_(own, new, 1.0 - share)


def report(log: TextIO, step: int, seconds: float, sums: Tensor, found: tuple[float, float], waited: float) -> None:
    """Write a line of the loss."""
    focal, place, n = sums.tolist()
    losses = f"{focal / max(n, 1):.4f},{place / max(n, 1):.4f}"
    line = f"{step},{seconds:.0f},{losses},{found[0]:.4f},{found[1]:.3f},{waited:.1f}"
    log.write(line + "\n")
    log.flush()
    say(line)


def say(line: str) -> None:
    """Print a line at once: a run that is ended early has shown it."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def write(network: HeatMap, course: Course, step: int, out: Path, start: Path | None) -> None:
    """Write the weights and how they were made."""
    np.savez_compressed(out / "heat_map.npz", **folded(network))
    note = {"course": asdict(course), "steps": step, "torch": torch.__version__, "numpy": np.__version__}
    if start is not None:
        note["start"] = {"sha256": hashlib.sha256(start.read_bytes()).hexdigest()}
    note["sha256"] = hashlib.sha256((out / "heat_map.npz").read_bytes()).hexdigest()
    note["device"] = torch.cuda.get_device_name() if torch.cuda.is_available() else "cpu"
    (out / "heat_map.json").write_text(json.dumps(note, indent=1) + "\n", encoding="utf-8")


def main(arguments: list[str] | None = None) -> int:
    """Train as the arguments say."""
    parser = argparse.ArgumentParser(prog="python3 -m training.heat_map", description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--minutes", type=float, default=Course().minutes)
    parser.add_argument("--seed", type=int, default=Course().seed)
    parser.add_argument("--batch", type=int, default=Course().batch)
    parser.add_argument("--pool", type=int, default=Course().pool)
    parser.add_argument("--fresh", type=int, default=Course().fresh)
    parser.add_argument("--held-out", type=int, default=Course().held_out)
    parser.add_argument("--workers", type=int, default=max((os.cpu_count() or 2) - 2, 1))
    parser.add_argument("--rate", type=float, default=Course().rate)
    parser.add_argument("--weights", type=Path, help="weights to start from, as written by an earlier run")
    told = parser.parse_args(arguments)
    told.out.mkdir(parents=True, exist_ok=True)
    course = Course(told.seed, told.minutes, told.batch, told.pool, told.fresh, told.rate, held_out=told.held_out)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    train(course, told.out, device, told.workers, told.weights)
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Fit the errors of simulated tracks, `sequence.vision.track_errors`, to real tracks and their reference.

Run as ``python -m adjustment.track_errors SCENARIO --frames 0 32`` with a scenario that has `sequence.tracks`. Tracks,
reference poses and nothing else are used: no estimator, and no shape.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import optimize, stats
from scipy.spatial.transform import Rotation

from boresight.scenarios.arrays import MAD_TO_SIGMA, BoolArray, FloatArray, IndexArray
from boresight.scenarios.geometry import Camera, angle_between
from boresight.scenarios.load import load_scenario
from boresight.scenarios.sequences.track_table import TrackTable

GAPS = (1, 2, 4, 8)  # frames
QUANTILES = np.array([0.25, 0.5, 0.75, 0.9, 0.97])
BLOCKS = 8
WRONG_PX = 3.0  # differences beyond it are left out of means
CENTRE = 0.4  # of half the image's width
WEIGHTS_T = 3.0  # degrees of freedom


@dataclass(frozen=True, slots=True, eq=False)
class Runs:
    """S sightings in runs of three and more consecutive frames, in the order of runs and frames.

    ``run`` (S,) counts from 0; ``frame`` (S,); ``error_px`` (S, 2) is relative to the landmark of the reference. It is
    seen at ``place_px`` (S, 2) from the principal point; ``jacobian`` (S, 2, 3) is d place / d landmark, px/m, body
    frame. A run also ends before a frame whose view is nearly that of the frame before.
    """

    run: IndexArray
    frame: IndexArray
    error_px: FloatArray
    place_px: FloatArray
    jacobian: FloatArray

    @classmethod
    def of(cls, table: TrackTable, camera: Camera, first: int, last: int) -> Runs:
        """Take the frames from first to before last. Raise ValueError if no run is there."""
        inside = (table.frames >= first) & (table.frames < last)
        tracks, frames = table.tracks[inside], table.frames[inside]
        new = np.append(True, (np.diff(tracks) != 0) | (np.diff(frames) != 1) | short_steps(table)[frames[1:]])
        kept = np.bincount(np.cumsum(new) - 1)[np.cumsum(new) - 1] >= 3
        if not kept.any():
            raise ValueError(f"no track is seen in three consecutive frames from {first} to {last - 1}")
        tracks, frames, run = tracks[kept], frames[kept], np.cumsum(new[kept]) - 1
        rotation = Rotation.from_quat(np.array(table.states.attitude)[frames], scalar_first=True).as_matrix()
        sight = table.points_m[tracks] - np.array(table.states.position_m)[frames]
        x, y, z = np.einsum("sij,sj->is", rotation, sight)
        focal = np.array([camera.fx_px, camera.fy_px])
        place = np.stack([x / z, y / z], axis=1)
        zero, one = np.zeros_like(z), np.ones_like(z)
        slope = np.array([[one, zero, -x / z], [zero, one, -y / z]]) * focal[:, None, None] / z
        jacobian = slope.transpose(2, 0, 1) @ rotation
        return cls(run, frames, (table.rays[inside][kept] - place) * focal, place * focal, jacobian)

    @property
    def starts(self) -> BoolArray:
        """(S,) whether a sighting is the first of its run."""
        return np.append(True, np.diff(self.run) != 0)

    def keep(self, runs: BoolArray) -> Runs:
        """Return the runs that are marked, (R,)."""
        rows = runs[self.run]
        arrays = (array[rows] for array in (self.frame, self.error_px, self.place_px, self.jacobian))
        return Runs(np.cumsum(self.starts[rows]) - 1, *arrays)

    def accumulated(self, steps: FloatArray) -> FloatArray:
        """Sum (S, 2, ...) steps along each run, from zero at its first sighting."""
        steps = np.where(self.starts.reshape(-1, *[1] * (steps.ndim - 1)), 0.0, steps)
        total = np.cumsum(steps, axis=0)
        return total - total[self.starts][self.run]

    def less_landmarks(self, values: FloatArray, weights: FloatArray) -> FloatArray:
        """Return (S, 2, p) values less what shifts of the landmarks explain, weighted by (S,)."""
        n = int(self.run[-1]) + 1
        normal, right = np.zeros((n, 3, 3)), np.zeros((n, 3, values.shape[2]))
        weighted = self.jacobian * weights[:, None, None]
        np.add.at(normal, self.run, np.einsum("sai,saj->sij", weighted, self.jacobian))
        np.add.at(right, self.run, np.einsum("sai,sap->sip", weighted, values))
        return values - np.einsum("sai,sip->sap", self.jacobian, np.linalg.solve(normal, right)[self.run])

    def pairs(self, gap: int) -> tuple[IndexArray, IndexArray]:
        """Return the sightings, before and after, that are so many frames apart in a run."""
        before = np.flatnonzero(self.run[gap:] == self.run[:-gap])
        return before, before + gap

    def blocks(self) -> list[BoolArray]:
        """Return (R,) the runs that begin in each of some blocks of frames."""
        begin = self.frame[self.starts]
        block = (begin - begin.min()) * BLOCKS // (np.ptp(begin) + 1)
        return [block == k for k in range(BLOCKS) if (block == k).any()]


def short_steps(table: TrackTable) -> BoolArray:
    """(F,) whether the change of view since the frame before is less than half the median."""
    step = np.array([angle_between(*pair) for pair in itertools.pairwise(np.array(table.states.position_m))])
    return np.append(False, step < 0.5 * np.median(step))


def common_steps(runs: Runs) -> FloatArray:
    """(S, 2, 3) errors by a contraction of one and by a drift of 1 px along each axis."""
    steps = np.concatenate([-runs.place_px[:, :, None], np.broadcast_to(np.eye(2), (len(runs.run), 2, 2))], axis=2)
    return runs.accumulated(steps)


def fit_common(runs: Runs) -> FloatArray:
    """Return (3,) contraction and drift, px: least squares with Student weights; all landmarks are free."""
    both = np.concatenate([runs.error_px[:, :, None], common_steps(runs)], axis=2)
    weights, found = np.ones(len(runs.run)), np.zeros(3)
    for _ in range(8):
        values = runs.less_landmarks(both, weights)
        design, wanted = values[:, :, 1:], values[:, :, 0]
        weighted = design * weights[:, None, None]
        found = np.linalg.solve(np.einsum("sap,saq->pq", weighted, design), np.einsum("sap,sa->p", weighted, wanted))
        residual = wanted - design @ found
        square = (residual**2).sum(axis=1) / (MAD_TO_SIGMA * np.median(np.abs(residual))) ** 2
        weights = (WEIGHTS_T + 2.0) / (WEIGHTS_T + square)
    return found


def fit_random(runs: Runs, common: FloatArray, seed: int = 0) -> FloatArray:
    """Return (3,) noise_px, walk_px and student_t.

    With them simulated errors on the same sightings have the quantiles of the real ones, of absolute differences over
    1, 2, 4 and 8 frames, both without the shifts of landmarks.
    """
    even = np.ones(len(runs.run))
    luck = np.random.default_rng(seed).uniform(size=(2, len(runs.run), 2))
    pairs = [rows for rows in (runs.pairs(gap) for gap in GAPS) if len(rows[0])]

    def quantiles(errors: FloatArray) -> FloatArray:
        left = runs.less_landmarks(errors[:, :, None], even)[:, :, 0]
        return np.log([np.quantile(np.abs(left[b] - left[a]), QUANTILES) for a, b in pairs]).ravel()

    wanted = quantiles(runs.error_px - common_steps(runs) @ common)

    def misfit(logs: FloatArray) -> FloatArray:
        noise_px, walk_px, over = np.exp(logs)
        white, steps = stats.t.ppf(luck, 2.0 + over) * np.sqrt(over / (2.0 + over))
        return quantiles(noise_px * white + runs.accumulated(walk_px * steps)) - wanted

    found = np.exp(optimize.least_squares(misfit, np.log([0.6, 0.4, 1.0]), diff_step=0.03, xtol=1e-3).x)
    return np.asarray(found + np.array([0.0, 0.0, 2.0]))


def jackknife(runs: Runs, fit: Callable[[Runs], FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Return what is fitted, and its standard errors by blocks of the frames in which runs begin."""
    left_out = np.array([fit(runs.keep(~block)) for block in runs.blocks()])
    n = len(left_out)
    return fit(runs), np.sqrt((n - 1) / n * ((left_out - left_out.mean(axis=0)) ** 2).sum(axis=0))


def mean_drifts(runs: Runs, errors_px: FloatArray, gap: int, half_px: float) -> FloatArray:
    """(5, 2) mean drift away from the principal point and across that, px, over ``gap`` frames, without landmarks.

    The places are the centre and the four quadrants around it: up left, up right, down left and down right.
    """
    left = runs.less_landmarks(errors_px[:, :, None], np.ones(len(runs.run)))[:, :, 0]
    before, after = runs.pairs(gap)
    x, y = runs.place_px[before].T
    far = np.hypot(x, y)
    along, across = np.stack([x, y], axis=1) / far[:, None], np.stack([-y, x], axis=1) / far[:, None]
    place = np.where(far < CENTRE * half_px, 0, 1 + (x > 0) + 2 * (y > 0))
    moved = left[after] - left[before]
    drift = np.stack([(moved * axis).sum(axis=1) for axis in (along, across)], axis=1)
    counted = np.linalg.norm(moved, axis=1) < WRONG_PX
    return np.array([drift[counted & (place == k)].mean(axis=0) for k in range(5)])


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")


def main(arguments: Sequence[str] | None = None) -> None:
    """Fit one part of a sequence, and print its mean drifts and those that the fit and other values make."""
    parser = argparse.ArgumentParser(description="Fit sequence.vision.track_errors to real tracks.")
    parser.add_argument("scenario", help="with sequence.tracks")
    parser.add_argument("--frames", nargs=2, type=int, metavar=("FIRST", "END"), help="from 0; default: all")
    parser.add_argument(
        "--check", nargs=3, type=float, metavar=("CONTRACTION", "U_PX", "V_PX"), help="a fit of other frames to compare"
    )
    given = parser.parse_args(arguments)
    scenario = load_scenario(given.scenario)
    spec, camera = scenario.spec.sequence, scenario.spec.camera.camera()
    if spec is None or spec.tracks is None:
        parser.error(f"{given.scenario} has no sequence.tracks")
    table = TrackTable.open(spec.tracks, camera, scenario.search_dirs)
    try:
        runs = Runs.of(table, camera, *(given.frames or (0, len(table.states))))
    except ValueError as error:
        parser.error(str(error))
    common, common_se = jackknife(runs, fit_common)
    random, random_se = jackknife(runs, lambda some: fit_random(some, common))
    for name, value, error in zip(
        ("noise_px", "walk_px", "student_t", "contraction", "drift u, px", "drift v, px"),
        (*random, *common),
        (*random_se, *common_se),
        strict=True,
    ):
        _say(f"{name:12s} {value:.3g} +- {error:.2g}")
    _say(f"{'drift_px':12s} {np.linalg.norm(common[1:]) / np.sqrt(2.0):.3g}")
    _say("mean drift, px, outward and across, in the centre and four quadrants")
    cases = {"real": None, "fit": common} | ({"check": np.array(given.check)} if given.check else {})
    for gap in GAPS:
        for name, values in cases.items():
            errors = runs.error_px if values is None else common_steps(runs) @ values
            means = mean_drifts(runs, errors, gap, camera.width_px / 2.0)
            _say(f"{gap} frames, {name:5s} " + "  ".join(f"{a:+.3f} {b:+.3f}" for a, b in means))


if __name__ == "__main__":
    main()

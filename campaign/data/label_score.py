"""Scores of detections against labels of real craters: recall by false alarms, size and contrast."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from boresight.estimators.craters.contract import CraterDetections
from boresight.scenarios.arrays import BoolArray, FloatArray, Image, IndexArray
from boresight.scenarios.geometry import Ellipses

CENTRE_RADII, LOG_RADIUS = 0.5, 0.5
"""A detection is right if its centre lies within half a label's radius, and the ratio of radii within exp(0.5)."""

NONE, REPEATED = -1, -2
FALSE_SHARES = (0.02, 0.05, 0.1, 0.15, 0.2)
SIZES_PX = (4.0, 8.0, 16.0, np.inf)
_ISOLATED_RADII = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class LabelMatches:
    """Detections (m,) of one or several images, the most confident first within each, against labels (n,).

    ``label`` is the row of the label that a detection stands for, ``NONE`` for a false alarm and ``REPEATED`` where a
    more confident detection has that label. ``large`` (m,) are detections of at least the least radius of labels: the
    false ones are a share of these. ``log_ratio`` and ``offset_radii`` (m, 2) compare a detection with its label, NaN
    if it has none. ``radius_px``, ``contrast`` and ``isolated`` are of the labels.
    """

    confidence: FloatArray
    label: IndexArray
    large: BoolArray
    log_ratio: FloatArray
    offset_radii: FloatArray
    radius_px: FloatArray
    contrast: FloatArray
    isolated: BoolArray

    @classmethod
    def joined(cls, parts: list[LabelMatches]) -> LabelMatches:
        """Join images: the labels are numbered on."""
        starts = np.cumsum([0, *[len(part.radius_px) for part in parts]])
        label = [np.where(part.label >= 0, part.label + k, part.label) for part, k in zip(parts, starts, strict=False)]
        fields = ("log_ratio", "offset_radii", "radius_px", "contrast", "isolated")
        return cls(
            np.concatenate([part.confidence for part in parts]), np.concatenate(label),
            np.concatenate([part.large for part in parts]),
            *(np.concatenate([getattr(part, name) for part in parts]) for name in fields),
        )  # fmt: skip


def match_labels(
    found: CraterDetections, labels: Ellipses, image: Image, radius_min_px: float, wanted: BoolArray | None = None
) -> LabelMatches:
    """Match detections of at least a radius, one to one, the most confident first, each with its nearest free label.

    Any label makes a detection right; those below ``radius_min_px``, or not ``wanted`` (n,), are left out of the
    recall.
    """
    every = found if found.rejected is None else _with_rejected(found)
    rows = np.flatnonzero(every.ellipses.radius_px >= radius_min_px * np.exp(-LOG_RADIUS))
    rims, confidence = every.ellipses[rows], every.confidence[rows]
    label = np.full(len(rims), NONE, dtype=np.int64)
    ratio, offset = np.full(len(rims), np.nan), np.full((len(rims), 2), np.nan)
    free = np.ones(len(labels), dtype=bool)
    for i in range(len(rims)):
        away = (rims.centre_px[i] - labels.centre_px) / labels.radius_px[:, None]
        log_ratio = np.log(rims.radius_px[i] / labels.radius_px)
        apart = np.linalg.norm(away, axis=1)
        right = (apart < CENTRE_RADII) & (np.abs(log_ratio) < LOG_RADIUS)
        if not right.any():
            continue
        label[i] = REPEATED
        if np.any(right & free):
            best = int(np.argmin(np.where(right & free, apart, np.inf)))
            free[best], label[i], ratio[i], offset[i] = False, best, log_ratio[best], away[best]
    big = (labels.radius_px >= radius_min_px) & (True if wanted is None else wanted)
    number = np.where(big, np.cumsum(big) - 1, REPEATED)
    label = np.where(label >= 0, number[np.maximum(label, 0)], label)
    # A false alarm below the least size could be a crater that nobody labelled: it has no say.
    large = rims.radius_px >= radius_min_px
    counted = (label != NONE) | large
    # Isolated: without another centre within two radii, infinitely far where there is no other; a label is its nearest.
    apart = np.asarray(cKDTree(labels.centre_px).query(labels.centre_px, k=2)[0])[:, 1]
    isolated = np.asarray(apart > _ISOLATED_RADII * labels.radius_px)
    return LabelMatches(
        confidence[counted], label[counted], large[counted], ratio[counted], offset[counted], labels.radius_px[big],
        _contrast(image, labels)[big], isolated[big],
    )  # fmt: skip


def _with_rejected(found: CraterDetections) -> CraterDetections:
    """Join detections above and below the detector's threshold."""
    rejected = found.rejected or CraterDetections.none()
    rims = Ellipses.joined([found.ellipses, rejected.ellipses])
    return CraterDetections(rims, np.concatenate([found.confidence, rejected.confidence]))


def _contrast(image: Image, labels: Ellipses) -> FloatArray:
    """Return the standard deviation of brightness over the mean within each label (n,); NaN outside of the image."""
    found = np.full(len(labels), np.nan)
    for i, ((u, v), radius) in enumerate(zip(labels.centre_px, labels.radius_px, strict=True)):
        rows = slice(max(int(v - radius), 0), max(int(v + radius) + 1, 0))
        part = image[rows, max(int(u - radius), 0) : max(int(u + radius) + 1, 0)]
        if part.size:
            found[i] = part.std() / max(float(part.mean()), 1e-9)
    return found


def recall_at(matches: LabelMatches, false_share: float, chosen: BoolArray | None = None) -> tuple[float, float]:
    """Return the recall of labels where at most a share of the large detections is false, and that threshold.

    ``chosen`` (n,) are the labels that the recall is of; the threshold is that of all. NaN if no threshold is so good.
    """
    order = np.argsort(-matches.confidence, kind="stable")
    label, confidence = matches.label[order], matches.confidence[order]
    share = np.cumsum(label == NONE) / np.maximum(np.cumsum(matches.large[order]), 1)
    # Of equal confidences all or none are above a threshold.
    last = np.append(np.diff(confidence) < 0.0, [True] * (len(confidence) > 0))
    allowed = np.flatnonzero((share <= false_share) & last)
    if not len(allowed):
        return np.nan, np.nan
    found = label[: allowed[-1] + 1]
    chosen = np.ones(len(matches.radius_px), dtype=bool) if chosen is None else chosen
    return float(chosen[found[found >= 0]].sum() / max(chosen.sum(), 1)), float(confidence[allowed[-1]])


def score_table(matches: LabelMatches, least_px: float = SIZES_PX[0]) -> pd.DataFrame:
    """Tabulate the recall at shares of false alarms: of all labels, by radius, by contrast and of isolated ones.

    ``least_px`` is the least radius of the labels that were matched.
    """
    n = len(matches.radius_px)
    groups: list[tuple[str, BoolArray]] = [("all", np.ones(n, dtype=bool)), ("isolated", matches.isolated)]
    for low, high in pairwise((least_px, *(size for size in SIZES_PX if size > least_px))):
        name = f"radius {low:g} to {high:g} px" if np.isfinite(high) else f"radius from {low:g} px"
        groups.append((name, (matches.radius_px >= low) & (matches.radius_px < high)))
    thirds = np.nanquantile(matches.contrast, [1 / 3, 2 / 3]) if n else np.zeros(2)
    faint, plain = matches.contrast < thirds[0], matches.contrast >= thirds[1]
    groups += [("faintest third", faint), ("middle third", ~faint & ~plain), ("plainest third", plain)]
    rows = []
    for name, chosen in groups:
        row: dict[str, object] = {"labels": name, "n": int(chosen.sum())}
        for share in FALSE_SHARES:
            row[f"recall_{100 * share:g}"] = recall_at(matches, share, chosen)[0] if chosen.any() else np.nan
        rows.append(row)
    return pd.DataFrame(rows)


def label_quality(matches: LabelMatches) -> str:
    """Describe labels next to the detections that stand for them: ratio of radii and offset of centres."""
    good = matches.label >= 0
    if not good.any():
        return "no label was found"
    ratio = np.exp(-np.median(matches.log_ratio[good]))
    u, v = -np.median(matches.offset_radii[good], axis=0)
    return (
        f"labels are {ratio:.2f} times as large as the {good.sum()} rims for them, likely or not, and lie"
        f" ({u:+.2f}, {v:+.2f}) radii from them (medians)"
    )

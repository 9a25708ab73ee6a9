"""A crater detector by a network in an ONNX file, which onnxruntime applies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from itertools import pairwise, product
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

import cv2
import numpy as np
from pydantic import Field

from boresight.estimators.craters.contract import CraterDetections
from boresight.estimators.craters.detection.preparation import check_image
from boresight.estimators.craters.detection.refinement import from_parameters
from boresight.estimators.options import parse_options
from boresight.scenarios.arrays import FloatArray, Image
from boresight.scenarios.errors import BoresightError, one_line
from boresight.scenarios.geometry import Camera
from boresight.scenarios.observation import Frame
from boresight.scenarios.spec.base import SpecModel, optional

LAYOUTS = {
    "boxes-xyxy": "one tensor (1, N, 5 or 6) x1, y1, x2, y2, score, class, or boxes (N, 4) and scores (N,)",
    "boxes-cxcywh": "one tensor (1, 4 + classes, N), classes < N - 4",
    "heat-map": "one tensor (H, W) as large as the input, with or without axes of 1",
}
_AT_SEAM_PX = 2.0  # boxes that come so close to a seam of tiles are taken to be cut by it
_REJECTED = 0.1  # of the least score: from there on rims are listed as rejected
_LEAST_PX2, _LEAST_SHARE = 8.0, 0.85  # of areas in heat maps; of the ellipse with their second moments


class InputOptions(SpecModel):
    """How an image becomes the network's input, ``scale * (image / white - mean)``, black 0 and white 1 before."""

    size_px: int | None = optional("Side of the square input, where the model leaves its size open", ge=16, le=4096)
    white: float | None = optional("Brightness that is 1; left out: the image's percentile 99.9", gt=0.0)
    scale: float | tuple[float, float, float] = Field(1.0, description="Factor, or one for each channel")
    mean: float | tuple[float, float, float] = Field(0.0, description="What is subtracted, or that of each channel")
    tiles: bool = Field(True, description="Cut larger images into tiles of the input's size; false: resize them to fit")
    overlap: float = Field(0.25, ge=0.0, le=0.75, description="Share of a tile that its neighbour sees too, at least")


class OnnxOptions(SpecModel):
    """Options of a detector by a network."""

    model: str = Field(description="ONNX file, which a campaign names by its path from its own")
    output: Literal["boxes-xyxy", "boxes-cxcywh", "heat-map"] = Field(description="What the network returns")
    input: InputOptions = Field(InputOptions(), description="How an image becomes the network's input")
    sigmoid: bool = Field(False, description="Scores and heat maps are logits: apply the logistic function")
    score_min: float = Field(0.25, gt=0.0, lt=1.0, description="Least score of a crater, or value in a heat map")
    iou_max: float = Field(
        0.5, ge=0.0, le=1.0, description="Largest intersection over union of two boxes that are kept"
    )


@dataclass(frozen=True, slots=True)
class CraterOnnx:
    """Finds craters by any network in an ONNX file that returns boxes or a heat map.

    It needs the extra ``onnxruntime``. The input is one float32 tensor, (1, C, H, W), (1, H, W, C) or (C, H, W), of one
    channel or three equal ones. ``boxes-cxcywh`` is (1, 4 + classes, N), as of YOLOv8 and YOLO11; ``boxes-xyxy`` is
    (1, N, 6) or (1, N, 5) with the score behind the corners, or boxes (N, 4) and scores (N,), as of torchvision;
    ``heat-map`` is (H, W), with or without axes of 1, of craters' areas or closed rims. All are in pixels of the input.

    A box becomes the ellipse that touches its sides, with the score of its best class; of boxes that overlap, the best
    is kept. In a heat map from ``score_min`` on, an area becomes the ellipse of its moments, a ring that around its
    middle line, with the mean value as score. The digest of a run covers the file, which holds all weights.

    Use it when
    -----------
    A network that was trained elsewhere is to be compared, in campaigns or on pictures.

    It fails when
    -------------
    The image is black, uniform, saturated or not finite, scores are not from 0 to 1, or an operator fails. It ignores
    the Sun. Of boxes, craters wider than the overlap of tiles can be lost at a seam. In heat maps, areas that touch are
    one, and rims with gaps are missed. Methods that name a detector without its options, such as ``crater-pose`` and
    the matchers, cannot use it.

    Cost
    ----
    That of the network on one core, for each tile.

    Source
    ------
    Ours.
    """

    name: ClassVar[str] = "crater-onnx"
    version: ClassVar[int] = 1
    options_model: ClassVar[type[SpecModel]] = OnnxOptions

    options: OnnxOptions
    session: Any
    size: tuple[int, int]  # rows and columns of the input
    channels: int
    channels_last: bool

    @classmethod
    def from_options(cls, options: Mapping[str, object]) -> Self:
        """Read the network and try it on black; raise BoresightError for a wrong option or another layout."""
        o = parse_options(OnnxOptions, options, cls.name)
        session = open_session(o.model)
        given = session.get_inputs()
        told = f"{o.model}: input " + "; ".join(f"{one.name} {one.type} {one.shape}" for one in given)
        shape = given[0].shape if len(given) == 1 and given[0].type == "tensor(float)" else []
        batch, *axes = shape if len(shape) == 4 else [1, *shape]
        last = len(axes) == 3 and axes[0] not in (1, 3)
        channels, *sides = (axes[2], *axes[:2]) if last else axes or (0,)
        if len(sides) != 2 or channels not in (1, 3) or (isinstance(batch, int) and batch != 1):
            raise BoresightError(
                f"{told}: needed is one tensor(float) [1, C, H, W], [1, H, W, C] or [C, H, W] with C of 1 or 3"
            )
        asked = o.input.size_px
        height, width = (side if isinstance(side, int) else asked or 0 for side in sides)
        if height == 0 or asked not in (None, height) or asked not in (None, width):
            raise BoresightError(f"{told}: input.size_px: {asked}: give it where the model leaves its size open alone")
        if channels < max(np.size(o.input.scale), np.size(o.input.mean)):
            raise BoresightError(f"{told}: input.scale, input.mean: 3 numbers for one channel: give one")
        made = cls(o, session, (height, width), channels, last)
        made._apply(np.zeros((height, width), np.float32))
        return made

    def detect(self, frame: Frame, camera: Camera) -> CraterDetections:
        """Find rims, the highest score first, which is the confidence.

        Raise BoresightError as `check_image` does, or if the network fails or returns impossible values.
        """
        check_image(frame.image, camera)
        o, (height, width) = self.options, self.size
        white = o.input.white or max(float(np.percentile(frame.image, 99.9)), 0.0) or float(frame.image.max())
        image = np.clip(frame.image / np.float32(white), 0.0, 1.0)
        zoom = 1.0 if o.input.tiles else min(height / image.shape[0], width / image.shape[1])
        if zoom != 1.0:
            # By factors, not by size: those of a rounded size would differ along the axes.
            how = cv2.INTER_AREA if zoom < 1.0 else cv2.INTER_LINEAR
            image = cv2.resize(image, None, fx=zoom, fy=zoom, interpolation=how)[:height, :width]
        heat, rows = np.zeros(image.shape, np.float32), [np.zeros((0, 6))]
        starts = (tiles_along(*lengths, o.input.overlap) for lengths in zip(image.shape, self.size, strict=True))
        for (row, top, bottom), (column, left, right) in product(*starts):
            part = image[row : row + height, column : column + width]
            found = self._apply(np.pad(part, ((0, height - part.shape[0]), (0, width - part.shape[1]))))
            if o.output == "heat-map":
                heat[top:bottom, left:right] = found[top - row : bottom - row, left - column : right - column]
            else:
                rows.append(_whole(found, np.array([column, row]), np.array([width, height]), image.shape[::-1]))
        if o.output == "heat-map":
            rims = rims_in(heat, o.score_min)
        else:
            rims = np.concatenate(rows)
            boxes = np.hstack([rims[:, :2] - rims[:, 2:4], 2.0 * rims[:, 2:4]])  # x, y, width, height
            kept = cv2.dnn.NMSBoxes(boxes.tolist(), rims[:, 5].tolist(), _REJECTED * o.score_min, o.iou_max)
            rims = rims[np.array(kept, dtype=np.int64)]
        rims = rims[np.argsort(-rims[:, 5], kind="stable")]
        rims[:, :4] /= zoom
        return CraterDetections.above(o.score_min, from_parameters(rims[:, :5]), rims[:, 5])

    def _apply(self, tile: Image) -> FloatArray:
        """Apply the network to a tile (H, W): return (n, 5) x1, y1, x2, y2, score, px of the tile, or a map (H, W)."""
        o = self.options
        scale, mean = (np.broadcast_to(np.asarray(x, np.float32), self.channels) for x in (o.input.scale, o.input.mean))
        fed = (tile[..., None] - mean) * scale
        fed = np.ascontiguousarray(fed if self.channels_last else np.moveaxis(fed, 2, 0))
        axes = self.session.get_inputs()[0]
        try:
            outputs = self.session.run(None, {axes.name: fed[None] if len(axes.shape) == 4 else fed})
        except Exception as error:  # onnxruntime's errors have no base of their own
            raise BoresightError(f"{o.model}: the network fails: {one_line(error)}") from error
        outputs = [np.asarray(one, np.float64) for one in outputs if getattr(one, "dtype", np.dtype(int)).kind == "f"]
        found = _in_layout(outputs, o.output, self.size)
        if found is None:
            shapes = ", ".join(str(one.shape) for one in outputs) or "none"
            raise BoresightError(
                f"{o.model}: output: {o.output}: needed is {LAYOUTS[o.output]}; floating-point outputs are {shapes}"
            )
        score = found if o.output == "heat-map" else found[:, 4]
        if o.sigmoid:
            score[:] = 1.0 / (1.0 + np.exp(-np.clip(score, -100.0, 100.0)))
        if not np.isfinite(found).all() or (score.size and not -0.01 < score.min() <= score.max() < 1.01):
            raise BoresightError(
                f"{o.model}: scores are not from 0 to 1, or not finite: set sigmoid if they are logits"
            )
        score[:] = np.clip(score, 0.0, 1.0)
        sure = found[score >= o.score_min] if o.output != "heat-map" else np.zeros((0, 5))
        if len(sure) and (sure[:, :4].max() <= 1.5 or np.mean(sure[:, 2] < sure[:, 0]) > 0.5):
            raise BoresightError(f"{o.model}: output: {o.output}: boxes are from 0 to 1, or end before they begin")
        return found


def open_session(path: str) -> Any:
    """Open an ONNX file for one thread; raise BoresightError if it is none, or onnxruntime is not installed."""
    try:
        runtime = import_module("onnxruntime")
        how = runtime.SessionOptions()
        how.intra_op_num_threads = how.inter_op_num_threads = 1
        how.log_severity_level = 4
        # Weights in other files, which the digest of a run would not cover, are refused: the file is no folder.
        how.add_session_config_entry("session.model_external_initializers_file_folder_path", path)
        return runtime.InferenceSession(Path(path).read_bytes(), how, providers=["CPUExecutionProvider"])
    except ImportError as error:
        told = f'onnxruntime: cannot be imported ({error}); install it: pip install -e ".[onnxruntime]"'
        raise BoresightError(told) from None
    except OSError as error:
        raise BoresightError(f"{path}: cannot be read: {error.strerror}") from error
    except Exception as error:  # onnxruntime's errors have no base of their own
        raise BoresightError(f"{path}: no ONNX model that onnxruntime can run: {one_line(error)}") from error


def _in_layout(outputs: Sequence[FloatArray], layout: str, size: tuple[int, int]) -> FloatArray | None:
    """Return (n, 5) corners and scores, or the map, of outputs in a layout; None if they are in another."""
    one, *more = sorted(outputs, key=lambda part: -part.ndim) or [np.zeros(())]
    if layout == "heat-map":
        return one.reshape(size) if one.squeeze().shape == size and not more else None
    single = one.ndim == 2 or (one.ndim == 3 and len(one) == 1)
    if not single or not one.shape[-1]:
        return None
    rows = one.reshape(-1, one.shape[-1])
    if layout == "boxes-cxcywh":
        if more or one.ndim != 3 or not 5 <= one.shape[1] < one.shape[2]:
            return None
        middle, half, score = rows[:2].T, 0.5 * rows[2:4].T, rows[4:].max(axis=0)
        return np.column_stack([middle - half, middle + half, score])
    if len(more) == 1 and one.shape == (*more[0].shape, 4):
        return np.column_stack([rows, more[0].reshape(-1)])
    return rows[:, :5].copy() if not more and one.shape[-1] in (5, 6) else None


def tiles_along(length: int, tile: int, overlap: float) -> list[tuple[int, int, int]]:
    """Return the first pixel of each tile along an axis, and from where to where it is the nearest one, px."""
    count = int(np.ceil(max(length - tile, 0) / (tile * (1.0 - overlap)) - 1e-9)) + 1
    starts = [round(start) for start in np.linspace(0, max(length - tile, 0), count)]
    seams = [0, *((one + other + tile) // 2 for one, other in pairwise(starts)), length]
    return list(zip(starts, seams[:-1], seams[1:], strict=True))


def _whole(found: FloatArray, start: FloatArray, size: FloatArray, image_size: Sequence[int]) -> FloatArray:
    """Return rims (n, 6) u, v, a, b, angle, score of the boxes (n, 5) of a tile within the image that no seam cuts."""
    low, high = found[:, :2], found[:, 2:4]
    middle, half = 0.5 * (low + high) + start, 0.5 * (high - low)
    cut = ((low < _AT_SEAM_PX) & (start > 0)) | ((high > size - _AT_SEAM_PX) & (start + size < image_size))
    kept = np.all(~cut & (half > 0.0) & (middle >= 0.0) & (middle <= image_size), axis=1)
    return np.column_stack([middle, half, np.zeros(len(found)), found[:, 4]])[kept]


def rims_in(heat: Image, least: float) -> FloatArray:
    """Return (n, 6) u, v, a, b, angle, score of the areas and rings of a map (H, W) that reaches ``least``."""
    # At twice the resolution the steps of pixels move a border by less than 0.1 px.
    heat = np.asarray(cv2.resize(heat, None, fx=2.0, fy=2.0, interpolation=cv2.INTER_LINEAR), dtype=np.float32)
    mask = (heat >= least).astype(np.uint8)
    lines, tree = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    label = cv2.connectedComponents(mask)[1]
    mean = np.bincount(label.ravel(), weights=heat.ravel()) / np.maximum(np.bincount(label.ravel()), 1)
    rows = []
    # Lines go through the centres of the outermost pixels: half a pixel outside of them is the border of an area.
    of = tree[0, :, 3] if len(lines) else np.zeros(0)
    for outer in map(int, np.flatnonzero(of < 0)):
        holes = [int(k) for k in np.flatnonzero(of == outer) if cv2.contourArea(lines[int(k)]) >= 4 * _LEAST_PX2]
        width = 0.5
        if holes:
            # Half the width of a ring is its area over the length of its borders, which steps of pixels overstate.
            ring = cv2.contourArea(lines[outer]) - sum([cv2.contourArea(lines[k]) for k in holes])
            width = 1.055 * ring / sum([cv2.arcLength(lines[k], closed=True) for k in (outer, *holes)])
        for k in holes or [outer]:
            m = cv2.moments(lines[k])
            size = max(m["m00"], 1e-9)
            squares, axes = np.linalg.eigh(np.array([[m["mu20"], m["mu11"]], [m["mu11"], m["mu02"]]]) / size)
            b, a = 2.0 * np.sqrt(np.maximum(squares, 0.0))
            if size >= max(4 * _LEAST_PX2, _LEAST_SHARE * np.pi * a * b):
                place, (x, y) = np.array([m["m10"], m["m01"]]) / size + 0.5, lines[k][0, 0]
                angle = np.arctan2(axes[1, 1], axes[0, 1])
                rows.append([*(0.5 * place), 0.5 * (a + width), 0.5 * (b + width), angle, mean[label[y, x]]])
    return np.array(rows).reshape(-1, 6)

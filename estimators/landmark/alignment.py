"""The translation across the line of sight, from the whole image instead of its centroid.

The centroid fails where much of the body is dark or its terminator is misplaced; then the rendered image is slid
over the observed one. Section 6 of the paper proposes this refinement.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Image = NDArray[np.float32]


def correlation_pair(observed: Image, rendered: Image, origin_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Follow the projected origin of the body from the rendered to the observed image by their best shift.

    Returns
    -------
    (2,) position in the observed image and (2,) position in the rendered image, px.
    """
    return origin_px + best_shift(observed, rendered), origin_px


def best_shift(observed: Image, rendered: Image) -> FloatArray:
    """Shift (du, dv) in px that moves the rendered image onto the observed one.

    Both backgrounds are 0, so the least squares of the difference is where the cross-correlation is greatest; a
    parabola refines the peak. Shifts that leave half of the lit part in the image are tried.
    """
    rows, columns = np.nonzero(rendered)
    top, left = int(rows.min()), int(columns.min())
    template = rendered[top : int(rows.max()) + 1, left : int(columns.max()) + 1]
    pad_rows, pad_columns = template.shape[0] // 2, template.shape[1] // 2
    field = np.pad(observed, ((pad_rows, pad_rows), (pad_columns, pad_columns)))
    correlation = cv2.matchTemplate(field, template, cv2.TM_CCORR)
    row, column = (int(i) for i in np.unravel_index(int(correlation.argmax()), correlation.shape))
    dv = row + _peak_offset(correlation[:, column], row) - pad_rows - top
    du = column + _peak_offset(correlation[row], column) - pad_columns - left
    return np.array([du, dv], dtype=np.float64)


def _peak_offset(profile: NDArray[np.float32], peak: int) -> float:
    if not 0 < peak < len(profile) - 1:
        return 0.0
    before, top, after = (float(value) for value in profile[peak - 1 : peak + 2])
    curvature = before - 2.0 * top + after
    return 0.5 * (before - after) / curvature if curvature < 0.0 else 0.0

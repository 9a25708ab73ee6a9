"""Which arithmetic solves adjustments: compiled kernels, or their reference in numpy.

Both follow the same steps and agree but for rounding; which one a run uses is part of what decides its rows.
"""

from __future__ import annotations

import os
from functools import cache
from types import ModuleType
from typing import Literal

from scenarios.errors import BoresightError
from scenarios.geometry import Camera

VARIABLE = "BORESIGHT_KERNELS"


def kernel_variant() -> Literal["numba", "numpy"]:
    """Return what $BORESIGHT_KERNELS asks for; ``numba`` where it is not set.

    Raises
    ------
    BoresightError
        If it asks for anything else.
    """
    chosen = os.environ.get(VARIABLE) or "numba"
    if chosen == "numba":
        return "numba"
    if chosen == "numpy":
        return "numpy"
    raise BoresightError(f"{VARIABLE}: {chosen!r} is unknown; choose numba or numpy")


def compiled_deviations(camera: Camera) -> ModuleType | None:
    """Return the compiled kernels of `deviations`; nothing where numpy is chosen, or where a lens distorts."""
    return None if kernel_variant() == "numpy" or camera.distortion is not None else _deviations()


@cache
def _deviations() -> ModuleType:
    from estimators.slam.compiled import deviations

    return deviations


@cache
def compiled_kernels() -> ModuleType:
    """Import the compiled kernels, which takes a second."""
    from estimators.slam.compiled import descent

    return descent

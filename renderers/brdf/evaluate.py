"""One door to the reflectance models."""

from __future__ import annotations

from renderers.brdf.arrays import NUMPY, Array, ArrayMath
from renderers.brdf.models import MODELS
from scenarios.spec.brdf import BrdfSpec


def brdf_value(spec: BrdfSpec, cos_i: Array, cos_e: Array, phase_rad: Array, xp: ArrayMath = NUMPY) -> Array:
    """Bidirectional reflectance distribution function of a scenario's surface, 1/sr.

    Parameters
    ----------
    spec
        The scenario's ``brdf`` section.
    cos_i, cos_e
        Cosines of the angles of incidence and emission from the normal; values below COS_MIN count as COS_MIN.
    phase_rad
        Angle between the direction to the light and the direction to the viewer, 0 to pi.
    xp
        The array library of the angles.

    Returns
    -------
    Array
        The BRDF, finite and never negative; the radiance factor I/F is pi times it times ``cos_i``. For Lambert
        it is a single number.
    """
    return MODELS[spec.kind].formula(dict(spec), cos_i, cos_e, phase_rad, xp)

"""Single scattering in a dark medium: the law of Lommel and Seeliger.

Source: H. von Seeliger, Zur Theorie der Beleuchtung der grossen Planeten (1887), in the notation of B. Hapke, Theory of
reflectance and emittance spectroscopy (2nd ed. 2012).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from typing import Any

from renderers.brdf.arrays import Array, ArrayMath, grazing_safe
from renderers.brdf.phase import henyey_greenstein


@dataclass(frozen=True, slots=True)
class LommelSeeligerParameters:
    """Parameters as the formula takes them; the numbers may be Dr.Jit values.

    Parameters
    ----------
    w
        Single scattering albedo of the particles: not a reflectance of the surface.
    b, c
        Lobes of the particles' phase function P (`henyey_greenstein`); b = 0 is isotropic.
    """

    w: Array
    b: Array
    c: Array

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> LommelSeeligerParameters:
        """From the values of a scenario's section, by key."""
        return cls(values["w"], values["b"], values["c"])


def lommel_seeliger(p: LommelSeeligerParameters, cos_i: Array, cos_e: Array, phase_rad: Array, xp: ArrayMath) -> Array:
    """Lommel and Seeliger's BRDF, 1/sr: ``I/F = w/4 P(g) mu0 / (mu0 + mu)``, divided by pi mu0.

    Light falls off as exp(-tau / mu0) on its way down to the optical depth tau and as exp(-tau / mu) on its way up;
    what is scattered once is the integral ``w/4 P(g) int_0^inf exp(-tau (1/mu0 + 1/mu)) dtau / mu``.
    At normal incidence and emission I/F is w/8 P(0), which is also the geometric albedo of a sphere: its full disc is
    evenly bright. For isotropic particles a hemisphere receives ``w/2 (1 - mu0 ln((1 + mu0) / mu0))``.

    Parameters
    ----------
    p
        Albedo and phase function of the particles.
    cos_i, cos_e
        Cosines of the angles of incidence (mu0) and emission (mu) from the normal.
    phase_rad
        Angle between the direction to the light and the direction to the viewer, 0 to pi.
    xp
        The array library of the angles.
    """
    scattered = p.w / (4.0 * pi) * henyey_greenstein(p.b, p.c, xp.cos(phase_rad), xp)
    return scattered / (grazing_safe(cos_i, xp) + grazing_safe(cos_e, xp))

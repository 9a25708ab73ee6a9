"""Single scattering in a dark medium: the law of Lommel and Seeliger.

Source: H. von Seeliger, Zur Theorie der Beleuchtung der grossen Planeten (1887), in the notation of B. Hapke, Theory of
reflectance and emittance spectroscopy (2nd ed. 2012), with a phase function of 1.
"""

from __future__ import annotations

from math import pi

from renderers.brdf.arrays import Array, ArrayMath, grazing_safe


def lommel_seeliger(w: Array, cos_i: Array, cos_e: Array, xp: ArrayMath) -> Array:
    """Lommel and Seeliger's BRDF, 1/sr: ``I/F = w/4 mu0 / (mu0 + mu)``, divided by pi mu0.

    Light falls off as exp(-tau / mu0) on its way down to the optical depth tau and as exp(-tau / mu) on its way up;
    what is scattered once, isotropically, is the integral ``w/4 int_0^inf exp(-tau (1/mu0 + 1/mu)) dtau / mu``.
    At normal incidence and emission I/F is w/8, an eighth of Lambert's with the same number; a full disc is
    evenly bright. A hemisphere receives ``w/2 (1 - mu0 ln((1 + mu0) / mu0))``, never more than w/2.

    Parameters
    ----------
    w
        Single scattering albedo of the particles, which scatter isotropically: not a reflectance of the surface.
    cos_i, cos_e
        Cosines of the angles of incidence (mu0) and emission (mu) from the normal.
    xp
        The array library of the angles.
    """
    return w / (4.0 * pi) / (grazing_safe(cos_i, xp) + grazing_safe(cos_e, xp))

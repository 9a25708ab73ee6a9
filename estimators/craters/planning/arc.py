"""Plans of images along an arc: from the a priori orbit, before any of them is taken."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimators.craters.planning.plan import Ephemeris, PlannedImage, plan_images
from scenarios.dynamics.flight import flight
from scenarios.dynamics.propagation import Pushes
from scenarios.orbits.data import Knowledge
from scenarios.sequences.ground import MeshGround

FloatArray = NDArray[np.float64]


def plan_arc(
    knowledge: Knowledge,
    sun_dir_inertial: FloatArray,
    times_s: FloatArray,
    ground: MeshGround,
    centre_of_mass_m: FloatArray,
) -> tuple[PlannedImage, ...]:
    """Map the a priori orbit to ``times_s``, (n,) ascending, and plan an image at each where ground is lit.

    ``centre_of_mass_m``, (3,), is where that lies in the axes of ``ground``.

    Raises
    ------
    OrbitLostError
        If the a priori orbit leads into the body.
    """
    flown = flight(knowledge.field, knowledge.state, times_s, Pushes.none(float(times_s[-1])))
    attitudes = knowledge.field.rotation.at(times_s)
    positions = flown.states[:, :3] + np.einsum("nji,j->ni", attitudes, centre_of_mass_m)
    suns = np.broadcast_to(sun_dir_inertial, positions.shape)
    return plan_images(Ephemeris(times_s, positions, attitudes, suns), ground)

"""What trials of orbit determination show of themselves."""

from __future__ import annotations

from campaign.inspection.show import Kept, Show
from campaign.kinds.orbit_determination.draw import draw_orbit_case
from campaign.kinds.orbit_determination.look import look_at_orbits
from campaign.kinds.orbit_determination.trial import DeterminedOrbit


def kept(shown: object) -> Kept:
    """Return the orbit of a solution; nothing where none came out."""
    if not isinstance(shown, DeterminedOrbit) or shown.estimate is None or shown.estimate.orbit is None:
        return Kept()
    orbit = shown.estimate.orbit
    solution = {
        "status": shown.estimate.status,
        "reason": shown.estimate.reason,
        "state_inertial": orbit.state.tolist(),
        "covariance": orbit.covariance.tolist(),
        "times_s": shown.data.wanted_s.tolist(),
        "positions_inertial_m": orbit.positions_m.tolist(),
    }
    return Kept({}, solution)


SHOW = Show(draw=draw_orbit_case, kept=kept, look=look_at_orbits)

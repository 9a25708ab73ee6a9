"""Displays of the orbit of an approach: those of orbit determination."""

from boresight.campaign.kinds.orbit_determination.show import SHOW

__all__ = ["SHOW"]

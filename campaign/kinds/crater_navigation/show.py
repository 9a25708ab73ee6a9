"""Displays of crater navigation: those of the resulting orbit."""

from __future__ import annotations

from dataclasses import replace

from boresight.campaign.kinds.orbit_determination.show import SHOW as ORBIT

SHOW = replace(ORBIT, long=lambda campaign: True)

"""Real images of the Moon: which of them choices may look at, and which only the report of what was chosen.

Named before the heat map was trained. They alternate in the order of their names, and images of successive orbits,
which may show the same ground, stay together. No network is trained on any of them, nor on their labels.
"""

from __future__ import annotations

CHOICES = ("M115143943", "M1183658592", "M1231933714", "M1275410097", "M161142858", "M161149639")
REPORT = ("M1155395732", "M1229577647", "M1266003170", "M134022629", "M180000082", "M180007222")

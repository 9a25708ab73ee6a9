"""Credit lines of what others made and a scenario's images show."""

from __future__ import annotations

from boresight.scenarios.spec.scenario import ScenarioSpec
from boresight.scenarios.spec.stars import HIPPARCOS
from boresight.scenarios.stars import hipparcos_credit


def credit_lines(spec: ScenarioSpec) -> list[str]:
    """List the credits that pages and figures with a scenario's images must carry: of real images, and of stars."""
    images = [spec.images.credit] if spec.images and spec.real and spec.images.credit else []
    stars = [hipparcos_credit()] if spec.stars is not None and spec.stars.catalog == HIPPARCOS else []
    return images + stars

"""Section of a second body: its shape, how bright it is, and its orbit about the first."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from boresight.scenarios.geometry import Pose
from boresight.scenarios.spec.base import SpecModel
from boresight.scenarios.spec.body import BodySpec
from boresight.scenarios.spec.distribution import Scalar, Uniform


class SecondBodySpec(SpecModel):
    """A second body on a circular orbit about the first, with its x axis towards the first and its z axis the pole.

    The two hide and shadow each other. The orbit is in the axes of the first body. No model on board has the second
    body, and the prior, errors and ranges are relative to the first.
    """

    body: BodySpec = BodySpec()
    albedo_ratio: float = Field(
        1.0, gt=0, le=10, description="Albedo of the second body over that of the first: brdf is common"
    )
    semi_major_axis_m: float = Field(gt=0, le=1e9, description="Distance of the origins of the two bodies")
    inclination_deg: float = Field(0.0, ge=0, le=180, description="Inclination of the orbit on the x-y plane")
    node_deg: float = Field(0.0, ge=-360, le=360, description="Longitude of the ascending node")
    phase_deg: Scalar = Field(
        Uniform(uniform=(0.0, 360.0)), description="Angle along the orbit from the ascending node, drawn in each trial"
    )

    def draw(self, rng: np.random.Generator) -> Pose:
        """Draw the pose T_body_second, which takes coordinates of the second body to those of the first."""
        # Imported here: scenarios are read without scipy, which takes 0.3 s.
        from scipy.spatial.transform import Rotation

        angles_deg = [self.node_deg, self.inclination_deg, self.phase_deg.draw(rng) + 180.0]
        rotation = Rotation.from_euler("ZXZ", angles_deg, degrees=True).as_matrix()
        return Pose(rotation, -self.semi_major_axis_m * rotation[:, 0])

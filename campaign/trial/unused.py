"""Keys of scenarios that several kinds of trial have no use for, named by what they are for."""

from __future__ import annotations

OF_IMAGES = (
    *("rendering", "detector", "brdf", "lighting", "craters"),
    *("body.shading", "body.albedo_map", "body.detail.albedo"),
)
"""Keys that change images alone."""

SUN_OF_VIEWS = ("lighting.phase_deg", "lighting.measure")
"""The Sun in images of a viewpoint; other trials have their own direction to the Sun."""

OF_OBSERVATIONS = ("pose_error", "sensors")
"""What an estimator of single images gets with the image: the prior, and measurements of sensors."""

LENS = ("camera.distortion",)
"""The lens: rims and tracks are corrected for it, and images of a pinhole have none."""

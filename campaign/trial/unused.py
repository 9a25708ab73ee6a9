"""Keys of scenarios that several kinds of trial have no use for, named by what they are for."""

from __future__ import annotations

OF_IMAGES = (
    *("rendering", "detector", "brdf", "lighting", "craters"),
    *("body.shading", "body.albedo_map", "body.detail.albedo"),
)
"""What only images show."""

SUN_OF_VIEWS = ("lighting.phase_deg", "lighting.measure")
"""Where the Sun is in the images of a viewpoint: others have directions to the Sun of their own."""

OF_OBSERVATIONS = ("pose_error", "sensors")
"""What estimators of single images are told beside the image."""

LENS = ("camera.distortion",)
"""The lens: rims and tracks come after its correction, and images that are of a pinhole have none."""

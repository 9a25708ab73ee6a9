"""Posed image sets: real images in the place of rendered ones."""

from renderers.images.pixels import read_image
from renderers.images.posed_set import PosedImageSet
from renderers.images.table import PoseTable, read_table

__all__ = ["PoseTable", "PosedImageSet", "read_image", "read_table"]

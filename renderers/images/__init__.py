"""Sets of real images that replace rendered ones, and readers of the formats in which missions publish images."""

from renderers.images.image_set import ImageSet, keep_clear, keep_clear_violation
from renderers.images.pixels import read_image
from renderers.images.posed_set import PosedImageSet, PoseTable, read_table
from renderers.images.product import ImageMetadata, ImageProduct, open_product

__all__ = [
    "ImageMetadata",
    "ImageProduct",
    "ImageSet",
    "PoseTable",
    "PosedImageSet",
    "keep_clear",
    "keep_clear_violation",
    "open_product",
    "read_image",
    "read_table",
]

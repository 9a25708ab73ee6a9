"""Sets of real images that replace rendered ones, and readers of the formats in which missions publish images."""

from boresight.renderers.images.image_set import ImageSet, keep_clear, keep_clear_violation
from boresight.renderers.images.pixels import read_image
from boresight.renderers.images.posed_set import PosedImageSet, PoseTable, read_table
from boresight.renderers.images.product import ImageMetadata, ImageProduct, open_product

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

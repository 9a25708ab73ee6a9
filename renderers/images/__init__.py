"""Sets of real images in the place of rendered ones, and the readers of what missions publish."""

from renderers.images.image_set import ImageSet, keep_clear, reach
from renderers.images.pixels import read_image
from renderers.images.posed_set import PosedImageSet, PoseTable, read_table
from renderers.images.product import ImageMetadata, Product, open_product

__all__ = [
    "ImageMetadata",
    "ImageSet",
    "PoseTable",
    "PosedImageSet",
    "Product",
    "keep_clear",
    "open_product",
    "reach",
    "read_image",
    "read_table",
]

"""Sets of real images in the place of rendered ones, and the readers of what missions publish."""

from renderers.images.image_set import ImageSet
from renderers.images.metadata import ImageMetadata
from renderers.images.pixels import read_image
from renderers.images.posed_set import PosedImageSet
from renderers.images.product import Product, open_product
from renderers.images.selection import keep_clear, reach
from renderers.images.table import PoseTable, read_table

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

"""Sets of real images that replace rendered ones, and readers of the formats in which missions publish images."""

from boresight.renderers.images.image_set import ImageSet, keep_clear, keep_clear_violation, split_survey
from boresight.renderers.images.posed_set import PosedImageSet
from boresight.renderers.images.product import open_product

__all__ = [
    "ImageSet",
    "PosedImageSet",
    "keep_clear",
    "keep_clear_violation",
    "open_product",
    "split_survey",
]

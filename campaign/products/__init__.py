"""Things that are built once from a scenario's shape and lent to estimators: landmark data bases."""

from campaign.products import landmark_database
from campaign.products.assets import BuiltAssets, BuiltProduct, MissingProduct, product_key

__all__ = ["BuiltAssets", "BuiltProduct", "MissingProduct", "landmark_database", "product_key"]
